"""Reset, set_pose and jumps of time."""

from __future__ import annotations

import math
import signal
from itertools import count, cycle

import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from ros_harness import (
    LOST_S,
    START_NS,
    Robot,
    image_message,
    imu_message,
    panorama,
    scene,
    send_until,
    stamp_of,
    wait_for,
    yaw_of,
)
from ros_process import started
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Imu
from std_srvs.srv import Empty

from compass import CompassStatus
from nodes.compass_node import CompassNode
from nodes.fusion_node import FusionNode

STEP_NS = 10_000_000
RATE = 1.0  # rad/s


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


def turn(gyro, fused, start_ns, steps):
    """Feed the gyro step by step and wait for each answer; returns the yaw of the last."""
    for k in range(steps):
        t_ns = start_ns + k * STEP_NS
        message = imu_message(t_ns, RATE)
        send_until(
            lambda message=message: gyro(message), lambda t_ns=t_ns: reached(fused, t_ns), "fused yaw", pause=LOST_S
        )
    return yaw_of(fused[-1])


def reached(heard, t_ns):
    return bool(heard) and stamp_of(heard[-1]) == t_ns


def pose(yaw):
    message = PoseWithCovarianceStamped()
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    message.pose.covariance[35] = 1e-6
    return message


def test_reset_and_set_pose_act_on_the_fused_yaw(robot, tmp_path):
    with started("nodes.fusion_node", tmp_path / "log") as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        gyro = robot.connect(Imu, "/imu/data")
        robot.meet("/fusion_node")
        # Rate 1 rad/s from the first sample on: after n steps the yaw is n * 0.01 rad. The gyro's bias is not known
        # to better than 0.02 rad/s (config), the same for every sample: 0.02 * 0.3 s = 0.006 rad.
        assert turn(gyro, fused, START_NS, 31) == pytest.approx(0.30, abs=0.02)

        robot.call(Empty, "/fusion_node/reset", Empty.Request())
        after = START_NS + 100 * STEP_NS
        assert turn(gyro, fused, after, 11) == pytest.approx(0.10, abs=0.01)

        set_pose = robot.connect(PoseWithCovarianceStamped, "/set_pose", 10)
        robot.meet("/fusion_node")
        set_pose(pose(-2.0))
        times = iter(range(after + 11 * STEP_NS, after + 10_000 * STEP_NS, STEP_NS))
        last = [0]

        def one():
            last[0] = next(times)
            gyro(imu_message(last[0], RATE))

        send_until(one, lambda: yaw_of(fused[-1]) < -1.0, "the yaw that was set", pause=0.1)
        gone = (stamp_of(fused[-1]) - after - 10 * STEP_NS) * 1e-9
        assert yaw_of(fused[-1]) == pytest.approx(-2.0 + RATE * gone, abs=0.05)

        set_pose(PoseWithCovarianceStamped())  # orientation 0, 0, 0, 1 but variance 0
        nothing = PoseWithCovarianceStamped()
        nothing.pose.pose.orientation.w = 0.0
        set_pose(nothing)
        wait_for(lambda: "no unit quaternion" in node.text(), "the refusal of a pose without rotation")
        assert node.end(signal.SIGINT) == 0


def test_images_and_gyro_that_jump_back_start_anew(robot, tmp_path):
    texture = scene()
    with started("nodes.fusion_node", tmp_path / "log") as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        compass = robot.listen(Odometry, "/compass_pose")
        gyro = robot.connect(Imu, "/imu/data")
        image = robot.connect(Image, "/viz/pano/image")
        robot.meet("/fusion_node")
        for start_ns in (START_NS, START_NS - 3600 * 1_000_000_000):
            times = iter(range(start_ns, start_ns + 10**11, STEP_NS))

            def both(times=times):
                t_ns = next(times)
                gyro(imu_message(t_ns, 0.0))
                image(image_message(t_ns, panorama(0.0, texture)))

            def heard(start_ns=start_ns):
                ahead = [m and start_ns <= stamp_of(m[-1]) < start_ns + 10**11 for m in (fused, compass)]
                return all(ahead)

            send_until(both, heard, "answers of filter and compass", pause=0.02)
        assert "time jumped back" in node.text()


def test_sim_time_that_jumps_back_starts_anew(robot, tmp_path):
    with started("nodes.fusion_node", tmp_path / "log", use_sim_time=True) as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        gyro = robot.connect(Imu, "/imu/data")
        clock = robot.connect(Clock, "/clock", 10)
        robot.meet("/fusion_node")
        stamps = count(START_NS + 10**10, 10**6)  # each once: a sample sent again is not answered again
        send_until(lambda: gyro(imu_message(next(stamps), 0.0)), lambda: fused, "the fused yaw")
        seconds = START_NS // 10**9
        late_and_early = cycle([seconds + 10, seconds])

        def tick():  # one at a time: the node keeps only the last
            message = Clock()
            message.clock.sec = next(late_and_early)
            clock(message)

        send_until(tick, lambda: "time jumped by" in node.text(), "the jump noticed", pause=0.1)
        # A sample or two are enough now (some may be lost): the filter need not see ten to know them for no stragglers.
        sent = []

        def after():
            sent.append(imu_message(START_NS, 0.0))
            gyro(sent[-1])

        send_until(after, lambda: reached(fused, START_NS), "the yaw after the jump", pause=10.0)
        assert len(sent) < 8


def test_one_stamp_far_ahead_does_not_stop_the_fused_yaw(robot, tmp_path):
    with started("nodes.fusion_node", tmp_path / "log") as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        gyro = robot.connect(Imu, "/imu/data")
        robot.meet("/fusion_node")
        turn(gyro, fused, START_NS, 30)
        far = imu_message(START_NS + 10**17, RATE)
        send_until(lambda: gyro(far), lambda: "far ahead" in node.text(), "the stamp refused")
        yaw = turn(gyro, fused, START_NS + 30 * STEP_NS, 30)
        assert yaw == pytest.approx(59 * STEP_NS * 1e-9 * RATE, abs=0.01)


@pytest.mark.parametrize("kind", [FusionNode, CompassNode])
def test_reset_forgets_the_images_and_the_raw_yaw(kind):
    """What is seen after it may be another place: nothing of it is compared with what was before."""
    rclpy.init()
    node, texture = kind(), scene()
    try:
        stream = node._stream
        for k in range(3):
            stream._work(image_message(START_NS + k * 10**8, panorama(0.1 * k, texture)))
        before = stream._compass.yaw
        stream.reset()
        yaw, status = stream._compass.yaw, stream._compass.status
        stream._work(image_message(START_NS + 3 * 10**8, panorama(1.0, texture)))
        after = stream._compass.yaw, stream._compass.status
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    assert before == pytest.approx(0.2, abs=0.01)
    assert (yaw, status) == (0.0, CompassStatus.NOT_STARTED)
    assert after == (0.0, CompassStatus.FIRST_FRAME)
