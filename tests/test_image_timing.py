"""Between exposure and stamp of an image: the gyro's trail, and the delay that the filter learns by it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import ratios_at_images, robot_drive

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, Sensor, YawFusion
from fusion.state.ekf import DIM, State, YawEkf
from fusion.state.gyro_trail import TRAIL_NS, GyroTrail
from fusion.state.learnt_noise import JITTERS, LearntNoise
from fusion.updates.image_timing import clone_exposure, exposure, mean_turning, told_of_delay

SECOND = 10**9


def trail_of(rate, seconds=1.0, step_s=0.005):
    trail = GyroTrail()
    for t in np.arange(0.0, seconds + 1e-9, step_s):
        trail = trail.add(round(t * SECOND), float(rate(t)), None)
    return trail


def test_trail_integrates_the_rate_and_holds_the_last():
    trail = trail_of(lambda t: 0.2 + t)
    for t in (0.0, 0.1234, 0.5, 1.0):
        assert trail.turn_at(round(t * SECOND)) == pytest.approx(0.2 * t + 0.5 * t**2)
    assert trail.turn_at(SECOND + SECOND // 10) - trail.turn_at(SECOND) == pytest.approx(0.12)
    assert trail.turn_at(-SECOND // 10) == pytest.approx(-0.02)


def test_trail_forgets_what_is_long_ago():
    trail = trail_of(lambda t: 0.3, 3.0, 0.01)
    assert len(trail.points) <= TRAIL_NS // 10**7 + 2
    assert trail.turn_at(3 * SECOND) == pytest.approx(0.9)


@pytest.mark.parametrize(("after", "turned"), [(0.8, True), (1.2, True), (0.1, False), (0.0, False)])
def test_trail_takes_a_refused_rate_for_a_turn_where_the_next_one_is_like_it(after, turned):
    trail = trail_of(lambda t: 0.0, 1.0, 0.1).refusing(round(1.1 * SECOND), 1.0, None)
    assert trail.turn_at(round(1.1 * SECOND)) == 0.0
    trail = trail.add(round(1.2 * SECOND), after, None)
    expected = 0.05 + 0.05 * (1.0 + after) if turned else 0.1 * after
    assert trail.turn_at(round(1.2 * SECOND)) == pytest.approx(expected)


@pytest.mark.parametrize("refused", [0.0, 2.0])
def test_turn_since_the_last_gyro_sample_is_as_uncertain_as_delay_and_rate_are(refused):
    ekf, spread = YawEkf(FusionConfig()), 0.04
    ekf.x[State.RATE] = 0.5
    ekf.P[State.RATE, State.RATE], ekf.P[State.CAMERA_DELAY, State.CAMERA_DELAY] = 0.3**2, spread**2
    trail = trail_of(lambda t: 0.5)
    known = exposure(ekf, SECOND, trail, refused=refused).variance
    found = exposure(ekf, SECOND + SECOND // 10, trail, refused=refused).variance
    assert found - known == pytest.approx((0.3**2 + refused**2) * spread**2)


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1])
def test_linearisation_over_an_uncertain_delay_is_exact_where_the_rate_changes_steadily(delay):
    rate, acceleration, sigma = 0.4, 1.5, 0.04
    trail = trail_of(lambda t: rate + acceleration * (t - 0.7), 1.0, 0.002)
    found = trail.exposure(round(0.7 * SECOND), delay, sigma**2, 0.0)
    # the turn is rate * d - acceleration * d^2 / 2 with d normal: mean, regression on d, and what that leaves
    assert found.turn == pytest.approx(rate * delay - 0.5 * acceleration * (delay**2 + sigma**2), abs=1e-6)
    assert found.rate == pytest.approx(rate - acceleration * delay, abs=1e-5)
    assert found.variance == pytest.approx(0.5 * (acceleration * sigma**2) ** 2, rel=1e-3)


def test_known_delay_leaves_no_variance():
    trail = trail_of(lambda t: math.sin(5.0 * t))
    found = trail.exposure(SECOND, 0.05, 0.0, 1e-4)
    assert found.turn == pytest.approx((math.cos(5.0 * 0.95) - math.cos(5.0)) / 5.0, abs=1e-5)
    assert found.variance == 0.0


@pytest.mark.parametrize("watched", [True, False], ids=["gyro", "no gyro"])
def test_jacobian_of_the_exposed_yaw_equals_finite_differences(watched):
    """With a known delay; `SHORTEST_STEP` is as nothing where the rate changes steadily."""
    trail = trail_of(lambda t: 0.3 + 0.8 * t) if watched else None
    ekf = YawEkf(FusionConfig(camera_delay_sigma=0.0, compass_timing=0.0))
    x = ekf.x.copy()
    x[[State.YAW, State.RATE, State.BIAS, State.GYRO_SCALE, State.CAMERA_DELAY]] = 0.7, 0.5, 0.02, 0.01, 0.06

    def exposed(state):
        ekf.x = state
        ekf.tape = []
        clone_exposure(ekf, State.CLONE, exposure(ekf, SECOND, trail))
        return ekf.x[State.CLONE], ekf.tape[0].F[State.CLONE]

    _, row = exposed(x.copy())
    step = 1e-5
    for i in set(range(DIM)) - {State.CLONE}:
        if i == State.CAMERA_DELAY and not watched:
            assert row[i] == 0.0  # taken for known
            continue
        e = step * np.eye(DIM)[i]
        slope = (exposed(x + e)[0] - exposed(x - e)[0]) / (2.0 * step)
        assert row[i] == pytest.approx(slope, abs=1e-6)


def swinging(delay_s, seed, rate=0.5, seconds=20.0, stray_s=0.001):
    """A robot that stands for two seconds, then swings to and fro; images at 15 Hz, stamped too late by the delay."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 1000)) * 1e-3
    true_rate = rate * np.sin(2.0 * math.pi * (t - 2.0) / 5.0) * (t > 2.0)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (true_rate[1:] + true_rate[:-1])) * 1e-3])
    samples = []
    for k in range(0, t.size, 10):
        samples.append(GyroSample(k * 10**6, float(true_rate[k] + 0.003 + 0.0025 * rng.normal())))
    for k in range(0, t.size, 20):
        samples.append(OdometrySample(k * 10**6, 1.3 * true_rate[k], 0.0, float(wrap_angle(1.3 * yaw[k]))))
    stamps = np.arange(150, t.size, 67)
    exposed = np.interp(stamps * 1e-3 - delay_s + stray_s * rng.normal(size=stamps.size), t, yaw)
    for k in range(1, stamps.size):
        since = (k - 1) // 60 * 60  # a keyframe holds for four seconds
        turn = float(wrap_angle(exposed[k] - exposed[since] + 5e-5 * rng.normal()))
        samples.append(YawIncrement(int(stamps[since]) * 10**6, int(stamps[k]) * 10**6, turn, 2.5e-9, 0.99))
    return sorted(samples, key=lambda sample: sample.t_ns), t, yaw


@pytest.mark.parametrize("delay_s", [-0.01, 0.0, 0.02, 0.05, 0.1])
def test_delay_of_the_camera_is_found_and_does_no_harm(delay_s):
    normalised = []
    for seed in range(2):
        samples, t, yaw = swinging(delay_s, seed)
        fusion = YawFusion()
        for sample in samples:
            fusion.add(sample)
            if isinstance(sample, YawIncrement):
                estimate = fusion.estimate()
                sigma = math.sqrt(estimate.camera_delay_variance)
                error = estimate.yaw - float(np.interp(sample.t_ns * 1e-9, t, yaw))
                normalised.append(error**2 / estimate.yaw_variance)
                if 3 * SECOND < sample.t_ns < 3.1 * SECOND:  # a second after the robot began to move
                    # a gyro's scale that is off by 1 % makes of the 0.55 s * rate turned by then what 6 ms would
                    assert abs(estimate.camera_delay - delay_s) < 3.0 * sigma < 0.01
        assert abs(estimate.camera_delay - delay_s) < 4.0 * sigma < 0.004
        assert fusion.reports()[Sensor.COMPASS].rejected <= 3
    assert np.mean(normalised) < 1.0


def test_delay_known_beforehand_is_taken_out_without_a_gyro_too():
    samples, t, yaw = swinging(0.2, 0)
    fusion = YawFusion(FusionConfig(camera_delay=0.2, camera_delay_sigma=0.0))
    errors = []
    for sample in samples:
        if not isinstance(sample, GyroSample):
            fusion.add(sample)
            errors.append(fusion.estimate().yaw - float(np.interp(sample.t_ns * 1e-9, t, yaw)))
    assert np.sqrt(np.mean(np.square(errors))) < math.radians(1.5)  # 0.2 s at 0.35 rad/s: 4 deg


def test_without_a_gyro_the_sigma_tells_what_is_not_known_of_the_delay():
    fusion = YawFusion(FusionConfig(camera_delay_sigma=0.05))
    for k in range(1, 60):
        fusion.add(YawIncrement(0, k * 10**8, float(wrap_angle(0.04 * k)), 1e-8, 0.99))
    assert math.sqrt(fusion.estimate().yaw_variance) == pytest.approx(0.4 * 0.05, rel=0.1)


@pytest.mark.parametrize("seed", range(2))
def test_delay_that_jumps_does_no_harm(seed):
    """As when the camera's driver is started again: gyro and tracks outvote the compass."""
    before, _, _ = swinging(0.0, seed, seconds=30.0)
    after, t, yaw = swinging(0.08, seed, seconds=30.0)
    cut = 14 * SECOND
    samples = [s for s in before if s.t_ns < cut or not isinstance(s, YawIncrement)]
    samples += [s for s in after if isinstance(s, YawIncrement) and s.t_ref_ns >= cut]
    fusion, normalised = YawFusion(), []
    for sample in sorted(samples, key=lambda s: s.t_ns):
        fusion.add(sample)
        estimate = fusion.estimate()
        error = estimate.yaw - float(np.interp(sample.t_ns * 1e-9, t, yaw))
        normalised.append(error**2 / estimate.yaw_variance)
        assert abs(error) < math.radians(0.5)
    assert np.mean(normalised) < 2.0


@pytest.mark.parametrize("images_hz", [10, 30])
@pytest.mark.parametrize("noise", [0.0025, 0.03])
def test_delay_is_not_learnt_from_the_noise_of_a_straight_drive(noise, images_hz):
    """A gyro's noise that is taken for a turn rate says that there is no delay, a little with each image."""
    rng = np.random.default_rng(1)
    samples = [GyroSample(k * 5 * 10**6, 0.003 + noise * float(rng.normal())) for k in range(6000)]
    samples += [OdometrySample(k * 2 * 10**7, 0.0, 0.5, 0.0) for k in range(1500)]
    stamps = [k * 10**9 // images_hz for k in range(30 * images_hz)]
    samples += [
        YawIncrement(stamps[(k - 1) // 60 * 60], t_ns, float(5e-5 * rng.normal()), 2.5e-9, 0.99)
        for k, t_ns in enumerate(stamps)
        if k
    ]
    fusion = YawFusion()
    for sample in sorted(samples, key=lambda sample: sample.t_ns):
        fusion.add(sample)
    estimate = fusion.estimate()
    assert not estimate.standstill
    assert abs(estimate.camera_delay) < math.sqrt(estimate.camera_delay_variance)
    assert math.sqrt(estimate.camera_delay_variance) > 0.8 * fusion.config.camera_delay_sigma


def test_turn_rate_tells_of_the_delay_as_far_as_it_is_more_than_noise():
    noise, rng = 1e-2, np.random.default_rng(2)
    trail, told, turning = GyroTrail(), {}, 0.0
    for k in range(800):
        trail = trail.add(k * 5 * 10**6, 0.1 * (k >= 400) + noise * float(rng.normal()), None)
        if k % 10 == 9:
            turning = mean_turning(turning, trail.exposure(k * 5 * 10**6, 0.0, 0.05**2, noise**2))
            told[k] = told_of_delay(turning)
    straight, turn = ([told[k] for k in told if since < k < since + 300] for since in (100, 500))
    assert max(straight) < 0.4
    assert np.median(straight) == 0.0
    assert min(turn) > 0.95


@pytest.mark.parametrize("stray_s", [0.0, 0.001, 0.005, 0.015, 0.03])
def test_stray_of_the_stamps_is_found_and_the_sigma_knows_of_it(stray_s):
    """Taken for 5 ms whatever it is, 30 ms end up to 4.7 deg off, and the error squared is 40 times its variance."""
    normalised = []
    for seed in range(2):
        samples, t, yaw = swinging(0.02, seed, stray_s=stray_s)
        fusion = YawFusion()
        for sample in samples:
            fusion.add(sample)
            if isinstance(sample, YawIncrement):
                estimate = fusion.estimate()
                error = estimate.yaw - float(np.interp(sample.t_ns * 1e-9, t, yaw))
                normalised.append(error**2 / estimate.yaw_variance)
        found = math.sqrt(fusion.state.jitter.variance)
        assert found == pytest.approx(max(stray_s, JITTERS[0]), rel=0.5)
        assert fusion.reports()[Sensor.COMPASS].rejected <= 6
        assert abs(error) < math.radians(0.3)
    assert np.mean(normalised) < 2.5


def test_stray_known_exactly_is_not_learnt():
    for stray in (LearntNoise.jitter(0.004, 1.0), LearntNoise.jitter(0.0, 2.0)):
        assert stray.after(1.0, 1e-8, 1.0) is stray
        assert stray.variance == stray.known**2


def test_stray_is_not_learnt_while_the_robot_hardly_turns():
    stray = LearntNoise.jitter(0.005, 2.0)
    assert stray.after(1e-3, 1e-6, 0.01) is stray


@pytest.mark.parametrize("true_s", [0.001, 0.02])
def test_stray_follows_the_innovations_whatever_was_known_beforehand(true_s):
    rng = np.random.default_rng(2)
    stray = LearntNoise.jitter(0.005, 2.0)
    for _ in range(200):
        stray = stray.after(float(np.hypot(true_s * 0.5, 1e-4) * rng.normal()), 1e-8, 0.5)
    assert math.sqrt(stray.variance) == pytest.approx(true_s, rel=0.25)


@pytest.mark.parametrize("lopsided", [0.06, 0.08])
def test_gyro_that_turns_farther_to_the_left_than_to_the_right_is_no_stray_of_the_stamps(lopsided):
    """A drift between gyro and images keeps its sign; taken for jitter it switches the images off: 58 deg off at 12."""

    def turned(sample):
        return replace(sample, yaw_rate=sample.yaw_rate * (1.0 + math.copysign(lopsided, sample.yaw_rate)))

    drive = robot_drive(2, seconds=40.0).changed(turned, GyroSample)
    fusion = YawFusion()
    ratios, told = ratios_at_images(fusion, drive)
    assert math.sqrt(fusion.state.jitter.variance) < 0.01
    assert (ratios > 4.0).mean() < 0.01  # until an image shows it
    assert "sensors_disagree_scale" in {code for code, _ in told}
