"""All clocks of a robot are set back while it turns, by less than `lag_window`, as by a time server."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import robot_drive

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion

KINDS = {"G": GyroSample, "T": OdometrySample, "C": YawIncrement}
DRIVE = robot_drive(5, seconds=30.0)
RATE = np.gradient(DRIVE.yaw, DRIVE.t)
AT_NS = round(
    1e9 * next(t for t in DRIVE.t if t > 8.0 and abs(np.interp(t + np.array([-0.5, 0.5]), DRIVE.t, RATE)).min() > 0.2)
)


def set_back(sample, by_ns):
    """The sample by a clock that was set back by so many ns."""
    if sample.t_ns < AT_NS:
        return sample
    if isinstance(sample, YawIncrement):
        sample = replace(sample, t_ref_ns=sample.t_ref_ns - by_ns * (sample.t_ref_ns >= AT_NS))
    return replace(sample, t_ns=sample.t_ns - by_ns)


@pytest.mark.parametrize("who", ["GTC", "GT", "GC"])
@pytest.mark.parametrize("seconds", [0.307, 0.6])
def test_turn_that_came_twice_is_lost_and_told(who, seconds):
    drive, fusion = DRIVE, YawFusion()
    for sample in drive.samples:
        if isinstance(sample, tuple(KINDS[one] for one in who)):
            fusion.add(set_back(sample, round(seconds * 1e9)))
            estimate, now_ns = fusion.estimate(), sample.t_ns
    error = drive.error(replace(estimate, t_ns=now_ns))
    assert abs(error) < 4.0 * math.sqrt(estimate.yaw_variance)
    assert fusion.counts["reset: time jumped back"] == 1
    assert "turn_lost" in {warning.code for warning in estimate.warnings}


@pytest.mark.parametrize("kind", [GyroSample, OdometrySample])
def test_one_clock_alone_that_is_set_back_is_no_jump_of_time(kind):
    drive, fusion = DRIVE, YawFusion()
    for sample in drive.samples:
        fusion.add(set_back(sample, 307_000_000) if isinstance(sample, kind) else sample)
    estimate = fusion.estimate()
    assert not fusion.counts["reset: time jumped back"]
    assert abs(drive.error(estimate)) < 4.0 * math.sqrt(estimate.yaw_variance)
    assert estimate.warnings


def test_two_publishers_on_each_topic_are_no_jump_of_time():
    drive, fusion = DRIVE, YawFusion()
    for sample in drive.samples:
        fusion.add(sample)
        fusion.add(set_back(replace(sample, t_ns=sample.t_ns + 1_000_000), 40_000_000))
    assert not fusion.counts["reset: time jumped back"]
