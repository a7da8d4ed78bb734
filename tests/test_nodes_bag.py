"""Bags played into the nodes: the player itself, and live against offline."""

from __future__ import annotations

import math
import threading
import time

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros_harness import START_NS, Robot, figures, panorama, scene, send_until, stamp_of, wait_for
from ros_process import started
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image, Imu
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from fusion.offline.bag import Bag
from fusion.offline.bag_writer import BagWriter
from fusion.offline.recording import read_recording
from fusion.offline.run import fuse_recording
from fusion.offline.topics import choose_topics
from fusion.settings import load_settings
from nodes.conversions import fused_odometry
from nodes.in_turn import InTurn
from nodes.playback_clock import PlaybackClock
from nodes.quality import EVERY_IMAGE_QOS

MS = 1_000_000
SECOND = 1000 * MS


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


def write_imu_bag(path, seconds=2.0, rate=50):
    """IMU messages in MCAP."""
    with BagWriter(path) as bag:
        for k in range(round(seconds * rate)):
            t_ns = START_NS + k * SECOND // rate
            bag.write_imu("/imu/data", t_ns, (0.0, 0.0, 0.001 * k))


def write_ros1_bag(path, count=20):
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    header, vector = types["std_msgs/msg/Header"], types["geometry_msgs/msg/Vector3"]
    with Ros1Writer(path) as bag:
        connection = bag.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(count):
            t_ns = START_NS + k * 10 * MS
            stamp = types["builtin_interfaces/msg/Time"](*divmod(t_ns, SECOND))
            message = types["sensor_msgs/msg/Imu"](
                header(7 + k, stamp, "imu_link"),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
                np.zeros(9),
                vector(0.1, 0.2, 0.01 * k),
                np.arange(9.0),
                vector(0.0, 0.0, 9.81),
                np.zeros(9),
            )
            bag.write(connection, t_ns, store.serialize_ros1(message, "sensor_msgs/msg/Imu"))


def test_player_plays_every_message_with_its_stamp_and_clock(robot, tmp_path):
    write_imu_bag(tmp_path / "imu.mcap")
    clock, heard = robot.listen(Clock, "/clock"), robot.listen(Imu, "/imu/data")  # in this order the player hears of us
    parameters = {"bagfile": tmp_path / "imu.mcap", "rate": 4.0, "clock_rate": 1000.0, "wait_for": "/imu/data"}
    with started("nodes.bag_player", tmp_path / "log", **parameters) as player:
        assert player.wait() == 0
        assert "played 100 messages" in player.text()
    wait_for(lambda: len(heard) >= 100, "what was played last")
    assert [stamp_of(m) for m in heard] == [START_NS + k * 20 * MS for k in range(100)]
    assert [m.angular_velocity.z for m in heard] == [0.001 * k for k in range(100)]
    wait_for(lambda: clock[-1].clock == heard[-1].header.stamp, "the last tick")
    ticks = [m.clock.sec * SECOND + m.clock.nanosec for m in clock]
    assert ticks == sorted(ticks)
    assert START_NS <= ticks[0] <= ticks[-1] == START_NS + 99 * 20 * MS
    assert len(ticks) > 100  # between the messages, too


def test_player_offset_and_loop(robot, tmp_path):
    write_imu_bag(tmp_path / "imu.mcap")
    heard = robot.listen(Imu, "/imu/data")
    parameters = {"rate": 5.0, "start_offset": 1.0, "loop": True, "wait_for": "/imu/data"}
    with started("nodes.bag_player", tmp_path / "log", bagfile=tmp_path / "imu.mcap", **parameters):
        wait_for(lambda: len(heard) > 110, "the third round")
    stamps = [stamp_of(m) for m in heard]
    assert stamps[:50] == stamps[50:100] == [START_NS + SECOND + k * 20 * MS for k in range(50)]


def test_player_waits_for_the_node_that_tells(robot, tmp_path):
    write_imu_bag(tmp_path / "imu.mcap", seconds=0.2)
    parameters = {"bagfile": tmp_path / "imu.mcap", "image_done": "/fusion_node/image_done"}
    with started("nodes.bag_player", tmp_path / "nobody", wait_time=0.2, **parameters) as player:
        assert player.wait() == 0
        assert "nobody is there to tell on /fusion_node/image_done; playing all the same" in player.text()
        assert "played 10 messages" in player.text()
    heard = robot.listen(Imu, "/imu/data")
    with started("nodes.bag_player", tmp_path / "somebody", wait_time=300.0, wait_for="/imu/data", **parameters):
        time.sleep(0.5)
        assert not heard
        robot.node.create_publisher(Header, "/fusion_node/image_done", EVERY_IMAGE_QOS)
        wait_for(lambda: len(heard) == 10, "what was held back")


def test_player_pauses_and_goes_on(robot, tmp_path):
    write_imu_bag(tmp_path / "imu.mcap")
    heard = robot.listen(Imu, "/imu/data")
    parameters = {"rate": 4.0, "paused": True, "wait_for": "/imu/data"}
    with started("nodes.bag_player", tmp_path / "log", bagfile=tmp_path / "imu.mcap", **parameters) as player:
        clock = robot.listen(Clock, "/clock")
        wait_for(lambda: len(clock) > 20, "a clock that ticks while paused")
        assert heard == []
        assert len({(m.clock.sec, m.clock.nanosec) for m in clock}) == 1
        assert robot.call(SetBool, "/bag_player/pause", SetBool.Request(data=False)).success
        assert player.wait() == 0
    wait_for(lambda: len(heard) >= 100, "what was played last")
    assert len(heard) == 100


def test_player_brings_ros1_bag_to_ros2(robot, tmp_path):
    write_ros1_bag(tmp_path / "old.bag")
    heard = robot.listen(Imu, "/imu/data")
    with started("nodes.bag_player", tmp_path / "log", bagfile=tmp_path / "old.bag", wait_for="/imu/data") as player:
        assert player.wait() == 0
    wait_for(lambda: len(heard) >= 20, "what was played last")
    assert [stamp_of(m) for m in heard] == [START_NS + k * 10 * MS for k in range(20)]
    last = heard[-1]
    assert last.header.frame_id == "imu_link"
    assert (last.angular_velocity.x, last.angular_velocity.z) == (0.1, 0.19)
    assert list(last.angular_velocity_covariance) == list(range(9))


@pytest.mark.parametrize(
    ("parameters", "says"),
    [({}, "bagfile"), ({"bagfile": "nowhere.bag"}, "no such file"), ({"bagfile": "x", "rate": 0.0}, "rate")],
)
def test_player_refuses_in_one_line(parameters, says, tmp_path):
    with started("nodes.bag_player", tmp_path / "log", **parameters) as player:
        assert player.wait() == 1
        assert player.text().count("\n") == 1
        assert says in player.text()


def test_republisher_makes_raw_of_compressed(robot, tmp_path):
    view = panorama(0.3, scene())
    colour = cv2.merge([view, view // 2, 255 - view])
    png = cv2.imencode(".png", colour)[1].tobytes()
    with started("nodes.republish_node", tmp_path / "log"):
        heard = robot.listen(Image, "/viz/pano/image", 1)
        send = robot.connect(CompressedImage, "/viz/pano/image/compressed")
        robot.meet("/republish_node")
        message = CompressedImage(format="png", data=list(png))
        message.header.stamp.sec, message.header.frame_id = 5, "camera"
        send_until(lambda: send(message), lambda: heard, "the raw image")
    raw = heard[0]
    assert (raw.encoding, raw.height, raw.width, raw.step) == ("bgr8", *view.shape, 3 * view.shape[1])
    assert (raw.header.stamp.sec, raw.header.frame_id) == (5, "camera")
    assert np.array_equal(np.frombuffer(raw.data, np.uint8).reshape(colour.shape), colour)


def test_pace_follows_rate_and_pause():
    now = [100.0]
    pace = PlaybackClock(2.0, lambda: now[0])
    pace.start(1000 * SECOND)
    now[0] += 3.0
    assert pace.now_ns() == 1006 * SECOND
    pace.pause(True)
    now[0] += 50.0
    assert pace.now_ns() == 1006 * SECOND
    assert not pace.wait(1000 * SECOND, 0.0)  # nothing is due while paused
    pace.pause(False)
    pace.set_rate(0.5)
    now[0] += 4.0
    assert pace.now_ns() == 1008 * SECOND
    assert pace.wait(1008 * SECOND, 0.0)


class LateImages(BagWriter):
    """Records images 60 ms after their stamp, as slow cameras make it."""

    def write(self, topic, msgtype, t_ns, message):
        super().write(topic, msgtype, t_ns + late_ns(msgtype), message)


def late_ns(kind):
    return 60 * MS if "Image" in kind else 0


IMAGES, IMAGE_NS, GYRO_NS, ODOMETRY_NS = 30, 100 * MS, 20 * MS, 50 * MS
AFTERWARDS = (900 * MS, 1800 * MS, 2700 * MS)


def yaw_at(t):
    return 0.4 * math.sin(1.5 * t)


def pitch_at(t):
    return -0.14 + 0.03 * math.sin(12.0 * t)


def swayed(view, pitch):
    """What a camera sees whose nose went down by so much: the scene rises ahead, and sinks behind."""
    rows, columns = np.indices(view.shape, np.float32)
    down = pitch * view.shape[1] / math.tau * np.cos(math.tau * (columns + 0.5) / view.shape[1] - math.pi)
    return cv2.remap(view, columns, (rows + down).astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def write_drive(path, seed=3):
    """Three seconds of turning to and fro; images are recorded 60 ms late; the last gyro samples long after all else.

    The robot leans and sways, and its IMU tells the compass at each image how. The last samples come
    at most 0.9 s apart: one that is a second ahead of all others waits for another to confirm it.
    """
    rng = np.random.default_rng(seed)
    texture, events = scene(512, 256), []
    for k in range(IMAGES):
        t = k * IMAGE_NS * 1e-9
        view = swayed(panorama(yaw_at(t), texture), pitch_at(t)) + rng.normal(0.0, 2.0, texture.shape)
        jpeg = cv2.imencode(".jpg", np.clip(view, 0, 255).astype(np.uint8))[1].tobytes()
        events.append((k * IMAGE_NS, "Image", jpeg))
    duration = IMAGES * IMAGE_NS
    for t in [*range(-95 * MS, duration, GYRO_NS), *(duration + after for after in AFTERWARDS)]:
        rate = 0.6 * math.cos(1.5 * t * 1e-9) * (t < duration) + 0.01 + rng.normal(0.0, 0.003)
        events.append((t, "gyro", rate))
    for t in range(11 * MS, duration, ODOMETRY_NS):
        events.append((t, "odometry", 0.66 * math.cos(1.5 * t * 1e-9) + rng.normal(0.0, 0.02)))
    with LateImages(path) as bag:
        for t, kind, value in sorted(events, key=lambda event: event[0] + late_ns(event[1])):
            t_ns = START_NS + t
            if kind == "Image":
                bag.write_jpeg("/viz/pano/image/compressed", t_ns, value)
            elif kind == "gyro":
                half = 0.5 * pitch_at(1e-9 * t)
                attitude = (0.0, math.sin(half), 0.0, math.cos(half))
                bag.write_imu("/imu/data", t_ns, (0.0, 0.0, value), (1.4, 0.0, 9.7), attitude)
            else:
                bag.write_odometry("/odom", t_ns, 0.0, value)
    return START_NS + duration + AFTERWARDS[-1]


def fuse_offline(path):
    settings = load_settings()
    with Bag(path) as bag:
        recording = read_recording(bag, choose_topics(bag, settings.topics), settings.imu, settings.compass.columns)
        return fuse_recording(recording, settings)


def play_live(robot, path, last_ns, log):
    """Last fused message of a run at its speed, one image at a time, and what of each sensor became part of it."""
    fused = robot.listen(Odometry, "/odometry/fused")
    diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
    with started("nodes.fusion_node", log / "node", image_transport="compressed", reliable=True):
        robot.meet("/fusion_node")
        topics = "/viz/pano/image/compressed,/imu/data,/odom"
        parameters = {"wait_for": topics, "image_done": "/fusion_node/image_done"}
        with started("nodes.bag_player", log / "player", bagfile=path, **parameters) as player:
            assert player.wait() == 0
        wait_for(lambda: fused and stamp_of(fused[-1]) == last_ns, "the last fused yaw")
        told = len(diagnostics)
        wait_for(lambda: len(diagnostics) > told + 1, "diagnostics after the end")
    assert 2.0 < float(figures(diagnostics, "gyro")["tilt of the robot [deg]"]) < 10.0
    used = {source: int(figures(diagnostics, source)["used"]) for source in ("images", "gyro", "tracks")}
    return fused[-1], used


def test_live_and_offline_end_on_the_same_fused_yaw(robot, tmp_path):
    """Bit for bit, however busy the machine: the same samples give the same yaw, and none of them is lost."""
    last_ns = write_drive(tmp_path / "drive.mcap")
    offline = fuse_offline(tmp_path / "drive.mcap")
    assert offline.rows[-1].fused.t_ns == last_ns
    expected = fused_odometry(offline.rows[-1].fused, ("odom", "base_link"))
    readings = [row.compass for row in offline.rows if row.compass]
    images = 1 + sum(bool(one.increment) for one in readings)  # what is half out of the picture gives no answer
    assert sum(bool(one.long_baseline) for one in readings) >= 2
    assert images > 0.8 * IMAGES
    last, used = play_live(robot, tmp_path / "drive.mcap", last_ns, tmp_path)
    assert used == {"images": images, "gyro": offline.gyro.t_ns.size, "tracks": offline.odometry.t_ns.size}
    assert last == expected


def test_player_steps_seeks_and_stops(robot, tmp_path):
    write_imu_bag(tmp_path / "imu.mcap")
    heard = robot.listen(Imu, "/imu/data")
    parameters = {"bagfile": tmp_path / "imu.mcap", "paused": True, "wait_for": "/imu/data"}
    with started("nodes.bag_player", tmp_path / "log", **parameters) as player:
        clock = robot.listen(Clock, "/clock")
        wait_for(lambda: clock, "a player that is ready")
        for count in (1, 2):
            assert robot.call(Trigger, "/bag_player/step", Trigger.Request()).success
            wait_for(lambda count=count: len(heard) == count, "one message")
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.5)
        request = SetParameters.Request(parameters=[Parameter(name="start_offset", value=value)])
        assert robot.call(SetParameters, "/bag_player/set_parameters", request).results[0].successful
        there = START_NS + 1500 * MS
        wait_for(lambda: clock[-1].clock.sec * SECOND + clock[-1].clock.nanosec == there, "the clock at the new place")
        assert robot.call(Trigger, "/bag_player/step", Trigger.Request()).success
        wait_for(lambda: len(heard) == 3, "one message from there")
        assert robot.call(SetBool, "/bag_player/pause", SetBool.Request(data=False)).success
        assert not robot.call(Trigger, "/bag_player/step", Trigger.Request()).success
        assert robot.call(Trigger, "/bag_player/stop", Trigger.Request()).success
        assert player.wait() == 0
    assert [stamp_of(m) for m in heard[:3]] == [START_NS, START_NS + 20 * MS, there]


def test_image_goes_only_once_the_one_before_is_done():
    turn, playing = InTurn(), [True]
    assert turn.wait(lambda: True)
    turn.begin()
    assert not turn.wait(lambda: True, longest=0.01)
    threading.Timer(0.05, turn.done).start()
    assert turn.wait(lambda: True)
    turn.begin()
    playing.clear()
    assert turn.wait(lambda: bool(playing))  # whoever is closed waits no longer
