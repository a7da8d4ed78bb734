"""The smoother: batch least squares in the linear case, better than the filter everywhere, not overconfident."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import cholesky, lstsq, solve_triangular
from sensor_model import SUBSETS, drawn_drive, far_increments, turning_noise
from torture.drives import drive

from compass import YawIncrement
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion
from fusion.smoother import smooth

# normal priors, as drawn
PRIORS = {
    "least_bias_sigma": 0.005,
    "least_veer_sigma": 0.015,
    "rate_walk_factor": 1.0,
    "bias_walk_factor": 1.0,
    "slip_factor": 1.0,
    "gyro_sigma_factor": 1.0,
}
LINEAR = FusionConfig(
    **PRIORS,
    gyro_scale_sigma=0.0,
    gate_probability=1.0 - 1e-12,
    watched_rate_walk=1.0,
    compass_timing=0.0,
    camera_delay_sigma=0.0,
)


def batch(samples, config):
    """Yaw and its variance at all stamps by weighted least squares; unknown are five states at each."""
    stamps = sorted({s.t_ns for s in samples} | {s.t_ref_ns for s in samples if isinstance(s, YawIncrement)})
    at = {t: 5 * k for k, t in enumerate(stamps)}  # yaw, rate, bias, lasting compass error, acceleration
    rows, rhs = [], []

    def equation(terms, value, sigma):
        row = np.zeros(5 * len(stamps))
        for index, factor in terms:
            row[index] += factor / sigma
        rows.append(row)
        rhs.append(value / sigma)

    acceleration = config.rate_walk / math.sqrt(2.0 * config.rate_ramp)
    start = (config.initial_yaw_sigma, config.initial_rate_sigma, config.initial_bias_sigma, 1.0, acceleration)
    for index, sigma in enumerate(start):
        equation([(index, 1.0)], 0.0, sigma)
    for a, b in pairwise(stamps):
        i, j, dt = at[a], at[b], (b - a) * 1e-9
        F, Q = turning_noise(config, dt)
        W = solve_triangular(cholesky(Q, lower=True), np.eye(3), lower=True)
        for w, before in zip(W, -W @ F, strict=True):  # whitened
            equation([*zip((j, j + 1, j + 4), w, strict=True), *zip((i, i + 1, i + 4), before, strict=True)], 0.0, 1.0)
        equation([(j + 2, 1.0), (i + 2, -1.0)], 0.0, config.bias_walk * math.sqrt(dt))
        keep = math.exp(-dt / config.compass_error_time)
        equation([(j + 3, 1.0), (i + 3, -keep)], 0.0, math.sqrt(1.0 - keep**2))
    for s in samples:
        if isinstance(s, GyroSample):
            equation([(at[s.t_ns] + 1, 1.0), (at[s.t_ns] + 2, 1.0)], s.yaw_rate, config.gyro_sigma)
        else:
            lasting = config.compass_error_share * s.variance
            terms = [(at[s.t_ns], 1.0), (at[s.t_ref_ns], -1.0), (at[s.t_ns] + 3, math.sqrt(lasting))]
            equation(terms, s.yaw, math.sqrt(s.variance - lasting))
    A = np.array(rows)
    x = lstsq(A, np.array(rhs))[0]
    return stamps, x[::5], np.diag(np.linalg.inv(A.T @ A))[::5]


def test_smoothed_yaw_of_linear_drive_equals_batch_least_squares():
    samples = drawn_drive(1, ("gyro", "compass"), 3.0, LINEAR, gyro_hz=25, compass_hz=5, hold=0.6).samples
    samples = [s for s in samples if not (isinstance(s, YawIncrement) and abs(s.yaw) > 2.5)]  # unwrapped for the batch
    stamps, yaw, variance = batch(samples, LINEAR)
    smoothed = {e.t_ns: e for e in smooth(samples, LINEAR)}
    assert sorted(smoothed) == stamps
    np.testing.assert_allclose([smoothed[t].yaw for t in stamps], yaw, rtol=0, atol=1e-6)
    until = stamps.index(max(s.t_ns for s in samples if isinstance(s, YawIncrement)))  # the last holds its own excess
    claimed = [smoothed[t].yaw_variance for t in stamps[:until]]
    np.testing.assert_allclose(claimed, variance[:until], rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("sensors", SUBSETS, ids="+".join)
def test_smoothed_ends_where_the_filter_ends(sensors):
    config = FusionConfig(camera_delay_sigma=0.005)
    drive = drawn_drive(2, sensors, 4.0, config)
    far = far_increments(drive, 2) if "compass" in sensors else []
    samples = sorted([*drive.samples, *far], key=lambda sample: sample.t_ns)
    fusion = YawFusion(config)
    for sample in samples:
        fusion.add(sample)
    assert smooth(samples, config)[-1] == fusion.estimate()


def errors(drive, estimates):
    return np.array([e.yaw - np.interp(e.t_ns, drive.t_ns, drive.yaw) for e in estimates])


@pytest.mark.parametrize("sensors", [s for s in SUBSETS if "compass" in s or len(s) > 1], ids="+".join)
def test_smoothed_error_is_below_the_filters(sensors):
    filtered, smoothed, normalised = [], [], []
    config = FusionConfig(rate_walk=0.5, camera_delay_sigma=0.005, gyro_scale_sigma=0.001, **PRIORS)
    for seed in range(24):
        drive = drawn_drive(seed, sensors, 8.0, config, gyro_hz=25, track_hz=10, compass_hz=5)
        fusion, estimates = YawFusion(config), []
        for sample in drive.samples:
            fusion.add(sample)
            estimates.append(fusion.estimate())
        after = smooth(drive.samples, config)
        filtered.append(np.mean(errors(drive, estimates) ** 2))
        smoothed.append(np.mean(errors(drive, after) ** 2))
        middle = after[len(after) // 2]
        normalised.append(errors(drive, [middle])[0] ** 2 / middle.yaw_variance)
    assert np.sqrt(np.mean(smoothed)) < np.sqrt(np.mean(filtered))
    assert np.mean(normalised) < 1.79  # chi-square of 24, 99 %: 43.0 / 24


def test_smoothing_does_not_depend_on_the_order_of_samples():
    samples = drawn_drive(3, seconds=3.0).samples
    assert smooth(samples[::-1] + samples[:50]) == smooth(samples)


def test_smoothing_over_many_segments_equals_one(monkeypatch):
    samples = drawn_drive(4, seconds=3.0).samples
    once = smooth(samples)
    monkeypatch.setattr("fusion.smoother.SEGMENT", 17)
    assert smooth(samples) == once


def test_smoothing_nothing_gives_nothing():
    assert smooth([]) == []
    assert smooth([GyroSample(0, math.nan)]) == []


@pytest.mark.parametrize("who", [(GyroSample, OdometrySample, YawIncrement), (GyroSample, YawIncrement)])
@pytest.mark.parametrize("fault", [lambda w: w + 0.1, lambda w: 0.0], ids=["bias step", "stuck at zero"])
def test_what_the_gyro_claimed_until_it_was_contradicted_is_in_the_smoothed_sigma(who, fault):
    """It was 9 to 132 sigma off until the window that told, as if the next image had confirmed it."""
    for name in ("long legs", "slow camera"):
        whole = drive(name, 1).changed(lambda s: replace(s, yaw_rate=fault(s.yaw_rate)), GyroSample, 14.0)
        samples = [s for s in whole.samples if isinstance(s, who) and s.t_ns < 17_000_000_000]
        ratios = [abs(whole.error(e)) / max(math.sqrt(e.yaw_variance), math.radians(0.02)) for e in smooth(samples)]
        assert max(ratios) < 5.0  # 4.0 at worst: of a step, how much was turned until the first window told
        assert np.quantile(ratios, 0.999) < 4.0
