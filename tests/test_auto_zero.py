"""Gyros whose drivers say zero while they rest: that says nothing of the bias they have in motion."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import ratios_at_images, robot_drive

from fusion import GyroSample, YawFusion

QUIET = 30  # gyro samples at rest, 0.6 s, before the driver says zero


def auto_zeroed(drive):
    """The drive with a gyro that says zero once it has rested."""
    rate, resting, out = np.gradient(drive.yaw, drive.t), 0, []
    for sample in drive.samples:
        if isinstance(sample, GyroSample):
            resting = resting + 1 if abs(np.interp(sample.t_ns * 1e-9, drive.t, rate)) < 1e-6 else 0
            sample = replace(sample, yaw_rate=0.0) if resting > QUIET else sample
        out.append(sample)
    return replace(drive, samples=out)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_zeros_of_a_gyro_at_rest_teach_no_bias(seed):
    drive = auto_zeroed(robot_drive(seed, bias=-0.01))
    fusion = YawFusion()
    ratios, _ = ratios_at_images(fusion, drive)
    assert np.sum(ratios > 4.0) <= 2
    assert abs(drive.error(fusion.estimate())) < math.radians(0.5)
    assert abs(fusion.estimate().gyro_bias + 0.01) < 0.001
