"""Which fields of the odometry a driver fills in."""

import pytest

from fusion import OdometrySample
from fusion.updates.odometry_source import TrackVoice

STEP_NS = 50_000_000


def heard(*fields):
    """What is made of the last of samples with these turn rates (rad/s) and yaws (rad)."""
    voice, sample = TrackVoice(), None
    for k, (rate, yaw) in enumerate(fields):
        voice, sample = voice.hear(OdometrySample(k * STEP_NS, rate, 0.0, yaw), None)
    return sample.yaw_rate, sample.yaw


def test_pose_that_never_moves_while_the_rates_turn_is_empty():
    assert heard((0.5, 0.0), (0.5, 0.0), (0.5, 0.0)) == (0.5, None)


def test_rates_that_stay_zero_while_the_poses_turn_are_taken_from_the_poses():
    assert heard((0.0, 0.0), (0.0, 0.025), (0.0, 0.05)) == (pytest.approx(0.5), pytest.approx(0.05))


def test_both_are_taken_as_they_are_where_both_speak():
    assert heard((0.5, 0.0), (0.4, 0.025), (0.6, 0.05)) == (0.6, pytest.approx(0.05))
