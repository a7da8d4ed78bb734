"""Bags with a gyro alone, fused in no time; several of one name."""

import shutil
from pathlib import Path

from tiny_bags import START_NS, TinyBag


def make_bag(path: Path, seconds: float = 1.0, rate: float = 0.5) -> Path:
    """A gyro alone: fused in no time."""
    path.parent.mkdir(exist_ok=True)
    with TinyBag(path.parent / "made") as bag:
        for k in range(round(100 * seconds)):
            bag.imu("/imu/data", START_NS + k * 10**7, rate)
    (path.parent / "made" / "made.mcap").rename(path)
    shutil.rmtree(path.parent / "made")
    return path


def three_bags(folder: Path) -> Path:
    """The folder with three bags in it, two of them of one name."""
    for name, rate in (("mon/drive", 0.5), ("tue/drive", 0.4), ("tue/dusk", -0.3)):
        make_bag(folder / f"{name}.mcap", rate=rate)
    return folder
