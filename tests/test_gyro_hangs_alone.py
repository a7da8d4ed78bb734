"""A gyro that hangs at one number while nobody else measures the turn."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import robot_drive

from fusion import GyroSample, YawFusion

SINCE, FOR = 14.0, 6.0  # s; it begins when the robot next turns


def judged(drive):
    """The greatest error over sigma, the codes given, and the last estimate, of the gyro alone."""
    fusion, ratios, codes = YawFusion(), [0.0], set()
    for sample in drive.samples:
        if isinstance(sample, GyroSample):
            fusion.add(sample)
            estimate = fusion.estimate()
            sigma = max(math.sqrt(estimate.yaw_variance), math.radians(0.02))
            ratios.append(abs(drive.error(estimate)) / sigma)
            codes |= {(one.code, one.sensor) for one in estimate.warnings}
    return max(ratios), codes, fusion.estimate()


@pytest.mark.parametrize("number", [0.0, None], ids=["zero", "its last"])
@pytest.mark.parametrize("seed", [0, 3])
def test_sigma_of_a_gyro_that_hangs_alone_covers_the_turn(seed, number):
    drive = robot_drive(seed, seconds=30.0)
    rate = np.gradient(drive.yaw, drive.t)
    since = next(t for t in drive.t if t > SINCE and abs(np.interp(t, drive.t, rate)) > 0.3)
    held = number
    if held is None:
        before = [one for one in drive.samples if isinstance(one, GyroSample) and one.t_ns * 1e-9 < since]
        held = before[-1].yaw_rate
    ratio, codes, _ = judged(drive.changed(lambda one: replace(one, yaw_rate=held), GyroSample, since, since + FOR))
    assert ratio < 4.0
    assert ("gyro_stuck", "gyro") in codes


def test_gyro_that_says_zero_at_rest_has_not_hung():
    drive = robot_drive(0, seconds=30.0, bias=0.0)
    rate = np.gradient(drive.yaw, drive.t)

    def said(one):
        return replace(one, yaw_rate=0.0) if abs(np.interp(one.t_ns * 1e-9, drive.t, rate)) < 1e-6 else one

    _, codes, estimate = judged(drive.changed(said, GyroSample))
    assert not codes
    assert math.sqrt(estimate.yaw_variance) < math.radians(30.0)
