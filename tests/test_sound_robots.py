"""Robots that nothing is wrong with; `tools.robots_table` drives hundreds of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, Eyes, fuse, sensed
from sound_robots import drive, fused, sound_robot

from fusion import FusionConfig
from fusion.state.ekf import DIM, State, YawEkf
from fusion.updates.gyro import allow_change, gyro_measurement


def test_sound_robot_is_within_its_sigma_and_nobody_is_named():
    result = fused(drive(sound_robot(4), 4))
    assert result.over4 < 1.0
    assert max(result.named.values(), default=0.0) < 1.0
    assert result.worst < math.radians(5.0)


SLOWER = replace(sound_robot(300), hertz=(5, 50, 25), camera_delay=0.1, style="weaves")


@pytest.mark.parametrize(
    ("robot", "seed"),
    [(sound_robot(300), 300), (sound_robot(327), 327), (sound_robot(135), 135), (SLOWER, 3)],
    ids=["10 Hz", "10 Hz, noisy", "50 Hz, 0.1 s late", "5 Hz, 0.1 s late"],
)
def test_robot_whose_turn_rate_changes_faster_than_its_gyro_sees_teaches_no_wrong_delay(robot, seed):
    result = fused(drive(robot, seed), "GTC")
    assert result.over4 < 0.5
    assert result.worst < math.radians(8.0)
    assert max(result.named.values(), default=0.0) < 1.0


def test_turn_between_two_samples_of_a_slow_gyro_is_the_trapezoid_to_within_the_change():
    ekf, change, seconds = YawEkf(FusionConfig()), 2.0, 0.1
    ekf.P = np.diag(np.full(DIM, 1e-12))
    allow_change(ekf, change**2, seconds)
    ekf.correct(gyro_measurement(ekf, change, 1e-8))
    assert ekf.x[State.YAW] == pytest.approx(0.5 * change * seconds, rel=1e-3)
    assert math.sqrt(ekf.P[State.YAW, State.YAW]) == pytest.approx(change * seconds / math.sqrt(12.0), rel=1e-3)


def test_noise_of_a_gyro_on_a_straight_drive_is_no_scale_factor():
    """The rate that a sample's scale is a factor of is the last sample's noise there, which the next one takes back."""
    rate = np.zeros(40 * HZ)
    rate[2 * HZ : 4 * HZ] = 0.5
    straight = sensed(
        np.random.default_rng(7),
        rate,
        np.full(rate.size, 0.5),
        hertz=(200, 50, 25),
        gyro_noise=0.02,
        eyes=Eyes(hold=5.0),
    )
    scales = []
    for seconds in (8.0, 40.0):
        fusion, errors = fuse(straight.changed(lambda s: None, since=seconds))
        scales.append(float(fusion.state.x[State.GYRO_SCALE]))
    assert abs(scales[1] - scales[0]) < 0.001
    assert abs(errors[-1]) < 3.0 * math.sqrt(fusion.estimate().yaw_variance)
