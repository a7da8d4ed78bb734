"""A robot that turns before its first image, or between two: by the gyro alone, or by gyro and tracks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, fuse, sensed

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion


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


SEES = 1.2  # s; until then the first images have shown two windows of a turn


@pytest.mark.parametrize("begins", [3.8, 4.8])  # in mid turn, and at its end
@pytest.mark.parametrize(
    ("factor", "tracks"), [(1.0, True), (0.7, True), (-1.0, True), *((f, False) for f in (1.0, 0.7, 1.4, -1.0))]
)
def test_images_that_contradict_a_gyro_put_in_doubt_what_it_turned_before_they_came(factor, begins, tracks):
    """Switched on in a turn, and tracks of a scale that nobody knows: they fit to any factor of the gyro."""
    rate = leg(np.full(12 * HZ, -0.4), (2, 5, -0.7), (5, 6, 0.0), (6, 9, 0.5), (9, 12, -0.3))
    drive = sensed(np.random.default_rng(2), rate, np.full(rate.size, 0.5), bias=0.0, scale=1.5, hertz=(100, 20, 20))
    drive = drive.changed(lambda s: replace(s, yaw_rate=factor * s.yaw_rate), GyroSample)
    drive = replace(drive, samples=[s for s in drive.samples if getattr(s, "t_ref_ns", 1e12) >= begins * 1e9])
    seen = begins + SEES if begins < 4.0 else 6.0 + SEES
    fusion = YawFusion()
    for sample in drive.samples:
        if tracks or not isinstance(sample, OdometrySample):
            fusion.add(sample)
            estimate = fusion.estimate()
            error, sigma = abs(drive.error(estimate)), math.sqrt(estimate.yaw_variance)
            assert error < 4.0 * max(sigma, math.radians(0.1)) or estimate.t_ns * 1e-9 < seen
    if factor == 1.0:  # and once they have seen it turn, it was right before, too
        assert sigma < math.radians(3.0)
    else:
        assert estimate.warnings
