"""What is surely the gyro's fault, and the bias that would explain a contradiction."""

from __future__ import annotations

import math

from fusion.checks.exclusion import CHANGED
from fusion.checks.isolation import Remedy
from fusion.checks.windows import Claim, Window

RADIANS = (45.0, 72.0)  # ratios of turns that only degrees taken for radians explain: 57.3 and a quarter to either side
TURNED = 0.02  # rad in a window; with less a ratio of turns says nothing
MOST_BIAS = 1.0  # rad/s; no gyro's bias is larger; not derived


def surely_gyro(window: Window, turn: float) -> bool:
    """Whether the gyro errs whoever contradicts it by a `turn`: one number, turns that no robot makes, or degrees."""
    if window.gyro_repeats or window.gyro_beyond:
        return True
    return bool(window.gyro and abs(turn) > TURNED and RADIANS[0] < abs(window.gyro.turn / turn) < RADIANS[1])


def rebias(gyro: Claim, reference: Claim, window: Window, bias: float) -> Remedy:
    """The bias that the gyro would have, were that all that is wrong with it; one that is late or hangs shows none."""
    sigma = math.hypot(gyro.noise, reference.sigma) / window.seconds
    off = (gyro.turn - reference.turn) / window.seconds
    if window.gyro_hangs or abs(bias + off) > MOST_BIAS or abs(window.rate_change) > CHANGED:
        return Remedy(rate=reference.turn / window.seconds)
    return Remedy(bias=bias + off, bias_sigma=sigma, rate=reference.turn / window.seconds)
