"""Faults that hide in the noise of one window, and doubts that must not vanish because two curves cross."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import robot_drive

from compass import YawIncrement, wrap_angle
from fusion import GyroSample, OdometrySample, YawFusion
from fusion.buffer.events import Sensor
from fusion.checks.alternative import Alternative
from fusion.checks.diagnosis import kind_of
from fusion.checks.recovery import Recovery
from fusion.checks.scale_conflict import ScaleConflict
from fusion.checks.windows import Claim, Window

S = 10**9
FLOOR = math.radians(0.02)  # of sigma, below which nobody cares


def run(drive, who=object):
    """Times, errors and sigmas (rad) each tenth of a second, and seconds that each ``code:sensor`` was told."""
    fusion, rows, told = YawFusion(), [], {}
    for sample in drive.samples:
        if not isinstance(sample, who):
            continue
        fusion.add(sample)
        if not rows or sample.t_ns * 1e-9 >= rows[-1][0] + 0.1:
            estimate = fusion.estimate()
            rows.append((sample.t_ns * 1e-9, drive.error(estimate), math.sqrt(estimate.yaw_variance)))
            for warning in estimate.warnings:
                key = f"{warning.code}:{warning.sensor}"
                told[key] = told.get(key, 0.0) + 0.1
    return *np.array(rows).T, told


def crowd(drive, rate, since):
    """All that the images show walks round the robot from a time on, s, at a rate, rad/s."""

    def change(s):
        return replace(s, yaw=float(wrap_angle(s.yaw + rate * (s.t_ns * 1e-9 - max(s.t_ref_ns * 1e-9, since)))))

    return drive.changed(change, YawIncrement, since)


@pytest.mark.parametrize(("rate", "since"), [(0.014, 12.0), (-0.03, 0.0), (0.01, 0.0), (-0.01, 15.0)])
def test_images_that_drift_slowly_are_covered(rate, since):
    t, error, sigma, told = run(crowd(robot_drive(1, seconds=35.0), rate, since))
    late = t > since + 2.0
    assert np.max(np.abs(error[late]) / np.maximum(sigma[late], FLOOR)) < 4.0
    assert any(key.startswith("sensors_disagree") and "compass" in key for key in told)


@pytest.mark.parametrize("step", [0.008, -0.015])
@pytest.mark.parametrize("drives", [False, True])
def test_bias_that_steps_while_the_robot_stands_shows_beside_tracks(step, drives):
    """Also before they have ever said anything but zero."""
    drive, begins = robot_drive(4, seconds=30.0), 2.0
    if drives:  # and then it stands for the rest of the time
        begins = 20.0
        drive = stopped(drive, 15.0)
    else:
        drive = stopped(drive, 0.0)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + step), GyroSample, begins)
    t, error, sigma, _ = run(drive, (GyroSample, OdometrySample))
    late = t > begins + 4.0
    assert np.max(np.abs(error[late]) / np.maximum(sigma[late], FLOOR)) < 3.0


@pytest.mark.parametrize("rate", [0.03, 0.1])
def test_robot_that_is_carried_round_while_its_tracks_rest_is_covered(rate):
    """A gyro at one rate has another bias then; that the robot turns stays possible as long as it does not drive."""
    begins = 12.0
    drive = stopped(robot_drive(4, seconds=30.0), 8.0)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + rate), GyroSample, begins)
    t, error, sigma, _ = run(drive, (GyroSample, OdometrySample))
    unknown = rate * np.maximum(t - begins, 0.0)
    assert np.max((np.abs(error - unknown) / np.maximum(sigma, FLOOR))[t > begins]) < 3.0


def stopped(drive, since):
    """The drive, but that the robot stands from a time on, s."""
    last = [s for s in drive.samples if isinstance(s, OdometrySample) and s.t_ns * 1e-9 <= since]
    yaw = last[-1].yaw if last else 0.0
    true = np.interp(np.minimum(drive.t, since), drive.t, drive.yaw)
    rng = np.random.default_rng(0)

    def stands(s):
        if isinstance(s, OdometrySample):
            return replace(s, yaw_rate=0.0, speed=0.0, yaw=yaw)
        return replace(s, yaw_rate=0.003 + 0.003 * rng.normal())

    ride = drive.changed(stands, (OdometrySample, GyroSample), since)
    return replace(ride, yaw=true)


@pytest.mark.parametrize("since", [13.0, 17.3])
def test_gyro_that_hangs_beside_tracks_is_found(since):
    drive = robot_drive(3, seconds=30.0)
    hangs = next(s for s in drive.samples if isinstance(s, GyroSample) and s.t_ns * 1e-9 >= since)
    drive = drive.changed(lambda s: replace(s, yaw_rate=hangs.yaw_rate), GyroSample, since)
    _, error, sigma, told = run(drive, (GyroSample, OdometrySample))
    assert "gyro_stuck:gyro" in told
    assert np.max(np.abs(error) / np.maximum(sigma, FLOOR)) < 4.0


def test_odometry_in_degrees_beside_two_that_agree_is_named_and_leaves_the_yaw_alone():
    def degrees(s):
        return replace(s, yaw_rate=math.degrees(s.yaw_rate), yaw=math.degrees(s.yaw))

    t, error, sigma, told = run(robot_drive(2, seconds=30.0).changed(degrees, OdometrySample))
    assert sum(told.values()) > 10.0
    assert {key.split(":")[1] for key in told} == {
        "tracks"
    }  # by its poses, which are degrees modulo 6.28, it is no scale
    assert np.abs(error[t > 15.0]).max() < math.radians(0.5)
    assert sigma[t > 15.0].max() < math.radians(2.0)


@pytest.mark.parametrize(("times", "asks"), [(57.3, True), (57.3 * 1.3, True), (57.3 * 1.6, True), (3.0, False)])
def test_odometry_in_degrees_is_told_whatever_its_own_scale_factor(times, asks):
    turns = (0.1, 0.2, -0.15)
    windows = [
        Window(k * S, (k + 1) * S, None, Claim(times * turn, 0.01), Claim(turn, 0.001), turn)
        for k, turn in enumerate(turns)
    ]
    kind = kind_of(Sensor.TRACKS, Sensor.COMPASS, windows)
    assert kind.code == "sensors_disagree_scale"
    assert ("degrees" in kind.remedy) is asks


def test_one_window_that_agrees_does_not_heal_what_is_lost_in_noise():
    """Wald's bound: with odds of 1,000 a fault heals by chance once in 1,000 windows; here 40 times half a minute."""
    noise, rng, by_chance = 2e-3, np.random.default_rng(0), 0
    for _ in range(40):
        errs, well = Recovery.begun(0.02), False
        for off in 0.5 * 0.014 + noise * rng.normal(size=60):
            errs = errs.weighed(off, noise**2, 0.5)
            well = well or errs.well
        by_chance += well
    assert by_chance < 6
    heals = Recovery.begun(0.014)
    for off in noise * rng.normal(size=6):
        heals = heals.weighed(off, noise**2, 0.5)
    assert heals.well


def test_one_window_heals_what_erred_by_far():
    assert Recovery.begun(1.0).weighed(1e-3, 1e-4, 0.5).well


def test_conflict_of_scales_is_owed_where_the_turn_began_and_after_it_has_vanished():
    conflict = ScaleConflict(0.0).after(S, 2.0, 0.1, 1e-6, 0.02)
    assert math.sqrt(conflict.variance(0.0)) == pytest.approx(
        0.2, rel=1e-3
    )  # back at the start: it may have begun at 2
    assert math.sqrt(conflict.left(5.0)) == pytest.approx(0.3, rel=1e-3)
    assert conflict.after(2 * S, 5.0, 0.01, 1e-6, 0.02).left(5.0) == 0.0


def test_what_tracks_claimed_at_most_is_kept_as_their_scale_is_not_known():
    alternative = Alternative(Sensor.TRACKS, 0, 0.0)
    for index, turn in enumerate((0.2, -0.2)):
        alternative = alternative.plus(turn, Window(index * S, (index + 1) * S, None, None, None, 0.0))
    assert alternative.offset == pytest.approx(0.0)
    assert alternative.variance(2 * S) >= Alternative(Sensor.TRACKS, 0, 0.2).variance(0)


@pytest.mark.parametrize(
    ("seed", "step", "since", "gyro_hz", "track_hz", "camera_delay"),
    [
        pytest.param(5152, -0.011, 22.1, 100, 20, 0.03, id="stops before a camera that is late"),
        pytest.param(3160, 0.0187, 20.6, 50, 50, 0.0, id="as if the camera were late, at one stop"),
        pytest.param(8823, -0.0082, 16.8, 50, 50, 0.0, id="as if stamps strayed"),
        pytest.param(3045, 0.0075, 15.1, 100, 50, 0.03, id="as if the gyro had another scale"),
    ],
)
def test_bias_that_steps_beside_all_sensors_is_covered(seed, step, since, gyro_hz, track_hz, camera_delay):
    """And what else could explain it for a while is no reason to forget by how much the sensors differed."""
    drive = robot_drive(seed, seconds=45.0, gyro_hz=gyro_hz, track_hz=track_hz, camera_delay=camera_delay)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + step), GyroSample, since)
    _, error, sigma, _ = run(drive)
    ratio = np.abs(error) / np.maximum(sigma, FLOOR)
    assert np.max(ratio) < 4.0
    assert np.sum(ratio > 3.0) * 0.1 < 1.0


@pytest.mark.parametrize("rate", [0.0, 0.4])
@pytest.mark.parametrize("seed", [3, 8])
def test_gyro_that_breaks_beside_a_late_camera_is_covered(seed, rate):
    """It told by how much the robot turned from the images' exposures to their stamps, and told it wrongly."""
    drive = robot_drive(seed, seconds=30.0, camera_delay=0.05)
    moving = drive.t[np.flatnonzero(np.abs(np.gradient(drive.yaw, drive.t)) > 0.6)]
    since = float(moving[moving > 10.0][0]) + 0.5
    drive = drive.changed(lambda s: replace(s, yaw_rate=rate), GyroSample, since, since + 3.5)
    t, error, sigma, _ = run(drive)
    late = t > since + 1.0
    assert np.max(np.abs(error[late]) / np.maximum(sigma[late], FLOOR)) < 3.0


@pytest.mark.parametrize(("step", "since"), [(-0.013, 3.3), (0.012, 11.5), (0.016, 20.0)])
def test_bias_that_steps_beside_tracks_is_learnt_once_they_rest(step, since):
    drive = stopped(robot_drive(5, seconds=45.0), 24.0)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + step), GyroSample, since)
    fusion = YawFusion()
    for sample in drive.samples:
        if not isinstance(sample, YawIncrement):
            fusion.add(sample)
    estimate = fusion.estimate()
    assert estimate.gyro_bias == pytest.approx(0.003 + step, abs=0.002)
    assert abs(drive.error(estimate)) < 3.0 * math.sqrt(estimate.yaw_variance)


def test_bias_that_steps_at_the_end_of_a_turn_is_no_delay_of_the_camera():
    """In both windows the turn rate grew alike: one bias explains the contradiction as well as one delay does."""
    drive = robot_drive(1147, seconds=35.0, camera_delay=0.03)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate - 0.0326), GyroSample, 25.72)
    t, error, sigma, told = run(drive)
    late = t > 25.72
    assert np.max(np.abs(error[late]) / np.maximum(sigma[late], FLOOR)) < 3.0
    assert "sensors_disagree_bias:gyro" in told


@pytest.mark.parametrize(("seed", "begins"), [(6894, 14.1), (2, 10.0)])
def test_bias_in_a_turn_is_no_jitter_of_the_images(seed, begins):
    """What images say in a turn of a gyro's bias keeps its sign; what they say by jitter does not."""
    drive = robot_drive(seed, seconds=begins + 15.0, gyro_hz=100, track_hz=50)
    drive = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + 0.0037), GyroSample, begins)
    fusion, most = YawFusion(), 0.0
    for sample in drive.samples:
        fusion.add(sample)
        if sample.t_ns * 1e-9 > begins + 3.0:
            most = max(most, math.sqrt(fusion.state.jitter.variance))
    assert most < 2e-3


@pytest.mark.parametrize(("seed", "since"), [(1, 8.6), (4, 13.05), (6, 18.0)])
def test_gyro_that_hangs_at_rest_beside_slow_images_is_not_believed_to_see_the_start(seed, since):
    """It had noise at rest before, and the number is no zero that a driver says."""
    drive = robot_drive(seed, seconds=30.0, gyro_hz=50, compass_hz=2)
    assert np.ptp(drive.yaw[round(since * 1e3) : round(since * 1e3) + 1500]) == 0.0
    hangs = next(s for s in drive.samples if isinstance(s, GyroSample) and s.t_ns * 1e-9 >= since)
    drive = drive.changed(lambda s: replace(s, yaw_rate=hangs.yaw_rate), GyroSample, since)
    _, error, sigma, told = run(drive, (GyroSample, YawIncrement))
    assert "gyro_stuck:gyro" in told
    assert np.max(np.abs(error) / np.maximum(sigma, FLOOR)) < 4.0
