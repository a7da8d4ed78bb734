"""Whatever accepted settings, sensors and silences: every variance is finite and positive, every gate sees numbers."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion
from fusion.buffer.events import event_of, reference_of
from fusion.filter import YawFilter
from fusion.smoother import smooth
from fusion.state.bounds import LOST_YAW
from fusion.state.ekf import State, YawEkf
from fusion.state.estimate import estimate_of
from fusion.state.process_models import integrate_gauss_markov

SENSORS = "gtc"  # gyro, tracks, compass
FIELDS = {f.name: f for f in dataclasses.fields(FusionConfig) if f.name not in ("lag_window", "reference_window")}


@st.composite
def configs(draw):
    """Settings of which half are moved: to a limit, or anywhere between by their logarithm."""
    values = {}
    for name, field in FIELDS.items():
        if field.metadata["choices"]:
            values[name] = draw(st.sampled_from(field.metadata["choices"]))
        elif draw(st.booleans()):
            low, high = field.metadata["low"], field.metadata["high"]
            start = math.log(max(low, 1e-9 * high))
            between = st.floats(start, math.log(high)).map(
                lambda x, low=low, high=high: min(max(math.exp(x), low), high)
            )
            values[name] = draw(st.sampled_from((low, high)) | between)
    return FusionConfig(**values)


def random_samples(seed, sensors, count=60):
    """Samples 1 us to 100 s apart, now and then after years, of a robot that turns this way and that."""
    rng = np.random.default_rng(seed)
    t_ns, yaw, rate, yaws = 10**18, 0.0, 0.0, [(10**18, 0.0)]
    usual = rng.uniform(-6.0, 2.0)
    for _ in range(count):
        dt = 10.0 ** (usual if rng.random() < 0.7 else rng.uniform(-6.0, 8.0 if rng.random() < 0.05 else 2.0))
        t_ns += max(round(dt * 1e9), 1000)
        rate = float(rate + 0.3 * rng.normal()) if rng.random() < 0.8 else 0.0
        yaw += rate * min(dt, 100.0)
        sensor = sensors[rng.integers(len(sensors))]
        if sensor == "g":
            yield GyroSample(t_ns, rate, None if rng.random() < 0.8 else float(10.0 ** rng.uniform(-12.0, 2.0)))
        elif sensor == "t":
            speed = float(rng.normal() if rng.random() < 0.95 else rng.uniform(-1e3, 1e3))
            yield OdometrySample(t_ns, rate, speed, float(wrap_angle(yaw)) if rng.random() < 0.5 else None)
        else:
            ref_ns, then = yaws[rng.integers(max(len(yaws) - 3, 0), len(yaws))]
            variance = float(10.0 ** rng.uniform(-11.0, -4.0))
            yield YawIncrement(
                ref_ns, t_ns, float(wrap_angle(yaw - then)), variance, 0.9, long_baseline=bool(rng.random() < 0.2)
            )
            yaws.append((t_ns, yaw))


def assert_sound(state):
    """Symmetric, finite, and of positive variances."""
    P, scale = state.P, np.sqrt(np.outer(np.diagonal(state.P), np.diagonal(state.P)))
    assert np.isfinite(P).all()
    assert np.isfinite(state.x).all()
    assert np.all(np.diagonal(P) >= 0.0)
    np.testing.assert_array_less(np.abs(P - P.T), 1e-9 * scale + 1e-300)
    estimate = estimate_of(state)
    assert min(estimate.yaw_variance, estimate.yaw_rate_variance, estimate.gyro_bias_variance) > 0.0


def run(config, samples):
    """Every state is sound, every innovation has a positive variance."""
    filter_ = YawFilter(config)
    state = filter_.start
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for sample in samples:
            state = filter_.step(state, event_of(sample))
            assert_sound(state)
            if isinstance(sample, YawIncrement):  # the next may refer to this image
                after = YawIncrement(sample.t_ns, sample.t_ns + 1, 0.0, 1.0, 0.9)
                state = filter_.step(state, reference_of(after))
                assert_sound(state)
            for gate in state.gates.values():
                if gate.report is not None:
                    assert math.isfinite(gate.report.innovation)
                    assert 0.0 < gate.report.innovation_sigma < math.inf


@settings(max_examples=100, deadline=None, derandomize=True)
@given(config=configs(), seed=st.integers(0, 2**32), mask=st.integers(1, 7))
def test_any_accepted_settings_give_positive_variances(config, seed, mask):
    sensors = "".join(sensor for bit, sensor in enumerate(SENSORS) if mask >> bit & 1)
    run(config, random_samples(seed, sensors))


@pytest.mark.parametrize("sensors", ["t", "c", "g", "gtc"])
@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize("name", [name for name, field in FIELDS.items() if not field.metadata["choices"]])
def test_each_setting_at_its_limit_gives_positive_variances(name, end, sensors):
    run(FusionConfig(**{name: FIELDS[name].metadata[end]}), random_samples(1, sensors, count=25))


@settings(max_examples=20, deadline=None, derandomize=True)
@given(config=configs(), seed=st.integers(0, 2**32))
def test_any_accepted_settings_give_a_smoothed_yaw(config, seed):
    for estimate in smooth(random_samples(seed, SENSORS, count=30), config):
        assert math.isfinite(estimate.yaw)
        assert estimate.yaw_variance > 0.0


@pytest.mark.parametrize("dt_over_time", [1e-15, 1e-9, 1e-4, 0.0999, 0.1001, 1.0, 50.0])
def test_noise_of_an_integrated_gauss_markov_state_is_that_of_many_short_steps(dt_over_time):
    time, dt = 3.0, 3.0 * dt_over_time
    F, Q = np.eye(2), np.zeros((2, 2))
    integrate_gauss_markov(F, Q, 1, 0, time, 0.7, 2.0, dt)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    s = 0.5 * dt * (1.0 + nodes)
    through = np.stack([-2.0 * time * np.expm1(-s / time), np.exp(-s / time)])  # of white noise, s before the end
    exact = 0.7**2 * 2.0 / time * 0.5 * dt * (through * weights) @ through.T
    np.testing.assert_allclose(Q, exact, rtol=1e-9)
    assert np.linalg.eigvalsh(Q / np.sqrt(np.outer(np.diag(Q), np.diag(Q))))[0] > 0.0


@pytest.mark.parametrize("seconds", [1e4, 1e6, 1e9])
def test_after_a_long_silence_the_yaw_is_unknown_and_soon_followed_again(seconds):
    """The rate is at its prior, the yaw's sigma at `LOST_YAW`; and what the sensors say afterwards is taken in."""
    ekf = YawEkf(FusionConfig())
    ekf.predict_for(seconds)
    assert math.sqrt(ekf.P[State.YAW, State.YAW]) == pytest.approx(LOST_YAW, rel=0.01)
    assert ekf.P[State.RATE, State.RATE] == pytest.approx(ekf.config.initial_rate_sigma**2, rel=0.03)
    fusion = YawFusion()
    for k in range(200):
        fusion.add(GyroSample(10**18 + k * 10**7, 0.3))
    later = 10**18 + round(seconds * 1e9)
    yaws = []
    for k in range(301):
        fusion.add(GyroSample(later + k * 10**7, 0.5))
        if k % 10 == 0 and k:
            fusion.add(YawIncrement(later, later + k * 10**7 + 1000, 0.005 * k, 1e-6, 0.9))
            yaws.append(fusion.estimate().yaw)
    # 20 increments of 1e-3 rad, and the clone of the first is held all the while
    assert yaws[-1] - yaws[9] == pytest.approx(1.0, abs=0.01)
