"""The filter's algebra: Jacobians, clones, frames."""

import math
from itertools import pairwise

import numpy as np
import pytest
from sensor_model import turning_noise

from compass import wrap_angle
from fusion import FusionConfig
from fusion.imu.tilt import BiasGain
from fusion.state.bounds import ROUNDING
from fusion.state.ekf import CLONES, DIM, TURNING, YAWS, State, YawEkf
from fusion.updates.compass import compass_measurement
from fusion.updates.gyro import gyro_measurement, turn_bias
from fusion.updates.odometry import tracks_measurement
from fusion.updates.standstill import stand_still


@pytest.fixture
def ekf():
    """A filter at a general state with a general covariance."""
    rng = np.random.default_rng(4)
    ekf = YawEkf(FusionConfig())
    ekf.x = rng.normal(size=DIM)
    ekf.x[State.SCALE] = 0.9
    A = 0.1 * rng.normal(size=(DIM, DIM))
    ekf.P = A @ A.T
    return ekf


def expected_gyro(x):
    return (1.0 + x[State.GYRO_SCALE]) * x[State.RATE] + x[State.BIAS]


def expected_track_turn(x):
    return x[State.SCALE] * (x[State.YAW] - x[State.TRACK_REF]) + x[State.TRACK_ERROR]


def expected_compass(x, config, variance):
    lasting = math.sqrt(config.compass_error_share * variance)
    return x[State.YAW] - x[State.CLONE] + lasting * x[State.COMPASS_ERROR]


def test_jacobians_equal_finite_differences(ekf):
    pairs = [
        (gyro_measurement(ekf, 0.0, 1e-18), expected_gyro),  # of its scale a sample tells less the noisier it is
        (tracks_measurement(ekf, 0.0, 1e-4, modulo_turn=True, alone=True), expected_track_turn),
        (compass_measurement(ekf, 0.0, 1e-4, State.CLONE, State.YAW), lambda x: expected_compass(x, ekf.config, 1e-4)),
    ]
    far = compass_measurement(ekf, 0.0, 1e-4, State.CLONE, State.YAW, long_baseline=True)
    lasting = math.sqrt(ekf.config.compass_error_share * 1e-4)
    pairs.append((far, lambda x: x[State.YAW] - x[State.CLONE] + lasting * x[State.LONG_BASELINE_ERROR]))
    step = 1e-6  # all models are at most bilinear, so central differences err by rounding alone: 1e-16 / 1e-6
    for measurement, expected in pairs:
        for i in range(DIM):
            e = step * np.eye(DIM)[i]
            slope = (expected(ekf.x + e) - expected(ekf.x - e)) / (2.0 * step)
            assert abs(measurement.H[0, i] - slope) < 1e-9
        assert abs(math.remainder(measurement.innovation + expected(ekf.x), math.tau)) < 1e-12


def test_bias_turns_with_the_robot_and_back_again(ekf):
    gains = BiasGain(), BiasGain(0.95, 0.3), BiasGain(1.02, -0.2), BiasGain()
    x, P = ekf.x.copy(), ekf.P.copy()
    own, cross = x[State.BIAS], x[State.CROSS_BIAS]
    for before, now in pairwise(gains):
        turn_bias(ekf, before, now)
        assert ekf.x[State.BIAS] == pytest.approx(now.own * own + now.cross * cross)
    np.testing.assert_allclose(ekf.x, x, atol=1e-12)
    np.testing.assert_allclose(ekf.P, P, atol=1e-12)


@pytest.mark.parametrize("sigma", [1.0, 0.1], ids=["walking", "relaxing"])
def test_ten_short_steps_equal_one_long_step(ekf, sigma):
    ekf.config = FusionConfig(initial_rate_sigma=sigma)
    ekf.P[State.RATE, State.RATE] += 0.05  # below 1 and above 0.1 squared all the way
    F, Q = ekf.transition(0.1)
    x, P = F @ ekf.x, F @ ekf.P @ F.T + Q
    for _ in range(10):
        ekf.predict_for(0.01)
    np.testing.assert_allclose(ekf.x, x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ekf.P, P, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-6, 0.01, 0.5, 60.0])
def test_turning_equals_its_matrix_exponential(ekf, dt):
    ekf.config = FusionConfig(initial_rate_sigma=100.0)  # far from relaxing
    F, Q = (matrix[TURNING] for matrix in ekf.transition(dt))
    exact = turning_noise(ekf.config, dt)
    np.testing.assert_allclose(F, exact[0], rtol=1e-9, atol=1e-12)
    scale = np.sqrt(np.outer(np.diag(exact[1]), np.diag(exact[1])))
    if dt > 1e-3:  # for less the exponential has lost the yaw's share, (dt / ramp)^4 of the acceleration's
        # the 3000 steps of a minute add up their rounding of 1e-16 each
        np.testing.assert_allclose(Q / scale, exact[1] / scale, rtol=0, atol=1e-12)
    assert np.all(np.linalg.eigvalsh(Q / np.sqrt(np.outer(np.diag(Q), np.diag(Q)))) > -1e-12)


def test_watched_by_a_gyro_the_rate_walks_as_configured(ekf):
    ekf.config = FusionConfig(watched_rate_walk=0.3)
    watched = ekf.transition(0.05, watched=True)
    ekf.config = FusionConfig(rate_walk=0.3)
    for one, other in zip(watched, ekf.transition(0.05), strict=True):
        np.testing.assert_array_equal(one, other)


def test_process_noise_of_a_relaxing_rate_equals_its_integral(ekf):
    """Q is the integral of white noise through the transition, here summed over 1000 midpoints."""
    ekf.config = FusionConfig(initial_rate_sigma=0.1)
    ekf.P = np.eye(DIM) * 0.05
    total, slices = np.zeros((2, 2)), 1000
    for k in range(slices):
        F, _ = ekf.transition(0.5 * (k + 0.5) / slices)
        through = F[:2, State.RATE]
        total += np.outer(through, through) * ekf.config.rate_walk**2 * 0.5 / slices
    # a midpoint sum of exp(-2 a t) in steps h errs by (2 a h)^2 / 24, a = q / (2 prior), h = 0.5 ms
    error = (ekf.config.rate_walk**2 / 0.1**2 * 0.5e-3) ** 2 / 24.0
    np.testing.assert_allclose(ekf.transition(0.5)[1][:2, :2], total, rtol=1.1 * error)


def test_relaxing_rate_variance_stays_at_prior():
    ekf = YawEkf(FusionConfig())
    for _ in range(600):
        ekf.predict_for(0.1)
    once = YawEkf(ekf.config)
    once.predict_for(60.0)
    # q dt of the last step that still walks: 0.25 * 0.1 of a variance of 1
    for filter_ in (ekf, once):
        assert filter_.P[State.RATE, State.RATE] == pytest.approx(ekf.config.initial_rate_sigma**2, rel=0.025)


def test_clone_is_a_copy_with_all_correlations(ekf):
    ekf.clone_yaw(State.CLONE + 1)
    P = ekf.P
    assert ekf.x[State.CLONE + 1] == ekf.x[State.YAW]
    np.testing.assert_array_equal(P[State.CLONE + 1], P[State.YAW])
    np.testing.assert_array_equal(P[:, State.CLONE + 1], P[:, State.YAW])
    assert P[State.CLONE + 1, State.CLONE + 1] == P[State.YAW, State.YAW]


def test_difference_to_clone_knows_only_what_happened_since(ekf):
    ekf.clone_yaw(State.CLONE)
    before = ekf.P[TURNING][1:, 1:]
    ekf.predict_for(0.1)
    measurement = compass_measurement(ekf, 0.0, 1e-4, State.CLONE, State.YAW)
    H = measurement.H.copy()
    H[0, State.COMPASS_ERROR] = 0.0
    # the turn since the clone is that of rate and acceleration plus their noise, whatever the yaw's own variance
    F, Q = turning_noise(ekf.config, 0.1)
    since = float(F[0, 1:] @ before @ F[0, 1:] + Q[0, 0])
    assert float((H @ ekf.P @ H.T)[0, 0]) == pytest.approx(since, rel=1e-9)


def test_anchor_leaves_no_innovation_and_does_not_move_the_yaw(ekf):
    yaw, variance = ekf.x[State.YAW], ekf.P[State.YAW, State.YAW]
    ekf.anchor(State.CLONE, compass_measurement(ekf, 0.7, 1e-4, State.CLONE, State.YAW))
    again = compass_measurement(ekf, 0.7, 1e-4, State.CLONE, State.YAW)
    assert again.innovation == pytest.approx(0.0, abs=1e-12)
    assert (ekf.x[State.YAW], ekf.P[State.YAW, State.YAW]) == (yaw, variance)
    # nothing is known of the clone but through this increment, so its noise alone is left in the innovation
    H = again.H
    assert float((H @ ekf.P @ H.T)[0, 0]) == pytest.approx(again.R, rel=1e-6)


def test_turn_frame_keeps_turns_and_references(ekf):
    ekf.x[State.YAW] = 4.0 * math.tau + 0.3
    H = compass_measurement(ekf, 0.0, 1e-4, State.CLONE, State.YAW).H
    before = ekf.x[State.YAW] - ekf.x[YAWS], (H @ ekf.P @ H.T).item()
    ekf.turn_frame(-3.0, 0.01)
    assert ekf.x[State.YAW] == pytest.approx(4.0 * math.tau - 3.0 + math.tau)  # nearest turn: 2.98 up, not 3.3 down
    assert ekf.P[State.YAW, State.YAW] == pytest.approx(0.01)
    assert ekf.P[State.YAW, State.BIAS] == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(ekf.x[State.YAW] - ekf.x[YAWS], before[0], atol=1e-12)
    assert (H @ ekf.P @ H.T).item() == pytest.approx(before[1])


@pytest.mark.parametrize("degrees", [0.0, 60.0, 180.0, -120.0])
def test_compass_innovation_is_wrapped(ekf, degrees):
    ekf.x[State.COMPASS_ERROR] = 0.0
    ekf.x[State.CLONE] = 20.0
    ekf.x[State.YAW] = 20.0 + 3.0 * math.tau + math.radians(degrees)
    z = float(wrap_angle(math.radians(degrees) + 0.01))
    assert compass_measurement(ekf, z, 1e-4, State.CLONE, State.YAW).innovation == pytest.approx(0.01, abs=1e-9)


def test_considered_states_keep_value_and_variance(ekf):
    scale, variance = ekf.x[State.SCALE], ekf.P[State.SCALE, State.SCALE]
    ekf.correct(tracks_measurement(ekf, 0.5, 1e-4, modulo_turn=False, alone=True))
    assert ekf.x[State.SCALE] == scale
    assert ekf.P[State.SCALE, State.SCALE] == pytest.approx(variance, rel=2.0 * ROUNDING)
    assert np.all(np.linalg.eigvalsh(ekf.P) > -1e-12)


def test_states_cover_the_vector():
    assert DIM == State.CLONE + CLONES
    assert YAWS.sum() == 3 + CLONES


def test_standstill_tells_nothing_of_scale_factors(ekf):
    """Neither a sensor's scale nor what is known of it changes while nothing turns, however it is correlated."""
    scales = [State.SCALE, State.GYRO_SCALE]
    before = ekf.x[scales].copy(), np.diag(ekf.P)[scales].copy()
    stand_still(ekf, 1.0)
    assert abs(ekf.x[State.RATE]) < 0.01  # it was taken in
    np.testing.assert_array_equal(ekf.x[scales], before[0])
    np.testing.assert_allclose(np.diag(ekf.P)[scales], before[1], rtol=1e-9)
