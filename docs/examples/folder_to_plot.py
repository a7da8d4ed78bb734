"""From a folder of panoramas to a plot of the yaw: python docs/examples/folder_to_plot.py FOLDER 10 yaw.png

FOLDER holds equirectangular pictures of the full circle whose names sort in the order of time; 10 is their rate in Hz.
"""

import sys
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

from compass import VisualCompass

folder, rate_hz, plot = Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3]
files = sorted(file for file in folder.iterdir() if file.suffix.lower() in (".jpg", ".jpeg", ".png"))
compass, rows = VisualCompass(), []
for index, file in enumerate(files):
    compass.update(round(1e9 * index / rate_hz), cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
    rows.append((index / rate_hz, compass.yaw, compass.yaw_variance**0.5))
    if index and not compass.status.name.startswith(("OK", "FOUND")):
        print(f"{file.name}: {compass.status.value}")

t, yaw, sigma = np.array(rows).T
yaw, sigma = np.degrees(yaw), np.degrees(sigma)
print(f"turned by {yaw[-1]:.2f} deg, standard deviation {sigma[-1]:.2f} deg; left is positive")
plt.fill_between(t, yaw - 3.0 * sigma, yaw + 3.0 * sigma, alpha=0.3, label="3 sigma")
plt.plot(t, yaw, label="visual compass")
plt.xlabel("s")
plt.ylabel("yaw, deg")
plt.legend()
plt.savefig(plot)
