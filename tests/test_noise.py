"""What is learnt while driving: how much the tracks slip and the turn rate changes, how good gyro and tracks are."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import robot_drive

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion
from fusion.state.bias_prior import BiasPrior
from fusion.state.learnt_noise import LearntNoise


@pytest.mark.parametrize("factor", [0.125, 0.5, 2.0])
def test_factor_of_a_noise_is_found_from_its_innovations(factor):
    rng, found = np.random.default_rng(1), LearntNoise.factor(3.0, 1000.0)
    others, own = 1e-6, 1e-3
    for innovation in rng.normal(size=400) * math.sqrt(others + factor**2 * own):
        found = found.after(float(innovation), others, math.sqrt(own))
    # 400 values tell a deviation to 3.5 %, the grid to a step of sqrt(2)
    assert math.sqrt(found.variance) == pytest.approx(factor, rel=0.2)


def test_factor_of_a_noise_that_cannot_be_seen_stays():
    start = LearntNoise.factor(3.0, 1000.0)
    assert start.after(0.1, others=1.0, gain=math.sqrt(1e-3)) is start
    assert LearntNoise.factor(1.0, 1000.0).after(5.0, 0.1, 1.0).variance == 1.0


@pytest.mark.parametrize(("before", "now"), [(4.0, 0.25), (0.125, 1.0)])
def test_learning_a_noise_forgets_what_was_long_ago(before, now):
    """Ten memories after a change of the ground; all remembered alike, sqrt((before^2 + now^2) / 2) would be left."""
    found = LearntNoise.factor(3.0, 50.0)
    rng = np.random.default_rng(2)
    for factor in (before, now):
        for innovation in rng.normal(size=500) * factor:
            found = found.after(float(innovation), 1e-9, 1.0)
    # 50 values tell a deviation to a tenth, the grid to a step of sqrt(2), and the prior draws at it
    assert math.sqrt(found.variance) == pytest.approx(now, rel=0.25)


def mixture_by_summing(x, P, priors, factor):
    """The same by brute force: a grid over both errors under each pair of priors."""
    a = np.linspace(-6.0, 6.0, 1201)
    A, B = np.meshgrid(a * priors[0], a * priors[1], indexing="ij")
    C = np.linalg.inv(P)
    off = np.stack([A - x[0], B - x[1]])
    data = np.exp(-0.5 * np.einsum("iab,ij,jab->ab", off, C, off))
    data /= np.exp(-0.5 * ((A / priors[0]) ** 2 + (B / priors[1]) ** 2))  # under the priors as configured
    total = np.zeros_like(A)
    for p in factor ** (-np.arange(7.0) / 6.0) * priors[0]:
        for q in factor ** (-np.arange(7.0) / 6.0) * priors[1]:
            total += data * np.exp(-0.5 * ((A / p) ** 2 + (B / q) ** 2)) / (p * q)
    total /= total.sum()
    mean = np.array([(A * total).sum(), (B * total).sum()])
    return mean, np.array([((A - mean[0]) ** 2 * total).sum(), ((B - mean[1]) ** 2 * total).sum()])


@pytest.mark.parametrize("seen", [0.0, 0.5, 1.5])
def test_mixture_of_priors_equals_its_sum(seen):
    """Of two errors only the difference is measured: small ones, or large ones that cancel."""
    priors, R = (0.01, 0.02), 0.002**2
    S = np.diag(np.square(priors))
    H = np.array([[1.0, -1.0]])
    K = S @ H.T / float((H @ S @ H.T)[0, 0] + R)
    x, P = K[:, 0] * seen * 0.02, S - K @ H @ S
    x1, P1 = BiasPrior(priors, (priors[0] / 8.0, priors[1] / 8.0)).mixed(x, P, (0, 1))
    mean, variance = mixture_by_summing(x, P, priors, 8.0)
    np.testing.assert_allclose(x1, mean, rtol=0, atol=2e-5)
    np.testing.assert_allclose(np.diag(P1), variance, rtol=0.02)
    assert np.linalg.eigvalsh(P1)[0] > 0.0


def test_mixture_of_priors_leaves_what_is_measured():
    x, P = np.array([0.006, -0.011]), np.diag([1e-9, 1e-9])
    x1, P1 = BiasPrior((0.01, 0.02), (0.01 / 64, 0.02 / 64)).mixed(x, P, (0, 1))
    np.testing.assert_allclose(x1, x, atol=1e-6)
    np.testing.assert_allclose(P1, P, atol=1e-10)


def steadily_driven(grip, seconds=120, seed=0):
    """A robot that never stops: gyro at 50 Hz, tracks at 20 Hz whose grip strays by so much; its yaw at the end."""
    rng, yaw, slip, claimed, samples = np.random.default_rng(seed), 0.0, 0.0, 0.0, []
    for k in range(seconds * 100):
        rate = 0.15 * math.sin(0.3 * k * 0.01)
        yaw += rate * 0.01
        slip = 0.98 * slip + math.sqrt(1.0 - 0.98**2) * rng.normal()  # over half a second
        claimed += (rate + 0.8 * grip * slip + 0.0005) * 0.01
        if k % 2 == 0:
            samples.append(GyroSample(k * 10**7, rate + 0.001 + 0.003 * rng.normal()))
        if k % 5 == 0:
            samples.append(OdometrySample(k * 10**7 + 1000, rate + grip * slip, 0.8, math.remainder(claimed, math.tau)))
    return samples, yaw


def test_good_wheels_are_used_and_slipping_ones_are_not():
    sigmas, slips = [], []
    for grip in (0.003, 0.3):
        samples, yaw = steadily_driven(grip)
        fusion = YawFusion()
        for sample in samples:
            fusion.add(sample)
        estimate = fusion.estimate()
        sigmas.append(math.sqrt(estimate.yaw_variance))
        slips.append(math.sqrt(fusion.state.slip_speed.variance))
        assert abs(estimate.yaw - yaw) < 3.0 * sigmas[-1]
    assert slips[0] < 0.15
    assert slips[1] > 2.0
    assert sigmas[0] < 0.5 * sigmas[1]
    assert sigmas[0] < math.radians(15.0)  # bias and veer of 0.01 each that cancel would leave 45 deg


@pytest.mark.parametrize("sensors", [(GyroSample, OdometrySample), (GyroSample, OdometrySample, YawIncrement)])
def test_gyro_whose_scale_is_off_by_two_percent_is_within_the_sigma(sensors):
    drive = robot_drive(4).changed(lambda s: replace(s, yaw_rate=1.018 * s.yaw_rate), GyroSample)
    fusion, normalised = YawFusion(), []
    for sample in drive.samples:
        if isinstance(sample, sensors):
            fusion.add(sample)
            estimate = fusion.estimate()
            normalised.append(drive.error(estimate) ** 2 / estimate.yaw_variance)
    assert max(normalised) < 9.0
    if YawIncrement in sensors:
        scale = fusion.state.x[5], math.sqrt(fusion.state.P[5, 5])
        assert abs(scale[0] - 0.018) < 3.0 * scale[1] < 0.012
        assert abs(drive.error(fusion.estimate())) < math.radians(0.5)
