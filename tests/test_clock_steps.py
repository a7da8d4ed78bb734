"""A clock that is set in mid drive, told by the order of recording; and times in which nobody measured."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from reported_bags import TURNED_DEG, Imu, Picture, Tracks, changed, messages, write
from test_cases_bags import Situation, check, fused, imu_clock

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, Sensor, YawFusion
from fusion.checks.gaps import GapWatch
from fusion.offline.clock_steps import ClockSteps, Recorded
from fusion.offline.stamp_check import _lone

S = 10**9
SETS = {  # s of the drive to s of the stamp
    "forward": lambda t: t if t < 4.0 else t + 3.0,
    "back": lambda t: t if t < 4.0 else t - 3.0,
    "forward for half a second": lambda t: t + 3.0 * (4.0 <= t < 4.5),
}


@pytest.mark.parametrize("kind", [Imu, Tracks, Picture])
@pytest.mark.parametrize("way", SETS)
def test_samples_of_after_the_clock_was_set_are_left_out(way, kind, tmp_path, capsys):
    bag = write(tmp_path / "bag", changed(messages(), imu_clock(SETS[way], kind)))
    _, screen, summary = fused(bag, tmp_path, capsys, ())
    check(summary, screen, Situation(sigma=0.5, codes=("clock_mismatch",)))
    assert abs(summary["yaw"]["fused"]["turned_deg"] - TURNED_DEG) < 0.3
    assert "by the order of recording" in screen


@pytest.mark.parametrize(
    ("kind", "off", "code"),
    [
        *((kind, -1e9, "stamps_wrong") for kind in (Imu, Tracks, Picture)),
        *((kind, -3600.0, "clock_mismatch") for kind in (Imu, Tracks)),
    ],
)
def test_samples_of_before_the_clock_was_set_are_left_out(kind, off, code, tmp_path, capsys):
    """The robot's computer starts in 1980, or an hour late, and hears the time three seconds later."""
    bag = write(tmp_path / "bag", changed(messages(), imu_clock(lambda t: t + off * (t < 3.0), kind)))
    _, screen, summary = fused(bag, tmp_path, capsys, ())
    check(summary, screen, Situation(sigma=0.5, codes=(code,)))
    assert {one["sensor"] for one in summary["warnings"] if one["code"] == code} == {
        {Imu: "gyro", Tracks: "tracks", Picture: "compass"}[kind]
    }
    assert "sensor_silent" not in {one["code"] for one in summary["warnings"]}  # its later samples are used


@pytest.mark.parametrize(("kind", "sensor"), [(Imu, "gyro"), (Tracks, "tracks")])
def test_single_stamps_seconds_ahead_are_left_out_and_blame_nobody_else(kind, sensor, tmp_path, capsys):
    """One in 25: five of the tracks, fourteen of a gyro; the last ones beyond the end of all others."""

    count = itertools.count(1)

    def hasty(message):
        ahead = isinstance(message, kind) and next(count) % 25 == 0
        return replace(message, t_ns=message.t_ns + 5 * S) if ahead else message

    bag = write(tmp_path / "bag", changed(messages(), hasty))
    _, screen, summary = fused(bag, tmp_path, capsys, ())
    check(summary, screen, Situation(sigma=0.5, codes=("stamps_wrong",)))
    assert {(one["code"], one["sensor"]) for one in summary["warnings"]} == {("stamps_wrong", sensor)}
    assert abs(summary["yaw"]["fused"]["turned_deg"] - TURNED_DEG) < 0.3


@pytest.mark.parametrize("order", ["pause", "slow", "shuffled"])
def test_stamps_that_lie_far_from_each_other_in_good_order_are_used(order):
    t = np.arange(0.0, 60.0, 0.1)
    t = {"pause": t[(t < 20.0) | (t > 40.0) | (np.abs(t - 30.0) < 0.05)], "slow": t[::30]}.get(order, t)
    stamps = (t * 1e9).astype(np.int64) + S
    recorded = np.random.default_rng(1).permutation(stamps) if order == "shuffled" else stamps
    assert not _lone(recorded).any()


def _stream(hertz, seconds=10.0, *, stamp=lambda t: t, keep=lambda t: True):
    t = np.array([one for one in np.arange(0.0, seconds, 1.0 / hertz) if keep(one)])
    stamps = np.array([round(stamp(one) * 1e9) for one in t], np.int64) + S
    return Recorded((t * 1e9).astype(np.int64) + 1, stamps)


def _follows(own, others):
    clock = ClockSteps(Sensor.GYRO, others, own)
    return float(clock.following(own).mean()), clock.warnings()


def test_pause_of_a_sensor_is_no_step():
    pausing = _stream(100, keep=lambda t: not 4.0 <= t < 7.0)
    for others in ([], [_stream(20)], [_stream(20, keep=lambda t: not 3.9 <= t < 7.1)]):
        assert _follows(pausing, others) == (1.0, [])


def test_time_that_is_set_for_all_is_no_fault_of_one():
    def later(t):
        return t + 3.0 * (t >= 4.0)

    assert _follows(_stream(100, stamp=later), [_stream(20, stamp=later)]) == (1.0, [])


def test_lone_sensor_is_judged_by_the_recorder_unless_that_wrote_all_at_once():
    stepping = _stream(100, stamp=SETS["forward"])
    share, (warning,) = _follows(stepping, [])
    assert share == pytest.approx(0.4)
    assert "forward by 3 s" in warning.text
    at_once = Recorded(np.arange(stepping.t_ns.size, dtype=np.int64), stepping.t_ns)
    assert _follows(at_once, []) == (1.0, [])


def test_order_of_recording_that_means_nothing_condemns_nobody():
    gyro, tracks = _stream(100), _stream(20)
    order = np.random.default_rng(1)
    shuffled = [Recorded(one.record_ns, order.permutation(one.t_ns)) for one in (gyro, tracks)]
    assert _follows(shuffled[0], shuffled[1:]) == (1.0, [])


def _steady(fusion, start, end):
    for k in range(round(start * 100), round(end * 100)):
        fusion.add(GyroSample(S + k * 10**7, 0.3))
        if k % 5 == 0:
            fusion.add(OdometrySample(S + k * 10**7 + 1000, 0.3, 0.1, 0.003 * k))


def _lost(fusion):
    return [one for one in fusion.estimate().warnings if one.code == "turn_lost"]


def test_turn_in_a_pause_of_all_sensors_is_lost_unless_an_increment_reaches_across():
    fusion = YawFusion()
    _steady(fusion, 0.0, 4.0)
    assert not _lost(fusion)
    _steady(fusion, 6.5, 8.0)
    (warning,) = _lost(fusion)
    assert warning.since_ns == pytest.approx(S + 3.99e9, abs=5e7)
    assert "for 2.5 s" in warning.text
    fusion.add(YawIncrement(S + 39 * S // 10, S + 75 * S // 10, 1.08, 1e-6, 0.9))
    assert not _lost(fusion)


def test_late_sample_closes_a_gap():
    watch = GapWatch()
    for t in (0.0, 0.1, 1.9, 2.0, 3.0):
        watch.hear(round(t * 1e9) + S)
    assert watch.warnings()
    watch.hear(S + S)
    assert not watch.warnings()


def test_record_times_that_cannot_be_say_nothing():
    own = _stream(100)
    own.record_ns[40] = 2**63 - 1
    last = np.argsort(own.record_ns)
    assert _follows(Recorded(own.record_ns[last], own.t_ns[last]), [_stream(20)]) == (1.0, [])


@pytest.mark.parametrize("off", [3.0, 3600.0, -3600.0])
@pytest.mark.parametrize("seconds", [0.005, 0.5, 3.0])
def test_start_by_a_foreign_clock_is_forgotten_once_the_others_are_heard(off, seconds):
    """The gyro's clock is set after the start; the tracks and the compass went by the right one from the first."""
    fusion = YawFusion()
    for k in range(900):
        t_ns, turned = S * 10**6 + k * 10**7, 0.003 * k
        fusion.add(GyroSample(t_ns + round(off * S) * (0.01 * k < seconds), 0.3))
        if k % 2 == 0:
            fusion.add(OdometrySample(t_ns + 1000, 0.3, 0.1, turned))
        if k % 10 == 0 and k:
            fusion.add(YawIncrement(S * 10**6 + 2000, t_ns + 2000, turned, 1e-6, 0.9))
    estimate = fusion.estimate()
    sigma = np.sqrt(estimate.yaw_variance)
    assert sigma < np.radians(2.0)
    assert abs(estimate.yaw - 0.3 * 8.99) < 3.0 * sigma


def test_time_that_jumps_back_for_all_is_a_lost_turn():
    fusion = YawFusion()
    _steady(fusion, 10.0, 14.0)
    _steady(fusion, 3.0, 6.0)
    (warning,) = _lost(fusion)
    assert "went back by 10.99 s" in warning.text
    assert np.sqrt(fusion.estimate().yaw_variance) > np.radians(100.0)
