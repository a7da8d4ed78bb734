"""A sensor whose clock is off against the others', recorded (fused by stamp) and live (fused as samples arrive)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import RobotDrive, robot_drive

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion
from fusion.buffer.events import Sensor
from fusion.checks.time_offset import HISTORY, TimeOffset, Turned, time_offset, with_window

S = 10**9
BEGIN_NS = 10**12
KINDS = {"gyro": GyroSample, "tracks": OdometrySample, "compass": YawIncrement}
WINDOW_S = 0.5


def moved(sample, off_ns):
    if isinstance(sample, YawIncrement):
        return replace(sample, t_ns=sample.t_ns + off_ns, t_ref_ns=sample.t_ref_ns + off_ns)
    return replace(sample, t_ns=sample.t_ns + off_ns)


def drive_with(sensor, seconds, *, seed=4, live=False) -> RobotDrive:
    """A drive, one sensor of which is stamped so much too late, s; its samples by stamp or by arrival."""
    drive = robot_drive(seed, seconds=30.0)
    off_ns = round(seconds * S)
    samples = [moved(s, BEGIN_NS + off_ns * isinstance(s, KINDS[sensor])) for s in drive.samples]
    return replace(drive, samples=samples if live else sorted(samples, key=lambda s: s.t_ns))


@pytest.mark.parametrize("seconds", [0.8, -2.0, 5.0])
@pytest.mark.parametrize("sensor", KINDS)
def test_recorded_offset_is_named_and_told(sensor, seconds):
    fusion = YawFusion()
    said = set()
    for k, sample in enumerate(drive_with(sensor, seconds).samples):
        fusion.add(sample)
        if k % 100 == 0 and (estimate := fusion.estimate()):
            said |= {w.text for w in estimate.warnings if w.code == "sensors_disagree_time" and w.sensor == sensor}
    way = "late" if seconds > 0.0 else "early"
    told = {text.split(" come ")[1].split(" s too ")[0] for text in said if f"too {way}" in text}
    assert told, said
    assert any(abs(float(one) - abs(seconds)) <= 0.11 for one in told), told


@pytest.mark.parametrize("sensor", ["tracks", "compass"])
def test_sensor_that_keeps_ahead_live_is_named_and_not_used(sensor):
    drive = drive_with(sensor, 2.0, live=True)
    fusion = YawFusion()
    for sample in drive.samples:
        fusion.add(sample)
    estimate = fusion.estimate()
    assert ("clock_mismatch", sensor) in {(w.code, w.sensor) for w in estimate.warnings}
    assert fusion.counts["gyro: late"] < 0.1 * fusion.counts["gyro: in order"]  # the others keep the time
    off = estimate.yaw - float(np.interp((estimate.t_ns - BEGIN_NS) * 1e-9, drive.t, drive.yaw))
    assert abs(off) <= 3.0 * math.sqrt(estimate.yaw_variance)


def turned(rates, lags=(0.0, 0.0, 0.0)) -> tuple[Turned, ...]:
    """Windows of a robot with this turn rate, rad/s of a time, s; each sensor late by so much."""
    t = np.arange(HISTORY + 1) * WINDOW_S
    fine = np.arange(-10.0, t[-1] + 10.0, 0.01)
    yaw = np.cumsum([rates(x) for x in fine]) * 0.01
    turns = [np.diff(np.interp(t - lag, fine, yaw)) for lag in lags]
    history: tuple[Turned, ...] = ()
    for k in range(HISTORY):
        stamps = round(t[k] * S), round(t[k + 1] * S)
        history = with_window(history, Turned(*stamps, tuple(float(turn[k]) for turn in turns)))
    return history


def varied(t):
    """Turns to and fro of no one period."""
    return 0.4 * math.sin(0.9 * t) + 0.3 * math.sin(1.7 * t + 1.0) + 0.3 * math.sin(0.4 * t * t / 10.0)


def test_offset_is_found_to_a_tenth_of_a_second():
    offset = time_offset(turned(varied, (0.0, 1.3, 0.0)))
    assert offset == TimeOffset(Sensor.TRACKS, Sensor.GYRO, pytest.approx(1.3), 0, sure=True)


def test_two_sensors_cannot_tell_whose_clock_is_off():
    history = tuple(replace(one, turns=(one.turns[0], one.turns[1], None)) for one in turned(varied, (-0.7, 0.0, 0.0)))
    offset = time_offset(history)
    assert offset is not None
    assert not offset.sure
    assert (offset.sensor, offset.other, offset.seconds) == (Sensor.GYRO, Sensor.TRACKS, pytest.approx(-0.7))


@pytest.mark.parametrize(
    ("rates", "lags"),
    [
        (varied, (0.0, 0.0, 0.0)),
        (lambda t: 0.5, (0.0, 2.0, 0.0)),
        (lambda t: 0.6 * math.sin(math.tau * t / 3.0), (0.0, 2.0, 0.0)),
        (lambda t: 0.01 * varied(t), (0.0, 2.0, 0.0)),
    ],
    ids=["none", "constant turn", "one period", "hardly any turn"],
)
def test_offset_is_not_told_where_nothing_tells_it(rates, lags):
    assert time_offset(turned(rates, lags)) is None


def test_turns_before_a_gap_are_forgotten():
    history = turned(varied, (0.0, 1.3, 0.0))
    later = replace(history[-1], start_ns=history[-1].t_ns + S, t_ns=history[-1].t_ns + 2 * S)
    assert with_window(history, later) == (later,)
