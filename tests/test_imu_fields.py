"""What an IMU's fields really hold: no gravity, other units, half messages, wrong orientations, end stops."""

import math
from types import SimpleNamespace as Fields

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_bags import START_NS

from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.imu.vectors import turned
from fusion.messages import MessageError, gyro_sample, odometry_sample
from fusion.offline.bag import Bag
from fusion.offline.bag_writer import BagWriter
from fusion.offline.recording import read_recording
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import TopicSettings

HZ, G = 100, 9.81
UPRIGHT = Rotation.identity()
PITCHED = Rotation.from_euler("y", 15, degrees=True)
Y_UP = Rotation.from_euler("x", 90, degrees=True)  # the IMU's +y looks up
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def drive(mount=UPRIGHT, seconds=8.0, length=G, gravity=True, noise=0.05, wobble=0.0):
    """Turning by 0.8 rad/s from 2 s on: stamp, angular velocity, force in any unit, true orientation."""
    rng = np.random.default_rng(4)
    for k in range(int(seconds * HZ)):
        t = k / HZ
        rate = 0.8 if t > 2.0 else 0.0
        pitch = wobble * math.sin(5.0 * t)
        robot = Rotation.from_euler("ZY", [0.8 * max(t - 2.0, 0.0), pitch])
        body = np.array([-rate * math.sin(pitch), 5.0 * wobble * math.cos(5.0 * t), rate * math.cos(pitch)])
        w = mount.inv().apply(body + rng.normal(0.0, 0.002, 3))
        up = (robot * mount).inv().apply([0.0, 0.0, 1.0]) if gravity else np.zeros(3)
        yield START_NS + k * 10**9 // HZ, w, length * up + rng.normal(0.0, noise, 3), robot * mount


def fed(readings, config=None):
    """A level that has had readings, and its samples."""
    level = ImuLevel(config)
    return level, [level.sample(*reading) for reading in readings]


def codes(level):
    return [warning.code for warning in level.warnings()]


def off_deg(level, mount):
    """Between the vertical found and the true one on level ground."""
    return math.degrees(math.acos(min(float(np.dot(level.up, mount.inv().apply([0.0, 0.0, 1.0]))), 1.0)))


@pytest.mark.parametrize("noise", [0.05, 1.0, 3.0])
def test_vertical_from_accelerometer_without_gravity_is_none(noise):
    level, samples = fed((t, w, a) for t, w, a, _ in drive(gravity=False, noise=noise))
    assert (level.source, codes(level)) == ("none", ["vertical_unknown"])
    assert level.warnings()[0].since_ns < START_NS + 3 * 10**8
    assert "imu.up: +z" in level.warnings()[0].text
    assert np.mean([s.yaw_rate for s in samples[300:]]) == pytest.approx(0.8, abs=0.01)
    assert samples[-1].up is None


@pytest.mark.parametrize("noise", [0.05, 1.0])
def test_vertical_without_gravity_comes_from_the_orientation(noise):
    readings = ((t, w, a, q.as_quat()) for t, w, a, q in drive(Y_UP, gravity=False, noise=noise))
    level, samples = fed(readings)
    assert (level.source, codes(level)) == ("orientation", [])
    assert off_deg(level, Y_UP) < 0.1
    assert samples[-1].up == pytest.approx((0.0, 0.0, 1.0), abs=0.01)


@pytest.mark.parametrize(("length", "named"), [(1.0, "as in g"), (1000.0, "milli-g"), (9810.0, "mm/s^2")])
def test_vertical_in_other_units_is_found_and_the_unit_named(length, named):
    level, _ = fed((t, w, a) for t, w, a, _ in drive(Y_UP, length=length, noise=0.005 * length))
    assert (level.source, codes(level)) == ("gravity", ["accelerometer_units"])
    assert named in level.warnings()[0].text
    assert off_deg(level, Y_UP) < 0.5


def test_vertical_from_raw_numbers_is_believed_only_where_the_config_says_so():
    readings = [(t, w, a) for t, w, a, _ in drive(Y_UP, length=16384.0, noise=50.0)]
    assert codes(fed(readings)[0]) == ["vertical_unknown"]
    level, _ = fed(readings, ImuConfig(up="gravity"))
    assert (off_deg(level, Y_UP) < 0.5, codes(level)) == (True, ["accelerometer_units"])


@pytest.mark.parametrize("nothing", [None, (0.0, 0.0, 0.0), (math.nan,) * 3])
def test_vertical_without_accelerations_is_none_and_says_why(nothing):
    level, _ = fed((t, w, nothing) for t, w, _, _ in drive())
    assert codes(level) == ["vertical_unknown"]
    assert "no accelerations" in level.warnings()[0].text
    assert "+z axis was taken" in level.vertical


def test_vertical_survives_an_accelerometer_that_falls_silent_and_says_so():
    config = ImuConfig(gravity_time=2.0)
    level, _ = fed(((t, w, a if k < 400 else None) for k, (t, w, a, _) in enumerate(drive(Y_UP))), config)
    assert (off_deg(level, Y_UP) < 1.0, codes(level)) == (True, ["vertical_unknown"])
    assert level.warnings()[0].since_ns == pytest.approx(START_NS + 6 * 10**9, abs=5 * 10**7)


def told_by(kind, robot, mount):
    """Orientations as drivers get them wrong."""
    yaw = (robot * mount.inv()).as_euler("zyx")[0]
    return {
        "identity": IDENTITY,
        "constant": (0.5, 0.5, 0.5, 0.5),
        "yaw only": Rotation.from_euler("z", yaw).as_quat(),
        "z down": (Rotation.from_euler("x", 180, degrees=True) * robot).as_quat(),
        "askew": (Rotation.from_euler("x", 15, degrees=True) * robot).as_quat(),
        "inverse": robot.inv().as_quat(),
        "zeros": (0.0, 0.0, 0.0, 0.0),
        "nan": (math.nan,) * 4,
    }[kind]


@pytest.mark.parametrize("kind", ["identity", "constant", "yaw only", "z down", "askew", "inverse", "zeros", "nan"])
def test_orientation_that_contradicts_gravity_is_left_out(kind):
    readings = ((t, w, a, told_by(kind, robot, PITCHED)) for t, w, a, robot in drive(PITCHED))
    level, samples = fed(readings)
    assert level.source == "gravity"
    assert off_deg(level, PITCHED) < 0.5
    assert np.mean([s.yaw_rate for s in samples[300:]]) == pytest.approx(0.8, abs=0.005)
    assert codes(level) == ([] if kind in ("zeros", "nan") else ["orientation_wrong"])


@pytest.mark.parametrize("kind", ["identity", "constant", "yaw only"])
def test_orientation_that_does_not_turn_with_the_gyro_is_left_out_without_gravity(kind):
    readings = ((t, w, None, told_by(kind, robot, PITCHED)) for t, w, _, robot in drive(PITCHED))
    level, _ = fed(readings)
    assert level.source == "none"
    assert sorted(codes(level)) == ["orientation_wrong", "vertical_unknown"]


def test_orientation_of_the_yaw_only_is_left_out_where_the_robot_pitches():
    readings = ((t, w, a, told_by("yaw only", robot, UPRIGHT)) for t, w, a, robot in drive(wobble=0.15))
    assert codes(fed(readings)[0]) == ["orientation_wrong"]
    assert codes(fed((t, w, a, robot.as_quat()) for t, w, a, robot in drive(wobble=0.15))[0]) == []


def test_accelerometer_of_the_wrong_sign_is_told_in_words():
    level, _ = fed((t, w, -a) for t, w, a, _ in drive())
    assert "0 deg from the IMU's -z axis" in level.vertical


def halves(every, gyro_first=True):
    """The drive in messages that bring one of `every` times the gyro, and else the accelerometer."""
    for k, (t, w, a, _) in enumerate(drive()):
        mine = k % every == (0 if gyro_first else every - 1)
        yield (t, w, (0.0, 0.0, 0.0)) if mine else (t, (0.0, 0.0, 0.0), a)


@pytest.mark.parametrize("every", [2, 4])
@pytest.mark.parametrize("gyro_first", [True, False])
def test_half_messages_give_no_zero_rates_and_a_vertical(every, gyro_first):
    level, samples = fed(halves(every, gyro_first))
    rates = [s.yaw_rate for s in samples[240:] if s]
    assert min(rates) > 0.7
    assert len(rates) == 560 // every
    assert (level.source, codes(level)) == ("gravity", ["imu_half_messages"])


def test_half_messages_are_not_seen_in_a_simulated_or_stuck_gyro():
    still = [(t, (0.0, 0.0, 0.0), a) for t, _, a, _ in drive()]
    turns = [(t, (0.0, 0.0, 0.0 if k % 200 < 100 else 0.5), (0.0, 0.0, G)) for k, (t, *_) in enumerate(drive())]
    removed = [(t, w, (0.0, 0.0, 0.0)) for t, w, _ in turns]
    for readings in (still, turns, removed):
        level, samples = fed(readings)
        assert None not in samples
        assert "imu_half_messages" not in codes(level)


def message(t_ns, w, a, missing=()):
    """A sensor_msgs/Imu without ROS."""

    def covariance(name):
        return [-1.0 if name in missing else 0.0] + 8 * [0.0]

    def xyz(v):
        return Fields(x=v[0], y=v[1], z=v[2], w=0.0)

    return Fields(
        header=Fields(stamp=Fields(sec=t_ns // 10**9, nanosec=t_ns % 10**9)),
        angular_velocity=xyz(w),
        angular_velocity_covariance=covariance("gyro"),
        linear_acceleration=xyz(a),
        linear_acceleration_covariance=covariance("accelerometer"),
        orientation=xyz((0.0, 0.0, 0.0)),
        orientation_covariance=covariance("orientation"),
    )


def test_half_messages_by_covariance_still_bring_the_vertical():
    level, refused = ImuLevel(), 0
    for k, (t, w, a, _) in enumerate(drive(Y_UP)):
        try:
            gyro_sample(message(t, w, a, ("orientation", "gyro" if k % 2 else "accelerometer")), level)
        except MessageError:
            refused += 1
    assert (refused, codes(level)) == (400, [])
    assert off_deg(level, Y_UP) < 0.5


def test_half_messages_of_a_bag_are_counted_and_told(tmp_path):
    with BagWriter(tmp_path / "bag.mcap") as bag:
        for t, w, a in halves(2):
            bag.write_imu("/imu/data", t, tuple(map(float, w)), tuple(map(float, a)))
    with Bag(tmp_path / "bag.mcap") as bag:
        choice = choose_topics(bag, TopicSettings(), TopicRequest())
        recording = read_recording(bag, choice, ImuConfig(), 512)
    level, samples = fed(halves(2))
    assert list(recording.gyro.samples()) == [sample for sample in samples if sample]  # as live
    assert sum(recording.dropped.values()) == 400
    assert [w.code for w in recording.warnings] == ["imu_half_messages"]
    assert recording.vertical_words == level.vertical


def clipped(stop, noise=0.002, peak=3.0, seconds=9.0):
    """After a second at rest a turn there and back again, faster than the gyro's range: messages and true rates."""
    rng = np.random.default_rng(2)
    t = np.arange(int(seconds * HZ)) / HZ
    true = peak * np.sin(math.pi * np.maximum(t - 1.0, 0.0) / 2.0)
    rates = np.clip(true + rng.normal(0.0, noise, t.size), -stop, stop)
    return [(START_NS + k * 10**7, (0.0, 0.0, w), (0.0, 0.0, G)) for k, w in enumerate(rates.tolist())], true


@pytest.mark.parametrize(("stop", "noise"), [(2.0, 0.002), (0.5, 0.002), (math.radians(125.0), 0.0)])
def test_end_stop_is_told_and_its_samples_say_that_the_rate_may_be_beyond(stop, noise):
    readings, true = clipped(stop, noise)
    level, samples = fed(readings)
    assert codes(level) == ["gyro_saturated"]
    assert f"z at {stop:.4g} rad/s" in level.warnings()[0].text
    wide = np.array([s.variance is not None for s in samples])
    beyond = np.abs(true) > stop + 0.02
    assert wide[beyond].mean() > 0.98  # all but the first that stood there
    assert wide[np.abs(true) < stop - 0.02].mean() == 0.0


@pytest.mark.parametrize(("noise", "lsb"), [(0.002, 0.0), (0.002, 0.001), (0.002, 0.01), (0.0005, 0.01), (0.0, 0.0)])
def test_end_stop_is_not_seen_in_a_gyro_that_turns_steadily(noise, lsb):
    rng = np.random.default_rng(1)
    t = np.arange(60 * HZ) / HZ
    rates = (
        0.004 + 0.6 * np.clip(np.sin(t / 3.0) * 10.0, -1.0, 1.0) + (rng.normal(0.0, noise, t.size) if noise else 0.0)
    )
    rates = lsb * np.round(rates / lsb) if lsb else rates
    level, samples = fed((k * 10**7, (0.0, 0.0, w), (0.0, 0.0, G)) for k, w in enumerate(rates.tolist()))
    assert codes(level) == []
    assert sum(s.variance is not None for s in samples) < 0.01 * len(samples)


def test_gyro_in_degrees_is_told_once_it_exceeds_what_gyros_measure():
    level, _ = fed((t, np.degrees(w), a) for t, w, a, _ in drive())
    assert codes(level)[0] == "gyro_units"
    assert "deg/s" in level.warnings()[0].text
    assert codes(fed((t, w, a) for t, w, a, _ in drive())[0]) == []


@pytest.mark.parametrize("hz", [10, 50, 100])
def test_vertical_stays_upright_however_far_the_gyro_says_it_turns_between_two_samples(hz):
    rng = np.random.default_rng(3)
    for w in (3.0, math.degrees(0.8), math.degrees(3.0)):
        level, _ = fed(
            (START_NS + k * 10**9 // hz, (0.0, 0.0, w), (*rng.normal(0.0, 0.05, 2), G)) for k in range(8 * hz)
        )
        assert off_deg(level, UPRIGHT) < 0.5


def test_gyro_of_other_axes_than_the_accelerometer_does_not_tip_the_vertical_over():
    level, _ = fed((t, w[::-1], a) for t, w, a, _ in drive())  # x and z swapped
    assert off_deg(level, UPRIGHT) < 1.0
    assert codes(level) == []


def test_robot_that_falls_on_its_side_keeps_its_vertical():
    rng, level = np.random.default_rng(5), ImuLevel()
    for k in range(6 * HZ):
        roll = math.radians(90.0) * min(max(k / HZ - 2.0, 0.0), 1.0)
        rate = math.radians(90.0) if 2.0 <= k / HZ < 3.0 else 0.0
        force = G * np.array([0.0, math.sin(roll), math.cos(roll)]) + rng.normal(0.0, 1.0, 3)
        level.sample(START_NS + k * 10**9 // HZ, (rate, 0.0, 0.0), force)
        if k > HZ:
            assert np.dot(level.up, [0.0, math.sin(roll), math.cos(roll)]) > math.cos(math.radians(6.0))


@pytest.mark.parametrize("moved_by", [("x", 90), ("x", 180), ("y", -60), ("x", 35)])
def test_imu_that_moves_in_its_mount_is_told_and_the_vertical_found_again(moved_by):
    moved, since = Rotation.from_euler(*moved_by, degrees=True), START_NS + 5 * 10**9
    readings = [(t, w, a) for t, w, a, _ in drive(seconds=12.0)]
    level, samples = fed((t, moved.apply(w), moved.apply(a)) if t >= since else (t, w, a) for t, w, a in readings)
    assert codes(level) == ["imu_moved"]
    assert off_deg(level, moved.inv()) < 1.0
    assert all(abs(one.yaw_rate - 0.8) < 0.02 for one in samples[7 * HZ :])
    assert all(one.variance for one in samples[565:610])  # while it is looked at
    assert all(one.up is None or one.up[2] > math.cos(math.radians(3.0)) for one in samples[545:])  # the robot is level


def test_robot_that_is_knocked_hard_has_an_imu_that_did_not_move():
    level, _ = fed((t, w, np.add(a, (7.0 * (k % 200 < 30), 0.0, 0.0))) for k, (t, w, a, _) in enumerate(drive()))
    assert codes(level) == []
    assert off_deg(level, UPRIGHT) < 10.0


def test_fixed_direction_is_turned_as_a_rotation_does():
    rate, fixed = (0.3, -2.0, 46.0), (0.6, 0.0, 0.8)
    expected = Rotation.from_rotvec(np.multiply(-0.1, rate)).apply(fixed)
    assert turned(fixed, rate, 0.1) == pytest.approx(tuple(expected), abs=1e-12)
    assert turned(fixed, (0.0, 0.0, 0.0), 0.1) == fixed


def test_warnings_go_when_their_cause_goes_and_reset_forgets_them():
    level = ImuLevel()
    for k, (t, w, a, _) in enumerate(drive()):
        level.sample(t, w, a if k >= 300 else None)
        if k == 250:
            assert codes(level) == ["vertical_unknown"]
    assert codes(level) == []
    for t, w, _, _ in drive():
        level.sample(t, w)
    level.reset()
    assert (level.warnings(), level.source) == ((), "none")


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (math.nan,) * 4, (5.0, 0.0, 0.0, 1.0)])
def test_odometry_without_a_pose_keeps_its_rates(quaternion):
    turn = Fields(**dict(zip("xyzw", quaternion, strict=True)))
    twist = Fields(angular=Fields(z=0.3), linear=Fields(x=0.1))
    stamp = Fields(sec=1, nanosec=5)
    sample = odometry_sample(
        Fields(header=Fields(stamp=stamp), pose=Fields(pose=Fields(orientation=turn)), twist=Fields(twist=twist))
    )
    assert (sample.t_ns, sample.yaw_rate, sample.speed, sample.yaw) == (1_000_000_005, 0.3, 0.1, None)
