"""Gyros whose noise is not the configured one: noisy, coarse, or sent more often than they measure."""

import math

import numpy as np
import pytest
from robot_drive import HZ, Eyes, sensed

from fusion import FusionConfig, GyroSample, YawFusion
from fusion.state.gyro_noise import GyroNoise, third_difference
from fusion.state.process_models import turning

BIAS = -0.01


def held(samples):
    """Each tenth number, ten times."""
    return [number for number in samples[::10] for _ in range(10)][: len(samples)]


SHAPES = {
    "ten times the noise": lambda rates: rates + np.random.default_rng(3).normal(0.0, 0.03, len(rates)),
    "whole deg/s": lambda rates: np.radians(np.round(np.degrees(rates))),
    "held at 10 Hz": held,
}


def drive(shape, seed):
    """Bursts of turns and driving, 20 s, with a gyro at 100 Hz, tracks at 20 Hz and images at 10 Hz."""
    rng, n = np.random.default_rng(seed), 20 * HZ
    rate, speed = np.zeros(n), np.zeros(n)
    for start in range(2 * HZ, n - 3 * HZ, 3 * HZ):
        rate[start : start + 2 * HZ], speed[start : start + 2 * HZ] = rng.uniform(-0.8, 0.8), 0.4
    window = np.hanning(300) / np.hanning(300).sum()
    rate, speed = np.convolve(rate, window, "same"), np.convolve(speed, window, "same")
    eyes = Eyes(noise=5e-4, lasts=8e-5, time=6.0, claims_all=False)
    ride = sensed(rng, rate, speed, bias=BIAS, hertz=(100, 20, 10), eyes=eyes, gyro_noise=0.002)
    at = [k for k, sample in enumerate(ride.samples) if isinstance(sample, GyroSample)]
    rates = SHAPES[shape](np.array([ride.samples[k].yaw_rate for k in at]))
    for k, yaw_rate in zip(at, rates, strict=True):
        ride.samples[k] = GyroSample(ride.samples[k].t_ns, float(yaw_rate))
    return ride


@pytest.mark.parametrize("shape", SHAPES)
def test_error_stays_within_four_sigma(shape):
    ride, fusion, beyond = drive(shape, 12), YawFusion(), 0
    for sample in ride.samples:
        fusion.add(sample)
        estimate = fusion.estimate()
        beyond += abs(ride.error(estimate)) > 4.0 * math.sqrt(estimate.yaw_variance)
    assert beyond <= 0.2 / 20.0 * len(ride.samples)
    assert math.sqrt(fusion.estimate().yaw_variance) < math.radians(0.5)
    assert not fusion.estimate().warnings


def learnt(rates, sigma=0.0025, dt_ns=10_000_000):
    """What is learnt from samples 10 ms apart, of a robot that turns as calmly as this one."""
    noise, config = GyroNoise.prior(2.0), FusionConfig()
    for k, rate in enumerate(rates):
        noise = noise.after(k * dt_ns, float(rate), BIAS, sigma, 0.1, config.rate_ramp)
    return noise


@pytest.mark.parametrize("factor", [1.0, 3.0, 10.0])
def test_noise_is_learnt_while_turning(factor):
    rng, t = np.random.default_rng(1), np.arange(1000) * 0.01
    rates = 0.8 * np.sin(2.0 * t) + 0.0025 * factor * rng.normal(size=t.size)
    assert math.sqrt(learnt(rates).factor.variance) == pytest.approx(factor, rel=0.25)


def test_number_that_comes_again_is_news_only_of_a_coarse_gyro():
    fine = np.random.default_rng(2).normal(0.5, 0.0025, 20)
    assert not learnt(fine).repeats(float(fine[-1]), 0.0025)  # has not held before
    assert learnt(np.repeat(fine, 5)[:-3]).repeats(float(fine[-1]), 0.0025)
    assert not learnt([*np.repeat(fine, 5), *[fine[-1]] * 10]).repeats(float(fine[-1]), 0.0025)  # it is stuck
    coarse = np.repeat(np.radians(np.arange(20)), 5)
    assert not learnt(coarse).repeats(float(coarse[-1]), 0.0025)
    assert learnt(coarse).variance(1.0, 0.0025) == pytest.approx(math.radians(1.0) ** 2 / 3.0)
    assert learnt(fine).variance(1.0, 0.0025) == 0.0


@pytest.mark.parametrize("dt", [0.005, 0.05])
def test_third_difference_of_a_walking_rate(dt):
    """As three steps of the filter's own process model have it, from any start."""
    F, Q = turning(0.02, dt)
    P = np.diag([0.0, 0.0, 1.0 / 0.04])  # the acceleration's own variance
    weights, size = np.array([-1.0, 3.0, -3.0, 1.0]), 3
    joint = np.zeros((4 * size, 4 * size))
    joint[:size, :size] = P
    for k in range(1, 4):
        now, before = slice(k * size, (k + 1) * size), slice((k - 1) * size, k * size)
        joint[now, : k * size] = F @ joint[before, : k * size]
        joint[: k * size, now] = joint[now, : k * size].T
        joint[now, now] = F @ joint[before, before] @ F.T + Q
    rates = joint[1::size, 1::size]
    assert third_difference(1.0, 0.02, dt) == pytest.approx(weights @ rates @ weights, rel=1e-6)
