"""What the pictures share: the simulated drive they show, and how they are saved.

Each script of this folder draws one picture beside itself: ``python docs/figures/turn.py``. Frames are
rendered once, some minutes the first time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from fusion.simulation import simulate

FOLDER = Path(__file__).parent
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "0.55"

plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "font.size": 9})


def drive_of(name: str = "demo", worlds: str = "tuned") -> Any:
    """A simulated drive with known truth."""
    return simulate(name, 0, worlds=worlds)


def seconds(drive: Any) -> np.ndarray:
    """When the frames were exposed, s since the first."""
    return 1e-9 * (drive.frame_truth.t_ns - drive.frame_truth.t_ns[0])


def save(figure: plt.Figure, name: str) -> None:
    """Write the picture with at most 256 colours, a third of the size."""
    from PIL import Image

    path = FOLDER / f"{name}.png"
    figure.savefig(path, dpi=100, bbox_inches="tight", pad_inches=0.05)
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")
