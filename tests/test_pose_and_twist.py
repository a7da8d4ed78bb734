"""Pose and twist of one odometry that do not turn alike."""

import math

import numpy as np
import pytest

from fusion import OdometrySample, YawFusion
from fusion.checks.pose_and_twist import PoseAndTwist

S = 10**9


def odometry(factor, seconds=20.0, noise=0.05, lag=0.1, start=0.0):
    """At 20 Hz, turning to and fro; the twist is noisy, late and `factor` times the pose's rate."""
    rng, out = np.random.default_rng(2), []
    for k in range(round(20 * seconds)):
        t = k / 20
        rate = factor * (0.5 * math.sin(t - lag) + noise * rng.normal())
        yaw = math.remainder(start + 0.5 - 0.5 * math.cos(t), math.tau)
        out.append(OdometrySample(S + k * S // 20, rate, 0.3, yaw))
    return out


def told(samples):
    watch = PoseAndTwist()
    for sample in samples:
        watch.hear(sample)
    return [(one.code, one.sensor) for one in watch.warnings()]


@pytest.mark.parametrize(
    ("factor", "codes"),
    [
        (-1.0, ["sensors_disagree_sign"]),
        (-1.4, ["sensors_disagree_sign"]),
        (180.0 / math.pi, ["sensors_disagree_scale"]),
        (1.0, []),
        (1.4, []),
        (0.0, []),  # a driver that leaves it empty
    ],
)
def test_twist_that_turns_otherwise_than_the_pose_is_told(factor, codes):
    assert told(odometry(factor)) == [(code, "tracks") for code in codes]
    fusion = YawFusion()
    for sample in odometry(factor):
        fusion.add(sample)
    assert [one.code for one in fusion.warnings() if one.code in codes] == codes


@pytest.mark.parametrize("start", [0.0, math.pi / 3.0, math.pi, -2.0 * math.pi / 3.0, math.pi - 1e-9])
def test_heading_at_the_start_does_not_matter(start):
    assert told(odometry(1.0, start=start)) == []
    assert told(odometry(-1.0, start=start)) == [("sensors_disagree_sign", "tracks")]


def test_poses_that_are_reset_and_noise_of_a_standing_robot_are_not_compared():
    reset = [
        OdometrySample(
            one.t_ns, one.yaw_rate, one.speed, math.remainder(one.yaw + 2.0 * (one.t_ns // (3 * S)), math.tau)
        )
        for one in odometry(1.0)
    ]
    assert told(reset) == []
    rng = np.random.default_rng(3)
    assert told([OdometrySample(S + k * S // 20, 0.02 * rng.normal(), 0.0, 1.0) for k in range(4000)]) == []
