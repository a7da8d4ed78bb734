"""Prior of a motion between two views, and what of its error no corner shows."""

from __future__ import annotations

import math

import numpy as np

from compass.features.points import Floats
from compass.images.strip import Strip
from compass.tilt import TILT_NOISE, tilt_between

# rad, how far a ground is off level: tilt of the scene between two views beside what an IMU measures, and climb of the
# direction of travel against the camera's level; half and double are as good on level ground
# (docs/lab-notes/halves-and-doubles-2026-11-30.md)
TILT_SIGMA = math.radians(3.0)
FEWEST = 24  # corners that have to be found again, and to be inliers: five for each of a motion's unknowns
# Of the circle without any corner. What is seen on one side only turns by as much as it is passed: of nine tuned drives
# whose corners were left out over 0.63 of it error^2/variance is 640, over a half 5.4, over 0.38 1.7, over 0.22 1.05.
# Views of less than 240 deg always have such a gap.
GAP = 1.0 / 3.0


def precision_of(yaw_sigma: float = math.inf) -> Floats:
    """(5,) precisions of yaw, whose deviation is given, tilt about x and y, direction of travel, and climb; rad^-2."""
    return np.array([yaw_sigma**-2, TILT_SIGMA**-2, TILT_SIGMA**-2, 0.0, TILT_SIGMA**-2])


def imu_tilt(reference: Strip, current: Strip, turn: float) -> tuple[float, float]:
    """Tilt of the scene about x and y from one view to another as an IMU measures it, rad; none without one."""
    if reference.up is None or current.up is None:
        return 0.0, 0.0
    before, now = (current.mount.seen(up) for up in (reference.up, current.up))
    return tilt_between(before, now, turn)


def tilt_error(reference: Strip, tilt: tuple[float, float]) -> float:
    """Standard deviation of a yaw, rad, from what a tilt has to do with it: that depends on the tilt.

    See `compass.tilt`.
    """
    return (TILT_SIGMA if reference.up is None else TILT_NOISE) * math.hypot(*tilt)
