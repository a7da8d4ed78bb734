"""Links that hang, clocks that are wrong, gyros that jump, robots that are lifted, settings at their limits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import fuse, robot_drive

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion

S = 10**9
BEGIN_NS = 10**18
RATE = 0.3  # rad/s of the robot that turns steadily
FLOOR = math.radians(0.02)


def assert_honest(estimate, true_yaw, most_sigma_deg):
    """The yaw within 3 sigma of the truth, and sigma finite and bounded."""
    sigma = math.sqrt(estimate.yaw_variance)
    off, sigma_deg = math.degrees(estimate.yaw - true_yaw), math.degrees(sigma)
    assert math.isfinite(estimate.yaw)
    assert abs(off) <= math.degrees(3.0 * max(sigma, FLOOR)), f"off by {off:.2f} deg, sigma {sigma_deg:.3f}"
    assert sigma_deg <= most_sigma_deg, f"off by {off:.2f} deg, sigma {sigma_deg:.3f}"


def steady(start, end):
    """Samples of a gyro at 100 Hz and tracks at 50 Hz, from one second to another."""
    for k in range(round(start * 100), round(end * 100)):
        t_ns = BEGIN_NS + k * 10**7
        yield GyroSample(t_ns, RATE)
        if k % 2 == 0:
            yield OdometrySample(t_ns + 1000, RATE, 0.1, math.remainder(RATE * k / 100, math.tau))


def feed(fusion, samples):
    for sample in samples:
        fusion.add(sample)


NOW_NS = BEGIN_NS + 6 * S
BURSTS = {
    "gyro, 1.5 s old": [GyroSample(NOW_NS - 3 * S // 2 + k * 10**7, RATE) for k in range(12)],
    "gyro, 1.5 s old, 40 of them": [GyroSample(NOW_NS - 3 * S // 2 + k * 10**7, RATE) for k in range(40)],
    "gyro, an hour old": [GyroSample(NOW_NS - 3600 * S + k * 10**7, RATE) for k in range(12)],
    "gyro, one old stamp": [GyroSample(NOW_NS - 2 * S, RATE + k * 1e-6) for k in range(12)],
    "tracks, an hour ahead": [OdometrySample(NOW_NS + 3600 * S + k * 22 * 10**6, RATE, 0.1, 0.1) for k in range(12)],
    "compass, an hour ahead": [
        YawIncrement(NOW_NS + 3600 * S + k * 10**8, NOW_NS + 3600 * S + (k + 1) * 10**8, 0.03, 1e-8, 0.9)
        for k in range(12)
    ],
}


@pytest.mark.parametrize("name", BURSTS)
def test_burst_of_wrong_stamps_does_not_move_the_yaw(name):
    fusion = YawFusion()
    feed(fusion, steady(0, 6))
    feed(fusion, BURSTS[name])
    feed(fusion, steady(6.02, 9))
    assert_honest(fusion.estimate(), RATE * 8.99, 10.0)


HANGS = [("tracks", 40, 0.9), ("tracks", 40, 1.3), ("tracks", 40, 2.0), ("tracks", 20, 2.0), ("tracks", 50, 1.5)]
HANGS += [("gyro", 100, seconds) for seconds in (0.9, 1.2, 1.5)]
NAMED_HANGS = {f"{who} at {hertz} Hz for {seconds} s": (who, hertz, seconds) for who, hertz, seconds in HANGS}


def hung(who, hertz, seconds, *, sorted_again):
    """All samples as they arrive when one sensor's link hangs from 6 s on; its backlog alone, or sorted by stamp."""
    held, batch = [], []
    for k in range(1200):
        t, t_ns = k / 100, BEGIN_NS + k * 10**7
        batch = [GyroSample(t_ns, RATE)]
        if k % (100 // hertz if who == "tracks" else 2) == 0:
            batch.append(OdometrySample(t_ns + 1000, RATE, 0.1, math.remainder(RATE * t, math.tau)))
        mine = [s for s in batch if isinstance(s, GyroSample) == (who == "gyro")]
        if 6 <= t < 6 + seconds:
            held += mine
            batch = [s for s in batch if s not in mine]
        elif held:
            batch, held = held + batch, []
            if sorted_again:
                batch.sort(key=lambda s: s.t_ns)
        yield from batch


@pytest.mark.parametrize("sorted_again", [True, False], ids=["sorted", "backlog first"])
@pytest.mark.parametrize("name", NAMED_HANGS)
def test_link_that_hangs_and_delivers_its_backlog(name, sorted_again):
    fusion = YawFusion()
    feed(fusion, hung(*NAMED_HANGS[name], sorted_again=sorted_again))
    assert_honest(fusion.estimate(), RATE * 11.99, 10.0)
    assert not fusion.counts["reset: time jumped back"]


@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.parametrize("step", [0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.5])
def test_gyro_whose_bias_steps_is_honest_18_s_later(step, seed):
    drive = robot_drive(seed, seconds=32.0, gyro_hz=50, track_hz=20)
    fusion, errors = fuse(drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + step), GyroSample, 14.0))
    estimate = fusion.estimate()
    assert_honest(estimate, estimate.yaw - errors[-1], 5.0)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_small_step_of_the_bias_is_honest_all_the_way(seed):
    """It shows in several windows together, and in none alone."""
    drive = robot_drive(seed, seconds=32.0, gyro_hz=50, track_hz=20)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + 0.005), GyroSample, 14.0)
    fusion = YawFusion()
    for sample in drive.samples:
        fusion.add(sample)
        if isinstance(sample, YawIncrement):
            estimate = fusion.estimate()
            assert_honest(estimate, estimate.yaw - drive.error(estimate), 3.0)


def test_gyro_that_never_changes_is_named_beside_tracks_alone():
    """It turns while sound tracks stand, so that at first they seem to say nothing."""
    drive = robot_drive(3, seconds=30.0)
    samples = [s for s in drive.samples if not isinstance(s, YawIncrement)]
    stuck = [replace(s, yaw_rate=0.05) if isinstance(s, GyroSample) else s for s in samples]
    fusion = YawFusion()
    feed(fusion, stuck)
    estimate = fusion.estimate()
    assert_honest(estimate, estimate.yaw - drive.error(estimate), 90.0)
    assert ("gyro_stuck", "gyro") in {(warning.code, warning.sensor) for warning in estimate.warnings}


LIFTED_S, DARK_S = 15.0, 2.0


def lifted(turn_deg, *, gyro=True, gyro_in_the_dark=False, speed=0.3, seed=0):
    """A robot that is lifted and turned in the dark, unseen by its tracks; the compass finds the place again; its yaw.

    The yaw swings by 0.2 rad all the time, and the tracks claim 1.3 times that.
    """
    rng = np.random.default_rng(seed)

    def swing(t):
        return 0.2 * math.sin(0.5 * t)

    def yaw(t):
        return swing(t) + math.radians(turn_deg) * min(max((t - LIFTED_S) / DARK_S, 0.0), 1.0)

    def rate(of, t):
        return (of(t + 0.005) - of(t - 0.005)) / 0.01

    samples = []
    for k in range(4000):
        t, t_ns = k / 100, S + k * 10**7
        dark = LIFTED_S - 0.1 <= t < LIFTED_S + DARK_S + 0.1
        if gyro and (gyro_in_the_dark or not dark):
            samples.append(GyroSample(t_ns, rate(yaw, t) + 0.003 + 0.0025 * rng.normal()))
        if k % 3 == 0:
            samples.append(OdometrySample(t_ns + 1000, 1.3 * rate(swing, t), speed, 1.3 * swing(t)))
        if k % 10 == 0 and k and not dark:
            before = LIFTED_S - 0.2
            found_again = LIFTED_S + DARK_S <= t < LIFTED_S + DARK_S + 0.35
            ref = before if found_again else max(0.0, k // 20 * 20 / 100 - 0.2)
            turned = float(wrap_angle(yaw(t) - yaw(ref) + 1e-4 * rng.normal()))
            confidence = 0.6 if found_again else 0.95
            samples.append(YawIncrement(S + round(ref * S) + 2000, t_ns + 2000, turned, 1e-8, confidence))
    return samples, yaw(39.99)


@pytest.mark.parametrize(
    ("turn_deg", "how"),
    [
        (90.0, {}),
        (90.0, {"gyro_in_the_dark": True}),
        (90.0, {"gyro": False}),
        (90.0, {"speed": 0.0}),
        (-90.0, {}),
        (30.0, {}),
        (10.0, {}),
    ],
)
def test_robot_that_is_lifted_and_turned_in_the_dark(turn_deg, how):
    samples, true_yaw = lifted(turn_deg, **how)
    fusion = YawFusion()
    feed(fusion, samples)
    assert_honest(fusion.estimate(), true_yaw, 30.0)


LIMITS = [{"initial_rate_sigma": 100.0}, {"rate_walk": 0.001}, {"rate_walk": 1e-4}]
LIMITS += [{"initial_rate_sigma": 10.0, "watched_rate_walk": 0.1}]


AT_LIMITS = {f"{sensors} {values}": (sensors, values) for sensors in ("gtc", "t", "c") for values in LIMITS}


@pytest.mark.parametrize("name", AT_LIMITS)
def test_accepted_settings_give_finite_numbers(name):
    sensors, values = AT_LIMITS[name]
    fusion = YawFusion(FusionConfig(**values))
    for k in range(1500):
        t_ns = BEGIN_NS + k * 10**7
        if "g" in sensors:
            fusion.add(GyroSample(t_ns, 0.1 + 0.0025 * math.sin(k * k)))
        if "t" in sensors and k % 5 == 0:
            fusion.add(OdometrySample(t_ns + 1000, 0.1, 0.2, 0.1 * k * 0.01))
        if "c" in sensors and k % 10 == 0 and k:
            fusion.add(YawIncrement(BEGIN_NS, t_ns + 2000, float(wrap_angle(0.1 * k * 0.01)), 1e-8, 0.9))
        estimate = fusion.estimate()
        if estimate:
            assert math.isfinite(estimate.yaw)
            assert estimate.yaw_variance > 0.0


@pytest.mark.parametrize(
    ("seconds_ahead", "count", "step_ms"), [(2.3, 41, 22), (0.3, 42, 100), (5.0, 60, 10), (30.0, 200, 22)]
)
def test_time_that_jumps_ahead_with_one_sensor_and_comes_back_costs_no_yaw(seconds_ahead, count, step_ms):
    """So many samples ahead look like a time that has passed; when all others go on where they were, it had not."""
    fusion = YawFusion()
    feed(fusion, steady(0, 6))
    for k in range(count):
        t_ns = NOW_NS + round(seconds_ahead * S) + k * step_ms * 10**6
        fusion.add(OdometrySample(t_ns, RATE, 0.1, 0.1))
    feed(fusion, steady(6.02, 9))
    assert_honest(fusion.estimate(), RATE * 8.99, 10.0)


@pytest.mark.parametrize("seen_deg", [0.0, 60.0, -138.0, 175.0])
def test_robot_turned_in_the_dark_stays_where_it_was_found_while_it_stands(seen_deg):
    """Tracks saw no turn, the camera finds the place again: nothing moves afterwards, nor does sigma shrink."""
    fusion, seen = YawFusion(), []
    for k in range(2000):
        t, t_ns = k / 100, BEGIN_NS + k * 10**7
        if k % 3 == 0:
            fusion.add(OdometrySample(t_ns, 0.0, 0.0, 0.0))
        if k % 20 == 10 and not 7.9 < t < 11.6:
            reference_ns = BEGIN_NS + 7_900_000_000 if 11.6 < t < 12.6 else t_ns - 200_000_000
            turned = math.radians(seen_deg) if 11.6 < t < 12.6 else 0.0
            fusion.add(YawIncrement(reference_ns, t_ns, turned, 1e-8, 0.9))
        if t > 13.5:
            seen.append(fusion.estimate())
    assert max(e.yaw for e in seen) - min(e.yaw for e in seen) < math.radians(1.0)
    for estimate in seen:
        assert_honest(estimate, math.radians(seen_deg), 400.0)
