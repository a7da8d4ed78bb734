"""From a bag to a pandas DataFrame: python docs/examples/bag_to_dataframe.py drive.bag (needs pandas)"""

import sys

import numpy as np
import pandas as pd

from compass import VisualCompassError
from fusion.offline import fuse

try:
    run = fuse(sys.argv[1])
except VisualCompassError as error:
    sys.exit(f"{error}")

drive = run.yaw  # a row per estimate by time in ns, columns as in yaw.csv: rad, rad/s, left is positive
drive.index = pd.to_datetime(drive.index)
drive["fused_deg"], drive["sigma_deg"] = np.degrees(drive.fused_yaw), np.degrees(drive.fused_sigma)
print(drive.resample("1s")[["fused_deg", "sigma_deg", "yaw_rate", "confidence"]].mean().round(4))
turning = drive[drive.yaw_rate.abs() > 0.2]
print(f"turning in {100.0 * len(turning) / len(drive):.0f} % of {len(drive)} estimates,")
print(f"there the track scale is {turning.track_scale.mean():.3f}; ends at {drive.fused_deg.iloc[-1]:.2f} deg")
for warning in run.warnings:
    print(f"{warning.sensor}: {warning.text} [{warning.code}]")
