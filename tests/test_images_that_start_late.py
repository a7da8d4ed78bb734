"""A robot that turns before its first image, or between two: by the gyro alone, or by gyro and tracks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, fuse, sensed

from compass import YawIncrement
from fusion import GyroSample, OdometrySample


def leg(rate, *legs):
    """A turn rate, rad/s each 1 ms, with legs of (begin, end, rate) smoothed over 0.4 s."""
    for begin, end, turning in legs:
        rate[begin * HZ : end * HZ] = turning
    lead = np.full(400, rate[0])
    return np.convolve(np.concatenate([lead, rate]), np.hanning(400) / np.hanning(400).sum(), "same")[400:]


def late(scale, since, until):
    """Six seconds of a turn, of which no image tells, and turns that do later; a gyro of the scale factor."""
    rate = leg(np.zeros(20 * HZ), (3, 9, 0.6), (11, 13, -0.6), (14, 16, 0.6))
    drive = sensed(np.random.default_rng(4), rate, np.full(rate.size, 0.3), scale=1.2)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate * scale), GyroSample)
    return drive.changed(lambda s: None, YawIncrement, since, until)


@pytest.mark.parametrize(("since", "tracks"), [(0.0, True), (0.0, False), (2.5, True)])
@pytest.mark.parametrize("scale", [0.98, 1.015])
def test_scale_that_images_teach_the_gyro_counts_for_what_was_turned_before_they_came(scale, since, tracks):
    """An increment says nothing of what was turned before its reference, nor do tracks of what was before theirs."""
    drive = late(scale, since, 10.0)
    fusion, errors = fuse(drive if tracks else drive.changed(lambda s: None, OdometrySample))
    estimate = fusion.estimate()
    assert abs(errors[-1]) < 4.0 * math.sqrt(estimate.yaw_variance) < math.radians(4.0)
    assert abs(errors[-1]) < 0.3 * abs(scale - 1.0) * 3.6 + math.radians(1.0)


@pytest.mark.parametrize("tracks", [True, False])
@pytest.mark.parametrize("bias", [-0.023, 0.03])
def test_bias_that_only_several_windows_show_is_one_however_large(bias, tracks):
    """A gyro of 10 Hz, whose noise in one window hides 1 deg/s: a scale factor makes no turn of a straight drive."""
    rate = leg(np.full(30 * HZ, 0.05), (2, 12, 0.0), (12, 16, -0.5), (16, 20, 0.0), (20, 24, 0.4), (24, 30, 0.0))
    drive = sensed(
        np.random.default_rng(3), rate, np.full(rate.size, 0.7), bias=bias, hertz=(10, 40, 5), camera_delay=0.06
    )
    fusion, errors = fuse(drive if tracks else drive.changed(lambda s: None, OdometrySample))
    assert np.abs(errors).max() < math.radians(3.0)
    assert abs(errors[-1]) < math.radians(0.5)
    assert "sensors_disagree_scale" not in {one.code for one in fusion.estimate().warnings}
