"""The nodes as separate processes on the real rclpy."""

from __future__ import annotations

import math
import signal
from itertools import count

import pytest
from nav_msgs.msg import Odometry
from ros_harness import (
    LOST_S,
    START_NS,
    Robot,
    image_message,
    imu_message,
    jpeg_message,
    odometry_message,
    panorama,
    scene,
    send_until,
    stamp_of,
    wait_for,
    yaw_of,
)
from ros_process import started
from sensor_msgs.msg import CompressedImage, Image, Imu
from std_srvs.srv import Empty

FRAME_NS = 50_000_000
TURN = math.radians(2.0)  # per frame
RATE = TURN / (FRAME_NS * 1e-9)


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


def serve(send, messages, heard, what):
    """Send one message at a time, each once the one before it is answered: nothing depends on speed."""
    for message in messages:
        t_ns = stamp_of(message)
        send_until(
            lambda message=message: send(message),
            lambda t_ns=t_ns: heard and stamp_of(heard[-1]) >= t_ns,
            f"{what} at {t_ns}",
            pause=LOST_S,
        )


def first_image(image, message_at, heard):
    """Show the first view again and again until an increment comes: the first image has nothing to compare with."""
    stamps = count(START_NS - 60_000_000, 100_000)
    send_until(lambda: image(message_at(next(stamps))), lambda: heard, "the first increment", 0.1)


def test_fusion_node_turn_gives_raw_and_fused_yaw(robot, tmp_path):
    texture = scene()
    # the robot turns at once by 40 deg/s: it cannot tell that from images that come late
    with started("nodes.fusion_node", tmp_path / "log", **{"fusion.camera_delay_sigma": 0.0}) as node:
        compass = robot.listen(Odometry, "/compass_pose")
        fused = robot.listen(Odometry, "/odometry/fused")
        gyro = robot.connect(Imu, "/imu/data")
        tracks = robot.connect(Odometry, "/odom")
        image = robot.connect(Image, "/viz/pano/image")
        robot.meet("/fusion_node")
        first_image(image, lambda t: image_message(t, panorama(0.0, texture)), compass)
        for k in range(1, 21):
            t = START_NS + k * FRAME_NS
            serve(gyro, [imu_message(t, RATE)], fused, "fused yaw")
            serve(tracks, [odometry_message(t + 1, RATE)], fused, "fused yaw")
            serve(image, [image_message(t, panorama(k * TURN, texture))], compass, "compass")
        # 20 frames of 2 degrees; at 512 columns a pixel is 0.7 degrees, and the texture has no noise
        assert math.degrees(yaw_of(compass[-1])) == pytest.approx(40.0, abs=0.1)
        assert compass[-1].twist.twist.angular.z == pytest.approx(RATE, rel=0.02)
        assert stamp_of(compass[-1]) == START_NS + 20 * FRAME_NS
        assert math.degrees(yaw_of(fused[-1])) == pytest.approx(40.0, abs=0.5)
        assert (node.end(signal.SIGTERM), node.complaints()) == (0, [])


def test_compass_node_compressed_images(robot, tmp_path):
    texture = scene()
    parameters = {"image_transport": "compressed", "compass_image": "/camera", "compass_textout": True}
    with started("nodes.compass_node", tmp_path / "log", **parameters) as node:
        compass = robot.listen(Odometry, "/compass_pose")
        image = robot.connect(CompressedImage, "/camera/compressed")
        robot.meet("/compass_node")
        first_image(image, lambda t: jpeg_message(t, panorama(0.0, texture)), compass)
        frames = [jpeg_message(START_NS + k * FRAME_NS, panorama(-k * TURN, texture)) for k in range(1, 6)]
        serve(image, frames, compass, "compass")
        answers = [stamp_of(message) for message in compass if stamp_of(message) > START_NS]
        assert answers == [stamp_of(frame) for frame in frames]
        assert math.degrees(yaw_of(compass[-1])) == pytest.approx(-10.0, abs=0.2)

        wait_for(lambda: "angle -10.0" in node.text() or "angle -9.9" in node.text(), "the angle printed")

        robot.call(Empty, "/compass_node/reset", Empty.Request())
        times = count(6)

        def still():
            image(jpeg_message(START_NS + next(times) * FRAME_NS, panorama(1.0, texture)))

        send_until(still, lambda: stamp_of(compass[-1]) > answers[-1], "an increment after the reset", 0.1)
        assert math.degrees(yaw_of(compass[-1])) == pytest.approx(0.0, abs=0.2)  # counted from where it was reset
        assert node.end(signal.SIGINT) == 0
