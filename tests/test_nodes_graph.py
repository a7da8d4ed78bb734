"""Several robots, names and publishers in one graph: what a node makes of them, and says of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_harness import (
    START_NS,
    Robot,
    figures,
    image_message,
    imu_message,
    newest,
    odometry_message,
    send_until,
    wait_for,
    yaw_of,
)
from ros_process import started
from sensor_msgs.msg import Image, Imu

STEP_NS = 10_000_000


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


def said(diagnostics, source):
    """The newest message on a source, empty before the first."""
    status = newest(diagnostics, source)
    return status.message if status else ""


def test_two_robots_in_one_graph_turn_by_themselves(robot, tmp_path):
    """The same node twice, with a gyro each and no other sensor; one has another name, too."""
    only_gyro = {"compass_image": "none", "odometry_topic": "''"}
    with (
        started("nodes.fusion_node", tmp_path / "a", ["-r", "__ns:=/a"], **only_gyro) as one,
        started("nodes.fusion_node", tmp_path / "b", ["-r", "__ns:=/b", "-r", "__node:=heading"], **only_gyro) as two,
    ):
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        rates = {"a": 1.0, "b": -2.0}
        gyros = {name: robot.connect(Imu, f"/{name}/imu/data") for name in rates}
        fused = {name: robot.listen(Odometry, f"/{name}/odometry/fused") for name in rates}
        for node in ("/a/fusion_node", "/b/heading"):
            robot.meet(node)
        sent = iter(range(START_NS, START_NS + 10**12, STEP_NS))

        def turn():
            t_ns = next(sent)
            for name, rate in rates.items():
                gyros[name](imu_message(t_ns, rate + 1e-3 * math.sin(t_ns)))  # one that repeats a number is stuck

        def turned():
            return all(heard and abs(yaw_of(heard[-1])) > 0.2 for heard in fused.values())

        send_until(turn, turned, "both robots to turn", pause=0.03)
        assert all(math.copysign(1.0, yaw_of(fused[name][-1])) == math.copysign(1.0, rates[name]) for name in rates)
        assert "gyro /a/imu/data -> /a/odometry/fused\n" in one.text()
        assert "[b.heading]: gyro /b/imu/data -> /b/odometry/fused\n" in two.text()
        for node in ("/a/fusion_node", "/b/heading"):
            wait_for(lambda node=node: newest(diagnostics, f"{node}: fusion"), "what is said of the filter")
            assert newest(diagnostics, f"{node}: gyro")
            assert newest(diagnostics, f"{node}: images") is None
            assert newest(diagnostics, f"{node}: tracks") is None
        send_until(turn, lambda: said(diagnostics, "/b/heading: fusion") == "OK", "a filter with all it has", 0.03)
        topics = dict(robot.node.get_topic_names_and_types())
        assert not {"/a/viz/pano/image", "/a/odom", "/b/viz/pano/image", "/imu/data", "/a/compass_pose"} & topics.keys()
        assert one.complaints() == two.complaints() == []


def test_pictures_that_are_lost_and_ends_that_do_not_match_are_named(robot, tmp_path):
    """An image of 22 MB does not fit into a sender's shared memory: none or few arrive."""
    overrides = {"qos_overrides./imu/data.subscription.reliability": "reliable"}
    with started("nodes.fusion_node", tmp_path / "log", **overrides) as node:
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        robot.listen(Odometry, "/odometry/fused", late)
        robot.node.create_publisher(Imu, "/imu/data", 10)  # reliable: it matches
        robot.node.create_publisher(Imu, "/imu/data", QoSProfile(depth=10, reliability=2))
        send = robot.connect(Image, "/viz/pano/image")
        large = image_message(START_NS, np.zeros((1920, 3840, 3), np.uint8), "bgr8")
        send_until(lambda: send(large), lambda: "lost on the way" in said(diagnostics, "images"), "the loss", 0.1)
        text = said(diagnostics, "images")
        assert "from /robot: its shared memory has 0.5 MB" in text
        assert "FASTRTPS_DEFAULT_PROFILES_FILE=" in text

        def more_are_lost():
            return int(figures(diagnostics, "images")["lost on the way"]) > 2

        send_until(lambda: send(large), more_are_lost, "more of them", 0.1)
        wait_for(lambda: "lost on the way from /robot" in node.text(), "the loss in the log")
        gyro = "/robot sends nothing to us: reliable is asked for, best effort offered"
        wait_for(lambda: gyro in said(diagnostics, "gyro"), "the publisher that does not match")
        output = "/robot gets nothing from us: transient local is asked for, volatile offered"
        wait_for(lambda: output in said(diagnostics, "fusion"), "the subscriber that does not match")
        assert "/robot, /robot" in figures(diagnostics, "gyro")["publishers"]


def test_two_publishers_are_named_and_are_no_loss(robot, tmp_path):
    with started("nodes.fusion_node", tmp_path / "log", compass_image="none") as node:
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        first = robot.connect(Odometry, "/odom")
        robot.connect(Imu, "/imu/data")
        stamps = iter(range(START_NS, START_NS + 10**12, STEP_NS))
        for _ in range(20):
            first(odometry_message(next(stamps), 0.1))
        second = robot.connect(Odometry, "/odom")

        def both():
            first(odometry_message(next(stamps), 0.1))
            second(odometry_message(next(stamps), 0.1))

        text = "2 publishers send on /odom: /robot, /robot"
        send_until(both, lambda: text in node.text(), "both publishers named", pause=0.1)

        def told():
            return text in said(diagnostics, "tracks") + figures(diagnostics, "tracks").get("also", "")

        send_until(both, told, "both publishers in the diagnostics", pause=0.1)
        assert figures(diagnostics, "tracks")["lost on the way"] == "0"
        assert "lost" not in node.text()
        assert "overtaken" not in node.text()

        robot.node.create_publisher(Odometry, "/odometry/fused", 10)  # as a second node of ours has it
        rival = "2 publishers send on /odometry/fused: /fusion_node, /robot; who listens hears them by turns"
        send_until(both, lambda: rival in said(diagnostics, "fusion"), "the rival in the diagnostics", pause=0.1)
        wait_for(lambda: node.text().count(rival) == 1, "the rival in the log")
