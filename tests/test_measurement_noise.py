"""The innovation of a sample varies as the settings say: its own noise, and what is known beforehand, nothing else."""

import math

import pytest
from scipy.stats import norm

from compass import YawIncrement
from fusion import FusionConfig, GyroSample, OdometrySample, Sensor, Verdict, YawFusion
from fusion.checks.gate import Gate
from fusion.compass_rate import CompassRate
from fusion.updates.gating import gate_limit

S = 10**9
# A robot that is known to stand all but still, with sensors whose other errors are known: the noise alone is left.
STEADY = {
    "initial_rate_sigma": 1e-3, "rate_walk": 1e-4, "watched_rate_walk": 1e-4, "rate_walk_factor": 1.0,
    "initial_bias_sigma": 1e-6, "least_bias_sigma": 1e-6, "bias_walk": 0.0, "gyro_scale_sigma": 0.0,
    "gyro_sigma_factor": 1.0,
    "track_timing": 0.0, "track_slip_turn": 0.0, "track_slip_speed": 0.0, "slip_factor": 1.0,
    "veer_sigma": 0.0, "initial_scale_sigma": 1e-6, "scale_walk": 0.0,
    "compass_timing": 0.0, "camera_delay_sigma": 0.0,
}  # fmt: skip


def innovation_sigma(sensor, config, *samples):
    """Of the last sample of a sensor."""
    fusion = YawFusion(FusionConfig(**{**STEADY, **config}))
    for sample in samples:
        assert fusion.add(sample)
    return fusion.reports()[sensor].innovation_sigma


@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_gyro_sample_varies_by_its_noise(sigma):
    found = innovation_sigma(Sensor.GYRO, {"gyro_sigma": sigma}, GyroSample(S, 0.0))
    assert found == pytest.approx(math.hypot(sigma, 1e-3), rel=1e-3)


def test_gyro_sample_that_brings_its_variance_varies_by_that():
    found = innovation_sigma(Sensor.GYRO, {}, GyroSample(S, 0.0, variance=0.04**2))
    assert found == pytest.approx(math.hypot(0.04, 1e-3), rel=1e-3)


@pytest.mark.parametrize("seconds", [0.1, 0.4])
def test_turn_of_the_tracks_varies_by_their_noise_over_its_time(seconds):
    samples = (OdometrySample(t_ns, 0.0, 0.0, 0.0) for t_ns in (S, S + round(seconds * S)))
    found = innovation_sigma(Sensor.TRACKS, {"track_noise": 0.2}, *samples)
    # beside 0.2 rad after one second: a rate of 1e-3 rad/s
    assert found == pytest.approx(0.2 * math.sqrt(seconds), rel=1e-3)


@pytest.mark.parametrize("sigma", [0.01, 0.1])
def test_increment_varies_by_what_it_claims(sigma):
    found = innovation_sigma(Sensor.COMPASS, {}, YawIncrement(S, S + S // 10, 0.0, sigma**2, 0.9))
    # beside a rate of 1e-3 rad/s for a tenth of a second
    assert found == pytest.approx(math.hypot(sigma, 1e-4), rel=1e-3)


@pytest.mark.parametrize("share", [0.95, 0.9999])
def test_gate_lets_pass_the_share_of_normal_innovations_that_is_asked_for(share):
    sigma, limit = 0.3, gate_limit(FusionConfig(gate_probability=share))
    edge = sigma * norm.ppf(0.5 + 0.5 * share)
    for factor, verdict in ((0.99, Verdict.ACCEPTED), (1.01, Verdict.REJECTED)):
        for innovation in (factor * edge, -factor * edge):
            assert Gate().judge(S, innovation, sigma**2, limit, S).report.verdict is verdict


def test_second_gyro_sample_of_one_stamp_is_refused():
    fusion = YawFusion()
    for k in range(3):
        assert fusion.add(GyroSample(S + k * 10**7, 0.1))
    before = fusion.estimate()
    assert not fusion.add(GyroSample(S + 2 * 10**7, 0.3))
    after = fusion.estimate()
    assert (after.yaw_rate, after.yaw_rate_variance) == (before.yaw_rate, before.yaw_rate_variance)


@pytest.mark.parametrize("dt", [0.05, 0.1, 2.0])
def test_rate_of_the_raw_compass_errs_by_the_turns_error_over_the_time(dt):
    step_ns, sigma = round(dt * S), 0.01
    rates = CompassRate()
    rate, variance = rates.update(YawIncrement(S, S + step_ns, 0.2, sigma**2, 0.9))
    assert (rate, math.sqrt(variance)) == (pytest.approx(0.2 / dt), pytest.approx(sigma / dt))
    # the same keyframe: the difference of two turns, each of which errs
    rate, variance = rates.update(YawIncrement(S, S + 2 * step_ns, 0.25, sigma**2, 0.9))
    assert (rate, math.sqrt(variance)) == (pytest.approx(0.05 / dt), pytest.approx(math.sqrt(2.0) * sigma / dt))
    # another keyframe, the last image
    rate, variance = rates.update(YawIncrement(S + 2 * step_ns, S + 3 * step_ns, -0.1, sigma**2, 0.9))
    assert (rate, math.sqrt(variance)) == (pytest.approx(-0.1 / dt), pytest.approx(sigma / dt))


def test_gate_gives_way_to_what_it_has_refused_for_the_time_asked_for_and_not_before():
    gate, verdicts = Gate(), []
    for t_ns in range(0, 13 * S // 10, S // 10):
        gate = gate.judge(S + t_ns, 100.0, 1.0, 9.0, S)
        verdicts.append(gate.report.verdict)
    # after a second it gives way, then it refuses anew
    assert verdicts == [Verdict.REJECTED] * 10 + [Verdict.RECOVERED] + [Verdict.REJECTED] * 2


def test_gate_that_let_one_sample_pass_counts_its_refusals_anew():
    gate = Gate().judge(S, 100.0, 1.0, 9.0, S).judge(S + S // 2, 0.0, 1.0, 9.0, S)
    assert gate.report.verdict is Verdict.ACCEPTED
    assert gate.judge(3 * S, 100.0, 1.0, 9.0, S).report.verdict is Verdict.REJECTED
