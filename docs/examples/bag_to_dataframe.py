"""From a bag to a pandas DataFrame: python docs/examples/bag_to_dataframe.py drive.bag (needs pandas)"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from fusion.offline.cli import main as visual_compass


def fuse(bag: str) -> pd.DataFrame:
    """Fuse a bag; a row per estimate by time, columns as in yaw.csv: rad, rad/s, left is positive."""
    with tempfile.TemporaryDirectory() as folder:
        if visual_compass(["fuse", bag, "--out", folder]) != 0:
            sys.exit(1)  # what is wrong has been printed
        table = pd.read_csv(Path(folder) / "yaw.csv")
    table.index = pd.to_datetime(table.pop("t"), unit="s")
    return table


if __name__ == "__main__":
    drive = fuse(sys.argv[1])
    drive["fused_deg"], drive["sigma_deg"] = np.degrees(drive.fused_yaw), np.degrees(drive.fused_sigma)
    print(drive.resample("1s")[["fused_deg", "sigma_deg", "yaw_rate", "confidence"]].mean().round(4))
    turning = drive[drive.yaw_rate.abs() > 0.2]
    print(f"turning in {100.0 * len(turning) / len(drive):.0f} % of {len(drive)} estimates,")
    print(f"there the track scale is {turning.track_scale.mean():.3f}; ends at {drive.fused_deg.iloc[-1]:.2f} deg")
