"""Position by dead reckoning against the simulated truth, and whether its covariance is honest."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, robot_drive

from fusion import FusionConfig, GyroSample, OdometrySample, YawEstimate, YawFusion
from fusion.dead_reckoning import DeadReckoning, Position, Speed

CONFIG = FusionConfig()
SECOND = 1_000_000_000
STARTS = [0.0, 60.0, 180.0, -120.0, math.degrees(math.pi - 1e-9)]


def estimate(t, yaw=0.0, rate=0.0, variance=1e-6, slip=False):
    return YawEstimate(round(t * SECOND), yaw, variance, rate, 1e-6, 0.0, 1e-6, 1.0, 1e-2, slip=slip)


def driven(speed, yaw, rate=0.0, seconds=10.0, hertz=20.0, variance=1e-6, slip=False):
    """Place and reckoning after driving with estimates and samples at the same rate."""
    reckoning, place = DeadReckoning(CONFIG), None
    for k in range(round(seconds * hertz) + 1):
        t = k / hertz
        reckoning.add(OdometrySample(round(t * SECOND), rate, speed))
        place = reckoning.at(estimate(t, yaw + rate * t, rate, variance, slip))
    return place, reckoning


@pytest.mark.parametrize("degrees", STARTS)
def test_straight_drive_goes_along_the_yaw(degrees):
    place, _ = driven(0.5, math.radians(degrees))
    assert (place.x, place.y) == pytest.approx(
        (5 * math.cos(math.radians(degrees)), 5 * math.sin(math.radians(degrees)))
    )
    assert place.speed == 0.5


def test_circle_closes_and_half_of_it_is_its_diameter_to_the_left():
    rate = math.tau / 10.0
    place, _ = driven(0.5, 0.0, rate)
    assert (place.x, place.y) == pytest.approx((0.0, 0.0), abs=1e-3)  # chords of 9 degrees in place of arcs
    half, _ = driven(0.5, 0.0, rate, seconds=5.0)
    assert (half.x, half.y) == pytest.approx((0.0, 2 * 0.5 / rate), rel=2e-3, abs=1e-3)


def test_covariance_of_a_straight_drive_is_that_of_its_derivation():
    """Across: a yaw that is wrong by sigma all the way, times the way. Along: scale times the way, and slip."""
    place, _ = driven(0.5, 0.0, variance=1e-4)
    slip = 2.0 * CONFIG.slip_time * 10.0 * (CONFIG.speed_slip * 0.5) ** 2
    along, across = (CONFIG.speed_scale_sigma * 5.0) ** 2 + slip, 1e-4 * 5.0**2
    assert place.covariance == pytest.approx(np.diag([along, across]), rel=1e-3, abs=1e-12)


def test_covariance_is_that_of_many_drives_with_a_yaw_that_wanders():
    """Out, a turn, back and to the side, each with its own errors: the normalised error squared averages 1."""
    rng = np.random.default_rng(5)
    runs, dt, sigma = 400, 0.1, 0.01
    heading = np.repeat([0.0, math.pi, 0.5 * math.pi], 100)
    walk = np.cumsum(rng.normal(0.0, sigma * math.sqrt(dt), (runs, heading.size)), axis=1)
    keep = math.exp(-dt / 0.5)
    slip = np.zeros((runs, heading.size))
    for k in range(heading.size):
        before = slip[:, k - 1] if k else rng.normal(size=runs)
        slip[:, k] = keep * before + math.sqrt(1.0 - keep**2) * rng.normal(size=runs)
    way = 0.5 * (1.0 + 0.05 * slip + 0.02 * rng.normal(size=(runs, 1))) * dt
    ends = np.stack([(way * np.cos(heading + walk)).sum(1), (way * np.sin(heading + walk)).sum(1)], axis=1)
    position = Position()
    for k, yaw in enumerate(heading):
        position = position.moved(dt, yaw, sigma**2 * dt * (k + 1), Speed(0.5, 0.05 * 0.5, 0.5))
    off = ends - (position.x, position.y)
    nees = np.einsum("ni,ij,nj->n", off, np.linalg.inv(position.covariance(0.02)), off).mean() / 2.0
    # of 400 runs with 2 degrees of freedom each: 1 with a deviation of 1/sqrt(400); 0.1 s steps of a process that
    # lasts 0.5 s add 1 %, second order of the yaw (0.17 rad at the end) up to 2 %
    assert nees == pytest.approx(1.0, abs=4.0 / math.sqrt(runs))


@pytest.mark.parametrize("seed", [0, 1])
def test_drive_with_filter_ends_within_its_sigma(seed):
    """Gyro, tracks and increments of a simulated drive; the speed is 2 % too high and errs by 3 % for a while."""
    drive = robot_drive(seed, seconds=40.0, gyro_hz=25)
    rng = np.random.default_rng(seed)
    fusion, reckoning, grip, place, worst = YawFusion(), DeadReckoning(CONFIG), 0.0, None, 0.0
    true_speed = np.zeros(drive.t.size)
    for sample in drive.samples:
        if isinstance(sample, OdometrySample):
            k = sample.t_ns // 10**6 - 1
            true_speed[k : k + HZ // 20] = sample.speed
    x, y = (np.cumsum(true_speed * turn(drive.yaw[: drive.t.size])) / HZ for turn in (np.cos, np.sin))
    for sample in drive.samples:
        fusion.add(sample)
        if isinstance(sample, OdometrySample):
            grip = 0.9 * grip + math.sqrt(1.0 - 0.9**2) * rng.normal()
            reckoning.add(replace(sample, speed=sample.speed * (1.02 + 0.03 * grip)))
        place = reckoning.at(fusion.estimate()) or place
        if place is not None:
            k = min(sample.t_ns // 10**6, x.size - 1)
            off = np.array([place.x - x[k], place.y - y[k]])
            worst = max(worst, float(off @ np.linalg.solve(place.covariance + 1e-6 * np.eye(2), off)))
    assert np.hypot(x[-1], y[-1]) > 1.0
    assert worst < 3.0**2 * 2.0
    assert np.sqrt(np.trace(place.covariance)) < 0.1 * true_speed.sum() / HZ  # and it says something


def test_tracks_that_never_tell_a_speed_tell_no_place():
    """A driver that leaves the twist empty; or no tracks at all."""
    assert driven(0.0, 0.0)[0] is None
    reckoning = DeadReckoning(CONFIG)
    assert [reckoning.at(estimate(t)) for t in (0.0, 1.0)] == [None, None]


def test_silent_or_slipping_tracks_widen_the_covariance():
    place, reckoning = driven(0.5, 0.0)
    later = reckoning.at(estimate(14.0))
    assert (later.x, later.y) == pytest.approx((place.x, place.y), abs=0.3)  # half a second at the last speed
    assert later.covariance[0, 0] > (0.5 * 3.0) ** 2  # it may have driven on
    assert later.speed_variance >= 0.5**2
    slipped = driven(0.5, 0.0, slip=True)[0]
    assert slipped.covariance[0, 0] > 10.0 * place.covariance[0, 0]


def test_few_estimates_between_many_samples_lose_no_way():
    reckoning = DeadReckoning(CONFIG)
    reckoning.at(estimate(0.0))
    for k in range(101):
        reckoning.add(OdometrySample(k * SECOND // 100, 0.0, 1.0 if k < 50 else 0.0))
    assert reckoning.at(estimate(1.0)).x == pytest.approx(0.5, abs=0.011)


def test_position_that_is_set_counts_from_there():
    _, reckoning = driven(0.5, 0.0)
    reckoning.set_position(-3.0, 7.0, (0.04, 0.01, 0.09))
    place = reckoning.at(estimate(10.0))
    assert (place.x, place.y) == (-3.0, 7.0)
    assert place.covariance == pytest.approx(np.array([[0.04, 0.01], [0.01, 0.09]]))


def test_covariance_stays_one_whatever_the_yaw_s_variance_does():
    rng, position = np.random.default_rng(3), Position()
    for _ in range(2000):
        speed = Speed(float(rng.normal()), 0.01, 0.5)
        position = position.moved(0.1, float(rng.uniform(-4, 4)), float(10.0 ** rng.uniform(-8, 0)), speed)
        joint = np.array(
            [
                [position.xx, position.xy, position.x_yaw],
                [position.xy, position.yy, position.y_yaw],
                [position.x_yaw, position.y_yaw, position.yaw_yaw],
            ]
        )
        assert np.linalg.eigvalsh(joint)[0] > -1e-9 * np.trace(joint)


def test_gyro_alone_is_no_speed():
    fusion, reckoning = YawFusion(), DeadReckoning(CONFIG)
    fusion.add(GyroSample(SECOND, 0.1))
    assert reckoning.at(fusion.estimate()) is None
