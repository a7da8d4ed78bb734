"""Turn rates that jump, and stamps that stray: a robot starts and stops between two samples, a driver stamps late."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from robot_drive import robot_drive
from torture.drives import drive

from compass import YawIncrement, wrap_angle
from fusion import GyroSample, OdometrySample, Sensor, YawFusion

MS = 10**6


def square_drive(rate, gyro_hz, compass_hz, *, tracks, seconds=40.0):
    """4 s at rest and 4 s at a turn rate in turn, which jumps: samples in order of time, and the true yaw each ms."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * 1000))
    rates = np.where(((t // 4000) % 2 == 1) & (t < 38000), rate, 0.0)
    yaw = np.concatenate([[0.0], np.cumsum(rates[:-1]) * 1e-3])
    samples = [
        GyroSample(int(i) * MS, float(rates[i] + 0.003 + 0.003 * rng.normal())) for i in t[:: round(1000 / gyro_hz)]
    ]
    if tracks:
        samples += [OdometrySample(int(i) * MS, float(1.1 * rates[i] + 0.002 * rng.normal()), 0.0) for i in t[3::20]]
    for a, b in pairwise(t[11 :: round(1000 / compass_hz)]):
        turn = float(wrap_angle(yaw[b] - yaw[a] + 3e-4 * rng.normal()))
        samples.append(YawIncrement(int(a) * MS, int(b) * MS, turn, 9e-8, 0.95))
    return sorted(samples, key=lambda sample: sample.t_ns), yaw


@pytest.mark.parametrize("tracks", [True, False], ids=["with tracks", "gyro and compass"])
@pytest.mark.parametrize(("rate", "gyro_hz", "compass_hz"), [(0.5, 100, 10), (1.0, 20, 10), (2.0, 50, 5)])
def test_yaw_stays_known_when_the_turn_rate_jumps(rate, gyro_hz, compass_hz, tracks):
    """When between two samples it jumped nobody saw: a false turn of up to `rate` over the gyro's rate, each time."""
    samples, yaw = square_drive(rate, gyro_hz, compass_hz, tracks=tracks)
    fusion = YawFusion()
    for sample in samples:
        fusion.add(sample)
        assert not fusion.warnings() or rate > 1.0  # at twice that, five images a second do contradict for a moment
        if isinstance(sample, YawIncrement):
            estimate = fusion.estimate()
            error = estimate.yaw - yaw[estimate.t_ns // MS]
            assert abs(error) < 3.0 * math.hypot(math.sqrt(estimate.yaw_variance), 5e-4)
    report = fusion.reports()[Sensor.COMPASS]
    assert report.rejected < 0.05 * report.accepted


@pytest.mark.parametrize("stray_ms", [5, 15, 30])
@pytest.mark.parametrize("pose", [True, False], ids=["poses", "twists"])
def test_yaw_of_tracks_alone_bears_stamps_that_stray(stray_ms, pose):
    """Poses some ms apart would imply any turn rate; with stamps off by 10 ms it was 700 deg."""
    ends = []
    for stray in (0, stray_ms):
        rng = np.random.default_rng(5)
        drive, fusion = robot_drive(3, seconds=60.0), YawFusion()
        for sample in drive.samples:
            if isinstance(sample, OdometrySample):
                t_ns = sample.t_ns + round(rng.uniform(-stray, stray) * MS)
                fusion.add(replace(sample, t_ns=max(t_ns, 0), yaw=sample.yaw if pose else None))
        ends.append(fusion.estimate())
    exact, strayed = ends
    # the two count the tracks' turns from other samples, at a scale that is unknown by a third
    assert abs(strayed.yaw - exact.yaw) < 0.5 * math.sqrt(exact.yaw_variance)
    assert strayed.yaw_variance == pytest.approx(exact.yaw_variance, rel=0.5)


def test_gyro_that_is_trusted_again_turns_no_yaw_by_what_the_others_measured_meanwhile():
    """Its connector is loose: noise of 0.5 rad/s. The rate that it differs by when it is heard again is none of 6 s."""
    ride, rng, fusion, ratios = drive("stop and go", 101), np.random.default_rng(9), YawFusion(), []
    for sample in ride.samples:
        t = sample.t_ns * 1e-9
        if t > 24.0:
            break
        if isinstance(sample, GyroSample) and t >= 14.0:
            sample = replace(sample, yaw_rate=sample.yaw_rate + 0.5 * float(rng.normal()))
        fusion.add(sample)
        estimate = fusion.estimate()
        ratios.append(abs(ride.error(estimate)) / max(math.sqrt(estimate.yaw_variance), math.radians(0.02)))
    assert max(ratios) < 3.5  # 6.0 while the rate might have changed since the gyro was excluded
    assert abs(math.degrees(ride.error(estimate))) < 3.0  # 269 then
