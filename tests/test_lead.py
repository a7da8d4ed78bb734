"""A clock that jumps ahead of the others is not believed; a pause, a link that hangs and a jump of all are."""

import math
from dataclasses import replace

import pytest
from robot_drive import robot_drive

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, Sensor, YawFusion
from fusion.checks.lead import LeadWatch

S = 10**9
KINDS = {GyroSample: "gyro", OdometrySample: "tracks", YawIncrement: "compass"}
SINCE, UNTIL = 4.0, 6.0
DRIVE = robot_drive(4, seconds=9.0)


def later(sample, seconds):
    off = round(seconds * S)
    if isinstance(sample, YawIncrement):
        return replace(sample, t_ns=sample.t_ns + off, t_ref_ns=sample.t_ref_ns + off)
    return replace(sample, t_ns=sample.t_ns + off)


def jumping(kind, seconds, until=math.inf):
    """Samples in the order of arrival; those of a kind are stamped later from `SINCE` on."""
    hit = [isinstance(s, kind) and SINCE <= s.t_ns * 1e-9 < until for s in DRIVE.samples]
    return [later(s, seconds) if h else s for s, h in zip(DRIVE.samples, hit, strict=True)]


def taken(fusion):
    """How many samples went into the filter."""
    return sum(count for reason, count in fusion.counts.items() if reason.endswith((": in order", ": late")))


def fused(samples):
    """The fusion after them, and its greatest |error| over sigma (or 0.02 deg)."""
    fusion, worst = YawFusion(), 0.0
    for sample in samples:
        fusion.add(sample)
        estimate = fusion.estimate()
        sigma = max(math.sqrt(estimate.yaw_variance), math.radians(0.02))
        worst = max(worst, abs(DRIVE.error(estimate)) / sigma)
    fusion.flush()
    return fusion, worst


@pytest.mark.parametrize("seconds", [0.3, 0.5, 1.05, 3.0])
@pytest.mark.parametrize("kind", KINDS)
def test_clock_that_jumps_ahead_is_refused_from_the_first_sample_on_and_named(kind, seconds):
    fusion, worst = fused(jumping(kind, seconds))
    without = [s for s in DRIVE.samples if not (isinstance(s, kind) and s.t_ns * 1e-9 >= SINCE)]
    assert fusion.estimate().yaw == fused(without)[0].estimate().yaw
    assert worst < 3.0
    assert ("clock_mismatch", KINDS[kind]) in {(w.code, w.sensor) for w in fusion.warnings()}


@pytest.mark.parametrize("kind", KINDS)
def test_clock_that_is_set_back_again_is_believed_again(kind):
    samples = jumping(kind, 0.5, UNTIL)
    fusion, worst = fused(samples)
    own = fusion._leads._leads[Sensor(KINDS[kind])]
    assert own.newest_ns == max(s.t_ns for s in samples if isinstance(s, kind))
    assert worst < 3.0
    assert "clock_mismatch" not in {w.code for w in fusion.warnings()}


@pytest.mark.parametrize("kinds", [*KINDS, tuple(KINDS)])
def test_pause_loses_no_sample_that_came(kinds):
    samples = [s for s in DRIVE.samples if not (isinstance(s, kinds) and SINCE <= s.t_ns * 1e-9 < SINCE + 0.7)]
    fusion, worst = fused(samples)
    assert taken(fusion) == len(samples)
    assert worst < 3.0
    assert "clock_mismatch" not in {w.code for w in fusion.warnings()}


def test_time_that_jumps_for_all_loses_no_sample():
    fusion, _ = fused(jumping(tuple(KINDS), 0.5))
    assert taken(fusion) == len(DRIVE.samples)


@pytest.mark.parametrize("kind", [GyroSample, OdometrySample])
def test_gap_while_the_others_hang_is_no_jump(kind):
    """A network that stood for a second lost what one sensor said, and delivers what the others did afterwards."""
    inside = [s for s in DRIVE.samples if SINCE <= s.t_ns * 1e-9 < SINCE + 1.0]
    before = [s for s in DRIVE.samples if s.t_ns * 1e-9 < SINCE]
    after = [s for s in DRIVE.samples if s.t_ns * 1e-9 >= SINCE + 1.0]
    first = next(s for s in after if isinstance(s, kind))
    backlog = [s for s in inside if not isinstance(s, kind)]
    samples = [*before, first, *backlog, *(s for s in after if s is not first)]
    fusion, _ = fused(samples)
    assert taken(fusion) == len(samples)
    assert fusion.estimate() == fused(sorted(samples, key=lambda s: s.t_ns))[0].estimate()


def test_two_clocks_that_jump_are_not_believed_against_a_third_that_goes_on():
    fusion, worst = fused(jumping((GyroSample, OdometrySample), 0.5))
    assert worst < 3.0
    assert {w.sensor for w in fusion.warnings() if w.code == "clock_mismatch"} == {"gyro", "tracks"}


def test_lone_sensor_has_nobody_to_lead():
    watch = LeadWatch()
    for k in range(100):
        sample = GyroSample(S + k * 10**7 + (k >= 50) * S, 0.1)
        assert not watch.holds(sample)
        watch.hear(Sensor.GYRO, sample.t_ns)
