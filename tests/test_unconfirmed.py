"""Until a second sensor speaks, sigma holds what only one has claimed; nothing of it while two agree."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, Eyes, fuse, robot_drive, sensed

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion

FAULT = 20.3  # s; the robot turns, and the slow camera's last image was at 20.017 s


def seen(samples, ride):
    """Stamp, s, error and sigma, deg, and what of the variance is not the filter's own, deg^2, after each sample."""
    fusion, out = YawFusion(FusionConfig(gyro_scale_sigma=0.0)), []  # its part is published beside, too
    for sample in sorted(samples, key=lambda one: one.t_ns):
        fusion.add(sample)
        estimate = fusion.estimate()
        own = float(fusion.state.P[0, 0]) + fusion.state.yaw_lead**2
        error, sigma = ride.error(estimate), math.sqrt(estimate.yaw_variance)
        more = math.degrees(math.degrees(estimate.yaw_variance - own))
        out.append((estimate.t_ns * 1e-9, math.degrees(error), math.degrees(sigma), more))
    return np.array(out).T


def slow_camera(who, change=None, seed=3, since=FAULT):
    """A ride whose camera gives an image a second, of which some sensors speak; a gyro that errs from a time on."""
    ride = robot_drive(seed, seconds=30.0, compass_hz=1)
    if change:
        ride = ride.changed(change, GyroSample, since=since)
    return ride, [sample for sample in ride.samples if isinstance(sample, who)]


REVERSED = lambda s: replace(s, yaw_rate=-s.yaw_rate)  # noqa: E731
STUCK = lambda s: replace(s, yaw_rate=0.0)  # noqa: E731


@pytest.mark.parametrize("change", [REVERSED, STUCK])
@pytest.mark.parametrize("seed", [3, 4, 6])
def test_gyro_that_errs_is_covered_until_the_next_image(change, seed):
    ride, samples = slow_camera((GyroSample, OdometrySample, YawIncrement), change, seed)
    t, error, sigma, _ = seen(samples, ride)
    before = (t > FAULT) & (t < FAULT + 0.7)
    assert (np.abs(error[before]) <= np.maximum(4.0 * sigma[before], 0.1)).all()


def test_images_that_confirm_and_tracks_that_agree_add_next_to_nothing():
    ride, samples = slow_camera((GyroSample, OdometrySample, YawIncrement))
    t, _, sigma, more = seen(samples, ride)
    later = t > 10.0  # the tracks' scale is known
    assert np.median(more[later]) < 0.1 * np.median(sigma[later] ** 2)
    images = np.isin(np.round(t, 3), [round(s.t_ns * 1e-9, 3) for s in samples if isinstance(s, YawIncrement)])
    assert (np.abs(more) < 0.2 * sigma**2)[images & later].all()  # what an image cannot confirm, by its own error


def test_lone_gyro_is_not_contradicted_once_nobody_else_has_spoken_for_a_second():
    ride, samples = slow_camera(GyroSample)
    t, _, _, more = seen(samples, ride)
    assert np.abs(more[t > 1.05]).max() < 1e-9


@pytest.mark.parametrize("who", [(GyroSample, OdometrySample), (GyroSample, YawIncrement)])
def test_gyro_that_errs_from_the_start_is_covered_before_anybody_has_agreed(who):
    """In deg/s: at rest its bias and its noise alone turn the yaw by degrees before the first window is over."""
    ride, samples = slow_camera(who, lambda s: replace(s, yaw_rate=math.degrees(s.yaw_rate)), since=0.0)
    t, error, sigma, _ = seen(samples, ride)
    assert np.abs(error[t < 0.5]).max() > 1.0
    assert (np.abs(error) <= np.maximum(4.0 * sigma, 0.1))[t < 0.5].all()


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_sign_reversed_from_the_start_is_covered_when_the_tracks_first_move(seed):
    """The window in which they begin to move is no agreement: they had said nothing but zero until then."""
    ride, samples = slow_camera((GyroSample, OdometrySample), REVERSED, seed, since=0.0)
    _, error, sigma, _ = seen(samples, ride)
    assert (np.abs(error) <= np.maximum(4.0 * sigma, 0.1)).all()


def test_gyro_is_alone_once_the_camera_has_stopped():
    ride, samples = slow_camera((GyroSample, YawIncrement))
    kept = [s for s in samples if not (isinstance(s, YawIncrement) and s.t_ns > 20.5e9)]
    t, _, _, more = seen(kept, ride)
    assert more[t < 20.5].max() > 1.0  # a turn that no image shows yet
    assert np.abs(more[t > 24.0]).max() < 0.01  # what the last image could not confirm


def test_gyro_and_tracks_that_contradict_stay_in_doubt_while_the_robot_stands():
    ride, samples = slow_camera((GyroSample, OdometrySample), REVERSED)
    t, error, sigma, _ = seen(samples, ride)
    late = t > FAULT + 0.5
    assert (np.abs(error[late]) <= 4.0 * sigma[late]).all()


@pytest.mark.parametrize("hertz", [2, 20])
def test_pose_of_another_publisher_or_after_a_reset_is_no_turn(hertz):
    """A second node on the same topic, or a driver that starts again: no robot turns by 2 rad in between."""
    ride = robot_drive(1, seconds=30.0)
    odd = [replace(s, yaw=s.yaw - 2.0) for s in ride.samples if isinstance(s, OdometrySample)][:: 20 // hertz]
    other = [replace(s, t_ns=s.t_ns + 7_000_000) for s in odd]
    t, error, sigma, _ = seen(ride.samples + other, ride)
    settled = t > 10.0
    assert (np.abs(error[settled]) <= np.maximum(4.0 * sigma[settled], 0.1)).all()
    assert sigma[settled].max() < 1.0


@pytest.mark.parametrize(("seed", "tracks"), [(0, True), (1, True), (4, True), (0, False)])
def test_tracks_settle_what_images_claimed_until_their_next_keyframe(seed, tracks):
    """A place that looks the same, turned by 180 deg: the gate refuses that, and the next keyframe says it no more."""
    ride = robot_drive(seed, seconds=12.0, compass_hz=15, eyes=Eyes(hold=0.3))
    turned = lambda s: replace(s, yaw=float(wrap_angle(s.yaw + math.pi))) if s.t_ref_ns < 9.7e9 else s  # noqa: E731
    ride = ride.changed(turned, YawIncrement, since=9.7)
    if not tracks:
        ride = ride.changed(lambda s: None, OdometrySample)
    fusion, _ = fuse(ride)
    sigma = math.degrees(math.sqrt(fusion.estimate().yaw_variance))
    assert sigma < 1.0 if tracks else sigma > 60.0  # of two sensors nobody knows


def test_tracks_that_rest_while_gyro_and_images_turn_say_nothing():
    """A robot that starts at 1 deg/s may stand beside a crowd, as its dead tracks have it, until it turns otherwise."""
    t = np.arange(8 * HZ) / HZ
    rate = 0.02 + 0.8 * np.sin(t - 2.0) * (t > 2.0)
    ride = sensed(np.random.default_rng(1), rate, 0.3 + 0.0 * t)
    ride = ride.changed(lambda s: replace(s, yaw_rate=0.0, speed=0.0, yaw=0.0), OdometrySample)
    fusion, errors = fuse(ride)
    early = fuse(replace(ride, samples=[s for s in ride.samples if s.t_ns < 1.9e9]))[0].estimate()
    assert early.yaw_variance > math.radians(0.5) ** 2
    assert fusion.estimate().yaw_variance < math.radians(2.0) ** 2
    assert abs(errors[-1]) < math.radians(1.0)
