"""Robots that nothing is wrong with; `tools.robots_table` drives hundreds of them."""

import math

import numpy as np
from robot_drive import HZ, Eyes, fuse, sensed
from sound_robots import drive, fused, sound_robot

from fusion.state.ekf import State


def test_sound_robot_is_within_its_sigma_and_nobody_is_named():
    result = fused(drive(sound_robot(4), 4))
    assert result.over4 < 1.0
    assert max(result.named.values(), default=0.0) < 1.0
    assert result.worst < math.radians(5.0)


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
