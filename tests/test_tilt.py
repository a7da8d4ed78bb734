"""A robot that leans: what turns about its own axis have to do with its heading."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from robot_drive import fuse, robot_drive
from scipy.spatial.transform import Rotation

from compass import CompassConfig, VisualCompass, YawIncrement
from compass.tilt import Tilted, beyond_error
from fusion import GyroSample, OdometrySample, YawFusion
from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.imu.tilt import TILT_ERROR, BiasGain, TiltLog, heading_change, heading_gain
from fusion.offline.summary import remarks
from fusion.state.ekf import State
from fusion.state.track_claim import OdometryFields

DEG = math.radians(1.0)
BIAS = np.array([0.004, -0.005, 0.003])  # rad/s, of a gyro's three axes


def up_of(attitude):
    return tuple(attitude.inv().apply([0.0, 0.0, 1.0]).tolist())


def heading_of(attitude):
    nose = attitude.apply([1.0, 0.0, 0.0])
    return np.arctan2(nose[..., 1], nose[..., 0])


@pytest.mark.parametrize("seed", range(20))
def test_change_of_heading_is_that_of_the_nose(seed):
    rng = np.random.default_rng(seed)
    before = Rotation.from_euler("ZYX", rng.uniform([-3.0, -0.7, -0.7], [3.0, 0.7, 0.7]))
    turn, tilt = rng.uniform(-3.0, 3.0), rng.uniform(-0.3, 0.3, 2)
    after = before * Rotation.from_rotvec([-tilt[0], -tilt[1], 0.0]) * Rotation.from_rotvec([0.0, 0.0, turn])
    change = heading_change(up_of(after), turn, tuple(tilt))
    assert abs(change - turn) < math.pi
    assert math.remainder(change - (heading_of(after) - heading_of(before)), math.tau) == pytest.approx(0.0, abs=1e-12)


def test_on_level_ground_turn_and_heading_are_one():
    assert heading_change((0.0, 0.0, 1.0), 7.0) == pytest.approx(7.0)
    assert heading_gain((0.0, 0.0, 1.0)) == 1.0


def test_robot_on_its_side_does_not_blow_up_the_bias():
    assert BiasGain.tilted((0.0, 0.999, 0.04)) == BiasGain()
    fusion = YawFusion()
    for k in range(2000):
        roll = 1.7 * math.sin(0.002 * k)
        assert fusion.add(GyroSample(k * 10**7, 0.003, up=(0.0, math.sin(roll), math.cos(roll))))
    estimate = fusion.estimate()
    assert 0.0 < estimate.gyro_bias_variance < 0.02
    assert math.isfinite(estimate.yaw)
    assert 0.0 < estimate.yaw_variance < 1.0


def test_robot_that_stands_on_its_nose_has_no_heading():
    assert heading_change((0.99, 0.0, 0.14), 0.5) == 0.5
    assert heading_gain((0.99, 0.0, 0.14)) == 1.0
    assert BiasGain.tilted((0.99, 0.0, 0.14)) == BiasGain()


@pytest.mark.parametrize("lean_deg", [5.0, 20.0])
@pytest.mark.parametrize("turn", [0.1, 0.8, 1.6, 3.0])
def test_variance_is_that_of_headings_from_wrong_leans(lean_deg, turn):
    rng, sigma, lean, seen = np.random.default_rng(0), 1e-3, math.radians(lean_deg), []
    for towards in np.linspace(0.0, math.tau, 40, endpoint=False):
        up = math.sin(lean) * np.array([math.cos(towards), math.sin(towards), 0.0]) + [0.0, 0.0, math.cos(lean)]
        leans, true = Tilted.upright(tuple(up)), heading_change(tuple(up), turn)
        assert leans.before(turn, (0.0, 0.0))[1] == pytest.approx(math.remainder(true, math.tau))
        for error in sigma * rng.normal(size=(40, 2)):
            wrong = Rotation.from_rotvec([*error, 0.0]).apply(up)
            seen.append(heading_change(tuple(wrong), turn) - true)
    assert np.mean(np.square(seen)) / leans.variance(turn, sigma) == pytest.approx(1.0, abs=0.2)


def test_errors_of_roll_and_pitch_do_not_make_a_level_robot_lean():
    assert beyond_error((0.01, -0.01, math.sqrt(1.0 - 2e-4)), TILT_ERROR) == (0.0, 0.0, 1.0)
    rng, true = np.random.default_rng(0), np.array([math.sin(0.2), 0.0, math.cos(0.2)])
    errors = TILT_ERROR / math.sqrt(2.0) * rng.normal(size=(4000, 2))
    seen = [beyond_error(tuple(Rotation.from_rotvec([*e, 0.0]).apply(true)), TILT_ERROR) for e in errors]
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1.0)
    assert np.mean([x**2 + y**2 for x, y, _ in seen]) == pytest.approx(true[0] ** 2, rel=0.01)
    x, y, z = beyond_error((0.3, 0.2, -math.sqrt(1.0 - 0.13)), TILT_ERROR)
    assert (x / 0.3, z < -0.9) == (pytest.approx(y / 0.2), True)


@pytest.mark.parametrize("pitch_deg", [-20.0, 0.0, 15.0])
@pytest.mark.parametrize("roll_deg", [-10.0, 25.0])
def test_gains_are_those_of_rates_that_imu_level_gives(pitch_deg, roll_deg):
    attitude = Rotation.from_euler("ZYX", [40.0, pitch_deg, roll_deg], degrees=True)
    up, level = up_of(attitude), ImuLevel(ImuConfig(up="orientation"))

    def rate(w):
        return level.sample(0, w, None, attitude.as_quat()).yaw_rate

    gain = BiasGain.tilted(up)
    assert heading_gain(up) == pytest.approx(rate((0.0, 0.0, 1.0)))
    assert (gain.own, gain.cross) == pytest.approx((rate((0.0, 0.0, 1.0)), rate((0.0, 1.0, 0.0))))
    assert rate((1.0, 0.0, 0.0)) == pytest.approx(0.0, abs=1e-12)


def turning(mount, lean_deg, seconds=8.0, rate=0.5):
    """What an IMU says of a robot that turns on a slope, and the vertical in the robot's frame."""
    slope = Rotation.from_euler("y", lean_deg, degrees=True)
    for k in range(int(100 * seconds)):
        robot = slope * Rotation.from_euler("z", rate * k / 100.0)
        imu = robot * mount
        w, f = mount.inv().apply([0.0, 0.0, rate]), imu.inv().apply([0.0, 0.0, 9.81])
        yield (k * 10**7, w, f, imu.as_quat()), up_of(robot)


@pytest.mark.parametrize(
    ("mount_deg", "lean_deg", "known_s"),
    [(0.0, 0.0, 0.0), (0.0, 20.0, 0.0), (4.0, 0.0, 0.0), (25.0, 0.0, 0.0), (45.0, 0.0, 1.0)],
    ids=["level", "on a slope", "a little askew", "pitched on purpose", "half way over"],
)
def test_lean_is_known_in_any_mount_once_the_robot_has_turned(mount_deg, lean_deg, known_s):
    mount, level = Rotation.from_euler("y", mount_deg, degrees=True), ImuLevel(ImuConfig(forward="+x"))
    known = [(1e-9 * reading[0], level.sample(*reading).up, up) for reading, up in turning(mount, lean_deg)]
    assert next(t for t, told, _ in known if told) == pytest.approx(known_s, abs=0.05)
    _, told, up = known[-1]
    assert math.degrees(math.acos(min(float(np.dot(told, up)), 1.0))) < 1.5


def test_lean_is_not_told_by_an_axis_that_is_given_or_by_nothing():
    for config, force in ((ImuConfig(up="+z"), (0.0, 0.0, 9.81)), (ImuConfig(), None)):
        assert ImuLevel(config).sample(0, (0.0, 0.0, 0.1), force).up is None


def on_slope(seed, lean_deg, *, told=True, off=None, **kwargs):
    """A drive in a place that has sunk: true heading, gyro of three biased axes, compass and tracks about the axis."""
    drive, off = robot_drive(seed, bias=0.0, **kwargs), off or Rotation.identity()
    slope, level = Rotation.from_euler("y", lean_deg, degrees=True), ImuLevel()
    yaw = drive.yaw + np.unwrap(heading_of(slope * Rotation.from_euler("z", drive.yaw[:, None])) - drive.yaw)
    yaw -= math.tau * np.round(yaw[0] / math.tau)

    def change(sample):
        if isinstance(sample, YawIncrement):
            up = up_of(off * slope * Rotation.from_euler("z", drive.yaw[sample.t_ref_ns // 10**6]))
            variance = Tilted.upright(up).variance(sample.yaw, CompassConfig().tilt_sigma) if told else 0.0
            return replace(sample, variance=sample.variance + variance, turn=sample.yaw)
        if isinstance(sample, OdometrySample):
            return sample
        robot = slope * Rotation.from_euler("z", drive.yaw[sample.t_ns // 10**6])
        rates, force = BIAS + np.array([0.0, 0.0, sample.yaw_rate]), robot.inv().apply([0.0, 0.0, 9.81])
        gyro = level.sample(sample.t_ns, rates, force, (off * robot).as_quat())
        return gyro if told else replace(gyro, up=None)

    return replace(drive, yaw=yaw, samples=[change(sample) for sample in drive.samples])


@pytest.mark.parametrize("lean_deg", [0.0, 10.0, 30.0])
@pytest.mark.parametrize("seed", range(2))
def test_fused_heading_on_a_slope_is_right_within_its_sigma(seed, lean_deg):
    drive = on_slope(seed, lean_deg)
    fusion, errors = fuse(drive)
    assert np.sqrt(np.mean(errors**2)) < 0.5 * DEG
    assert errors[-1] ** 2 / fusion.estimate().yaw_variance < 9.0
    assert fusion.estimate().track_scale == pytest.approx(1.35, abs=0.05)


@pytest.mark.parametrize("about", ["x", "y"])
def test_vertical_that_errs_is_in_sigma(about):
    """A vertical that is off by twice its deviation, alike for all sensors: none contradicts."""
    drive = on_slope(1, 30.0, off=Rotation.from_euler(about, 2.0 * TILT_ERROR))
    fusion, worst = YawFusion(), 0.0
    for sample in drive.samples:
        fusion.add(sample)
        estimate = fusion.estimate()
        worst = max(worst, abs(drive.error(estimate)) / math.hypot(math.sqrt(estimate.yaw_variance), 0.02 * DEG))
    assert worst < 4.0


def test_slope_that_nobody_tells_of_would_cost_degrees():
    """So the tests above test something."""
    _, errors = fuse(on_slope(2, 30.0, told=False))
    assert np.sqrt(np.mean(errors**2)) > 2.0 * DEG


def test_bias_follows_the_lean():
    drive = on_slope(0, 20.0)
    fusion, _ = fuse(drive)
    up = next(sample.up for sample in reversed(drive.samples) if isinstance(sample, GyroSample))
    gain, estimate = BiasGain.tilted(up), fusion.estimate()
    true = gain.own * BIAS[2] + gain.cross * BIAS[1]
    assert abs(estimate.gyro_bias - true) < 4.0 * math.sqrt(estimate.gyro_bias_variance) < 0.004


def test_bias_of_the_cross_axis_is_what_it_says_at_rest():
    drive = on_slope(0, 20.0)
    fusion, before = YawFusion(), None
    for sample in drive.samples:
        fusion.add(sample)
        cross = fusion.state.x[State.CROSS_BIAS], fusion.state.P[State.CROSS_BIAS, State.CROSS_BIAS] ** 0.5
        if fusion.estimate().standstill and before is None:
            before = cross
    assert before[1] > 0.002
    assert abs(cross[0] - BIAS[1]) < 4.0 * cross[1] < 0.001


def test_tracks_poses_and_rates_become_the_headings():
    """A turn on a slope by poses at 40 Hz; the pose goes from half a turn to minus half a turn on the way."""
    slope, voice, headings = Rotation.from_euler("y", 25.0, degrees=True), OdometryFields(), []
    angles = np.linspace(0.0, 6.0, 241)
    true = np.unwrap(heading_of(slope * Rotation.from_euler("z", angles[:, None])))
    for k, angle in enumerate(angles):
        up = up_of(slope * Rotation.from_euler("z", angle))
        sample = OdometrySample(k * 25_000_000, 1.0, 0.0, math.remainder(angle, math.tau))
        voice, heard = voice.after(sample, up)
        headings.append(heard.yaw)
    assert np.unwrap(headings[1:])[-1] - headings[1] == pytest.approx(true[-1] - true[1], abs=1e-3)
    assert heard.yaw_rate == pytest.approx((true[-1] - true[-2]) / 0.025, abs=0.01)


def test_compass_that_is_told_how_it_leans_says_headings():
    """The photograph of a place that has sunk by 20 deg, turned by whole columns about the camera's own axis."""
    rng, slope = np.random.default_rng(0), Rotation.from_euler("y", 20.0, degrees=True)
    scene = cv2.GaussianBlur(rng.integers(0, 255, (256, 512), np.uint8), (0, 0), 2.0)
    columns = [0, 20, 45, 80, 128, 160]
    turns = [column * math.tau / 512 for column in columns]
    leans = [up_of(slope * Rotation.from_euler("z", turn)) for turn in turns]
    compass = VisualCompass(CompassConfig(columns=512), lambda t_ns: leans[t_ns // 10**8])
    level = VisualCompass(CompassConfig(columns=512))
    for k, column in enumerate(columns):
        image = np.roll(scene, column, axis=1)
        told, guessed = compass.update(k * 10**8, image), level.update(k * 10**8, image)
    true = heading_change(leans[-1], turns[-1])
    assert abs(true - turns[-1]) > 0.01
    assert (compass.yaw, level.yaw) == pytest.approx((true, turns[-1]), abs=2e-4)
    assert told.turn == guessed.turn == pytest.approx(turns[-1], abs=2e-4)
    assert told.variance > guessed.variance


def test_user_is_told_that_the_robot_leant_or_that_a_gap_was_crossed():
    knows = {"camera_delay_s": None, "camera_delay_sigma_s": None, "images": {}}
    knows |= {"camera_roll_deg": 3.0, "camera_pitch_deg": -3.9, "camera_tilt_sigma_deg": 0.1}
    assert remarks(knows | {"greatest_tilt_deg": None}) == remarks(knows | {"greatest_tilt_deg": 5.0}) == []
    assert "tilted by up to 20 deg" in remarks(knows | {"greatest_tilt_deg": 20.4})[0]
    askew = knows | {"greatest_tilt_deg": None, "camera_pitch_deg": -12.0}
    assert "roll 3.0 and pitch -12.0 +- 0.1 deg" in remarks(askew)[0]
    assert remarks(askew | {"camera_tilt_sigma_deg": 4.2}) == []
    found = remarks(knows | {"greatest_tilt_deg": None, "images": {"ok": 9, "found_again": 2}})
    assert found == ["after 2 gaps in what the camera showed the compass found its last view again"]


def test_log_of_leans_knows_the_last_before_in_any_order_of_arrival():
    log, leans = TiltLog(), {t: (0.0, math.sin(t * 1e-9), math.cos(t * 1e-9)) for t in range(0, 10**9, 10**7)}
    assert log.at(0) is None
    for t in np.random.default_rng(0).permutation(list(leans)).tolist():
        log.add(GyroSample(t, 0.0, up=leans[t]))
    log.add(GyroSample(2 * 10**9, 0.0))
    log.add(GyroSample(495_000_000, 0.0, up=(math.nan, 0.0, 1.0)))
    assert log.at(508_000_000) == leans[490_000_000]
    assert log.at(500_000_000) == leans[490_000_000]  # but for what may not have come yet
    assert log.at(1_050_000_000) == leans[990_000_000]
    assert log.at(1_200_000_000) is None
    log.clear()
    assert log.at(0) is None


def test_log_of_leans_knows_how_the_robot_has_turned_since():
    slope, log = Rotation.from_euler("y", 25.0, degrees=True), TiltLog()
    for t in range(0, 10**9, 10**7):
        log.add(GyroSample(t, 0.8, up=up_of(slope * Rotation.from_euler("z", 0.8e-9 * t))))
    for t in (400_000_000, 405_000_000, 1_080_000_000):
        assert log.at(t) == pytest.approx(up_of(slope * Rotation.from_euler("z", 0.8e-9 * t)), abs=1e-12)
