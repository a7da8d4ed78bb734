"""A robot that a person carries, or that is afloat: it rolls and pitches while its heading and its tracks rest."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion import OdometrySample, YawFusion
from fusion.imu.levelling import ImuLevel

HZ = 100
BIAS = np.array([0.002, -0.003, 0.004])  # rad/s


def turned(t):
    """Heading, rad: a quarter turn within two seconds, now and then."""
    return 0.5 * math.pi * sum(float(np.clip((t - start) / 2.0, 0.0, 1.0)) for start in (8.0, 16.0, 24.0))


def attitude(t, sway):
    swayed = [sway * math.sin(2.1 * t), 0.8 * sway * math.sin(1.7 * t)]
    return Rotation.from_euler("z", turned(t)) * Rotation.from_euler("xy", swayed)


@pytest.mark.parametrize("sway", [0.25, 0.05], ids=["carried", "afloat"])
def test_pitching_is_no_bias_of_a_gyro_whose_heading_rests(sway):
    rng, level, fusion, ratios = np.random.default_rng(0), ImuLevel(), YawFusion(), []
    for k in range(30 * HZ):
        t, t_ns = k / HZ, k * 10**9 // HZ
        now, later = attitude(t, sway), attitude(t + 1e-3, sway)
        rate = (now.inv() * later).as_rotvec() / 1e-3 + BIAS + 0.002 * rng.normal(size=3)
        fusion.add(level.sample(t_ns, rate, now.inv().apply((0.0, 0.0, 9.81)) + 0.2 * rng.normal(size=3)))
        if k % 5 == 0:
            fusion.add(OdometrySample(t_ns + 1000, 0.0, 0.0, 0.0))
            estimate = fusion.estimate()
            sigma = max(math.sqrt(estimate.yaw_variance), math.radians(0.02))
            ratios.append(abs(estimate.yaw - turned(estimate.t_ns * 1e-9)) / sigma)
    estimate = fusion.estimate()
    assert max(ratios) < 3.0
    assert abs(estimate.yaw - turned(30.0)) < math.radians(5.0)
