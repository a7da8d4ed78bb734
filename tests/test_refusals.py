"""Sensors that the gate refuses for the most part are named, once they have been for long enough."""

import math

import pytest

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, Sensor, SensorReport, Verdict, Warning, YawPipeline
from fusion.checks.refusal_share import SHORTEST_TALLY_NS, TALLY_NS, RefusalWatch

SECOND = 1_000_000_000


def report(t_ns, accepted, rejected, recovered=0):
    return SensorReport(t_ns, 0.0, 1.0, Verdict.ACCEPTED, accepted, rejected, recovered)


def watched(refused_at, seconds, hertz=10.0, others=()):
    """What is said at each sample of a gyro that is refused where `refused_at` is true; by seconds."""
    watch, accepted, rejected, said = RefusalWatch(), 0, 0, {}
    for k in range(round(seconds * hertz)):
        refused = refused_at(k / hertz)
        accepted, rejected = accepted + (not refused), rejected + refused
        reports = {Sensor.GYRO: report(round(k / hertz * SECOND), accepted, rejected), Sensor.TRACKS: None}
        said[k / hertz] = watch.warnings(reports, others)
    return said


def test_refused_sensor_is_named_after_the_shortest_time_and_since_when_it_was():
    said = watched(lambda t: t >= 2.0, 14.0)
    first = min(t for t, warnings in said.items() if warnings)
    assert SHORTEST_TALLY_NS / SECOND <= first < 5.0  # more refused than not since the start
    assert {(w.code, w.sensor, w.since_ns) for warnings in said.values() for w in warnings} == {
        ("sensor_refused", "gyro", 2 * SECOND)
    }
    assert "100 of 100 samples within 10 s" in said[13.0][0].text


@pytest.mark.parametrize(("of_five", "named"), [(0, False), (1, False), (2, False), (3, True)])
def test_sensor_refused_now_and_then_is_named_from_half_on(of_five, named):
    assert any(watched(lambda t: round(10.0 * t) % 5 < of_five, 20.0).values()) == named


def test_short_refusal_is_not_named_and_a_long_one_is_forgotten():
    assert not any(watched(lambda t: t < 1.0, 20.0).values())
    said = watched(lambda t: t < 8.0, 30.0)
    assert said[7.0]
    assert not said[20.0]


def test_sensor_that_others_name_is_left_to_them():
    for sensor in ("gyro", "compass+gyro"):
        assert not any(watched(lambda t: True, 10.0, others=[Warning("sensors_disagree", sensor, 0, "")]).values())
    assert any(watched(lambda t: True, 10.0, others=[Warning("odometry_silent", "tracks", 0, "")]).values())


def test_refused_sensor_that_goes_silent_is_forgotten():
    watch = RefusalWatch()
    last = report(8 * SECOND, 0, 80)
    for k in range(1, 81):
        watch.warnings({Sensor.TRACKS: report(k * SECOND // 10, 0, k)}, [])
    now = {Sensor.TRACKS: last, Sensor.GYRO: report(9 * SECOND, 900, 0)}
    assert watch.warnings(now, [])
    later = {Sensor.TRACKS: last, Sensor.GYRO: report(8 * SECOND + TALLY_NS, 2000, 0)}
    assert not watch.warnings(later, [])


def test_counts_that_start_anew_are_followed():
    watch = RefusalWatch()
    for k in range(1, 100):
        watch.warnings({Sensor.GYRO: report(k * SECOND // 10, 0, k)}, [])
    assert not watch.warnings({Sensor.GYRO: report(10 * SECOND, 1, 0)}, [])


def test_pipeline_names_tracks_that_turn_the_wrong_way_and_forgets_them_on_reset():
    pipeline, last = YawPipeline(), []
    for k in range(1200):
        t_ns, rate = SECOND + k * SECOND // 100, 0.6 * math.sin(0.01 * k)
        pipeline.add(GyroSample(t_ns, rate))
        if k % 5 == 0:
            pipeline.add(OdometrySample(t_ns, -rate, 0.0))
        if k % 10 == 0 and k:
            pipeline.add(YawIncrement(t_ns - SECOND // 10, t_ns, 0.1 * rate, 1e-6, 0.9))
            last = pipeline.warnings()
    assert "tracks" in "".join(warning.sensor for warning in last)
    pipeline.reset()
    assert pipeline.warnings() == []
