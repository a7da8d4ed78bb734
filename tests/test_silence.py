"""Sensors that stop, and samples that are missing, by their stamps."""

import numpy as np
import pytest

from fusion import Sensor
from fusion.checks.silence import SilenceWatch

HERTZ = {Sensor.GYRO: 100.0, Sensor.TRACKS: 20.0, Sensor.COMPASS: 2.0}


def told(keeps, seconds=20.0, hertz=HERTZ, known=()):
    """Warnings at the end of some seconds of samples; `keeps` says which of them come, of sensor and time, s."""
    watch = SilenceWatch()
    stamps = [(t, sensor) for sensor, rate in hertz.items() for t in np.arange(0.0, seconds, 1.0 / rate)]
    for t, sensor in sorted(stamps, key=lambda one: one[0]):
        if keeps(sensor, t):
            watch.hear(sensor, round(t * 1e9))
    return {(warning.code, warning.sensor): warning for warning in watch.warnings(known)}


def test_nothing_is_missing():
    assert not told(lambda sensor, t: True)
    assert not told(lambda sensor, t: True, hertz={Sensor.COMPASS: 0.5, Sensor.GYRO: 100.0})
    assert not SilenceWatch().warnings()


@pytest.mark.parametrize("silent", Sensor)
def test_sensor_that_stops_is_named_with_its_last_sample(silent):
    found = told(lambda sensor, t: sensor is not silent or t <= 12.0)
    assert set(found) == {("sensor_silent", silent.value)}
    warning = found["sensor_silent", silent.value]
    assert warning.since_ns == pytest.approx(12e9, abs=1)
    assert "for 8.0 s" in warning.text


def test_sensor_that_speaks_again_is_named_no_more():
    assert not told(lambda sensor, t: sensor is not Sensor.GYRO or not 5.0 < t < 9.0)


def test_all_that_stop_together_are_at_the_end():
    assert not told(lambda sensor, t: t < 10.0)


def test_sensor_whose_clock_is_another_is_not_named_twice():
    assert not told(lambda sensor, t: sensor is not Sensor.GYRO or t < 10.0, known=["gyro"])


@pytest.mark.parametrize("sensor", [Sensor.GYRO, Sensor.TRACKS])
def test_samples_that_are_lost_again_and_again_are_told(sensor):
    drops = lambda one, t: one is not sensor or t < 10.0 or t % 2.0 >= 0.3  # noqa: E731
    assert set(told(drops)) == {("samples_lost", sensor.value)}
    assert not told(lambda one, t: one is not sensor or not 15.0 < t < 15.3)  # once is no fault
