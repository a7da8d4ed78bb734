"""Which fields of the odometry a driver fills in, and when its scale is learnt anew."""

import math

import numpy as np
import pytest

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion
from fusion.state.track_claim import OdometryFields

STEP_NS = 50_000_000


def heard(*fields):
    """What is made of the last of samples with these turn rates (rad/s) and yaws (rad)."""
    voice, sample = OdometryFields(), None
    for k, (rate, yaw) in enumerate(fields):
        voice, sample = voice.after(OdometrySample(k * STEP_NS, rate, 0.0, yaw), None)
    return sample.yaw_rate, sample.yaw


def test_pose_that_never_moves_while_the_rates_turn_is_empty():
    assert heard((0.5, 0.0), (0.5, 0.0), (0.5, 0.0)) == (0.5, None)


def test_rates_that_stay_zero_while_the_poses_turn_are_taken_from_the_poses():
    assert heard((0.0, 0.0), (0.0, 0.025), (0.0, 0.05)) == (pytest.approx(0.5), pytest.approx(0.05))


def test_both_are_taken_as_they_are_where_both_speak():
    assert heard((0.5, 0.0), (0.4, 0.025), (0.6, 0.05)) == (0.6, pytest.approx(0.05))


def test_scale_of_the_tracks_is_learnt_anew_on_other_ground_and_not_for_a_slip():
    """A robot that turns all the while comes from a floor on which its tracks hold to one on which they slip by half.

    Refused for `slip_recovery_time`, 10 s, they are on other ground; the interval of their turns is half a second.
    """
    fusion, rng, yaw, claimed, reference, scales = YawFusion(), np.random.default_rng(0), 0.0, 0.0, (0, 0.0), {}
    for k in range(1, 2001):
        t, t_ns = 0.02 * k, 20_000_000 * k
        rate, scale = 0.5 + 0.1 * math.sin(0.6 * t), 1.0 if t < 20.0 else 1.8
        yaw, claimed = yaw + 0.02 * rate, claimed + 0.02 * scale * rate
        fusion.add(GyroSample(t_ns, rate + 0.0025 * rng.normal()))
        fusion.add(OdometrySample(t_ns + 1000, scale * rate, 0.3, claimed))
        if k % 5 == 0:
            fusion.add(YawIncrement(reference[0], t_ns, yaw - reference[1] + 3e-4 * rng.normal(), 1e-7, 0.9))
            reference = t_ns, yaw
            estimate = fusion.estimate()
            scales[round(t)] = estimate.track_scale, math.sqrt(estimate.track_scale_variance)
    assert scales[19] == (pytest.approx(1.0, abs=0.02), pytest.approx(0.0, abs=0.02))
    assert scales[28][0] == pytest.approx(1.0, abs=0.02)
    assert abs(scales[40][0] - 1.8) < 3.0 * scales[40][1] < 0.2
