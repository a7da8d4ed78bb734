"""A gyro that hangs at one number: alone, and together with the tracks beside a camera."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import Eyes, robot_drive

from compass import YawIncrement
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


def link_hangs(drive, since, seconds, shape, *, zero):
    """A link to gyro and tracks that says zero, or the last it heard, for some seconds."""
    heard, out = {}, []
    for one in drive.samples:
        hangs = since <= one.t_ns * 1e-9 < since + seconds
        if isinstance(one, GyroSample):
            one = replace(one, yaw_rate=shape(one.yaw_rate))
        if not hangs:
            heard[type(one)] = one
        elif not isinstance(one, YawIncrement):
            one = replace(heard[type(one)], t_ns=one.t_ns)
            one = replace(one, yaw_rate=0.0) if zero else one
        out.append(one)
    return replace(drive, samples=out)


SHAPES = {
    "fine": lambda rate: rate,
    "coarse": lambda rate: round(rate / 1e-3) * 1e-3,
    "says zero at rest": lambda rate: rate if abs(rate) > 0.02 else 0.0,
}


@pytest.mark.parametrize("zero", [True, False], ids=["zero", "its last"])
@pytest.mark.parametrize("seconds", [0.3, 1.2])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("images", [True, False], ids=["images", "no images"])
def test_gyro_and_tracks_that_hang_together_are_no_majority(images, shape, seconds, zero):
    drive = robot_drive(7, seconds=30.0, bias=0.0, eyes=Eyes(claims_all=True))
    rate = np.gradient(drive.yaw, drive.t)
    since = next(t for t in drive.t if t > SINCE and abs(np.interp(t + 0.5, drive.t, rate)) > 0.5)
    drive = link_hangs(drive, since, seconds, SHAPES[shape], zero=zero)
    fusion, codes, beyond = YawFusion(), set(), 0.0
    for before, sample in zip(drive.samples, drive.samples[1:], strict=False):
        if isinstance(sample, YawIncrement) and not images:
            continue
        fusion.add(sample)
        estimate = fusion.estimate()
        codes |= {(one.code, name) for one in estimate.warnings for name in one.sensors}
        sigma = max(math.sqrt(estimate.yaw_variance), math.radians(0.02))
        beyond += (sample.t_ns - before.t_ns) * 1e-9 * (abs(drive.error(estimate)) > 4.0 * sigma)
    assert beyond < 0.1  # until the second sample shows that it hangs
    assert ("gyro_stuck", "gyro") in codes
    assert ("sensors_disagree", "compass") not in codes
    if images:
        assert abs(drive.error(fusion.estimate())) < math.radians(1.0)


def test_gyro_without_noise_that_turns_at_one_rate_has_not_hung():
    """As simulators give them."""
    drive = robot_drive(3, seconds=40.0, bias=0.0)
    rate = np.gradient(drive.yaw, drive.t)
    exact = drive.changed(
        lambda one: replace(one, yaw_rate=float(np.interp(one.t_ns * 1e-9, drive.t, rate))), GyroSample
    )
    _, codes, estimate = judged(exact)
    assert not codes
    assert abs(drive.error(estimate)) < math.radians(1.0)


def test_gyro_that_hangs_again_and_again_is_found_each_time():
    drive = robot_drive(5, seconds=40.0)
    rate, ends = np.gradient(drive.yaw, drive.t), []
    for t in drive.t[drive.t > SINCE][::100]:
        turns = min(abs(np.interp(t + s, drive.t, rate)) for s in (0.0, 0.4)) > 0.2
        if turns and t > (ends[-1] + 1.0 if ends else SINCE):
            ends.append(t + 0.4)
    for end in ends:
        drive = drive.changed(lambda one: replace(one, yaw_rate=0.0), GyroSample, end - 0.4, end)
    fusion, found = YawFusion(), set()
    for sample in drive.samples:
        fusion.add(sample)
        found |= {warning.since_ns for warning in fusion.estimate().warnings if warning.code == "gyro_stuck"}
    assert len(ends) > 4
    assert len(found) == len(ends)
    assert abs(drive.error(fusion.estimate())) < math.radians(1.0)
