"""Warnings live: in the diagnostics of the sensors they are about, and once in the log."""

from __future__ import annotations

import itertools
import math

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from ros_harness import (
    START_NS,
    Robot,
    figures,
    image_message,
    imu_message,
    newest,
    odometry_message,
    panorama,
    scene,
    send_until,
    wait_for,
)
from ros_process import started
from sensor_msgs.msg import Image, Imu

from fusion import Sensor, Warning
from fusion.imu.levelling import ImuLevel
from nodes.compass_node import CompassNode
from nodes.diagnostics import warned
from nodes.fusion_node import FusionNode
from nodes.health import Level, StreamHealth
from nodes.throttled_log import WarningLogger

SECOND = 1_000_000_000
STUCK = Warning("gyro_stuck", "gyro", 5, "says\n0.1; replace it")
DISAGREE = Warning("sensors_disagree", "compass+gyro", 7, "by 3 deg/s")
LOST = Warning("samples_lost", "compass", 1, "3 lost")
ALL = [STUCK, DISAGREE, LOST]
FINE = (Level.OK, "OK", {"used": "5"})


def test_each_warning_is_said_once_until_forgotten():
    said: list[str] = []
    tell = WarningLogger(said.append)
    for _ in range(3):
        tell([STUCK])
        tell([STUCK, Warning("gyro_stuck", "gyro", 9, "says 0.2")])
    tell([DISAGREE])
    assert said == ["says 0.1; replace it [gyro_stuck, gyro]", "by 3 deg/s [sensors_disagree, compass+gyro]"]
    tell.clear()
    tell([DISAGREE])
    assert len(said) == 3


@pytest.mark.parametrize(
    ("sensor", "message", "codes"),
    [
        (Sensor.GYRO, STUCK.text, "gyro_stuck, sensors_disagree"),
        (Sensor.COMPASS, DISAGREE.text, "sensors_disagree, samples_lost"),
        (None, STUCK.text, "gyro_stuck, sensors_disagree, samples_lost"),
    ],
)
def test_finding_shows_the_warnings_of_its_sensor(sensor, message, codes):
    level, text, values = warned(FINE, ALL, sensor)
    assert (level, text, values["warnings"], values["used"]) == (Level.WARN, message, codes, "5")
    assert values[f"warning: {DISAGREE.code}, {DISAGREE.sensor}"] == DISAGREE.text


def test_finding_of_another_sensor_stays_as_it_is():
    assert warned(FINE, ALL, Sensor.TRACKS) == FINE
    assert warned(FINE, []) == FINE


@pytest.mark.parametrize("level", [Level.ERROR, Level.STALE])
def test_finding_of_a_lost_sensor_says_so_first(level):
    found = warned((level, "silent for 3.0 s", {}), ALL, Sensor.GYRO)
    assert found[:2] == (level, f"silent for 3.0 s; {STUCK.text}")


def test_finding_keeps_what_a_warning_takes_the_place_of():
    assert warned((Level.WARN, "2 of 9 messages not used", {}), ALL)[2]["also"] == "2 of 9 messages not used"


@pytest.mark.parametrize("hertz", [1.0, 20.0])
def test_health_of_a_stream_the_gate_refuses_is_a_warning_and_no_longer_alive(hertz):
    health, judged = StreamHealth(), []
    for k in range(round(10.0 * hertz)):
        now = k / hertz
        health.receive(now)
        if now < 4.0:
            health.use(now, 0)
        else:
            health.refuse(now)
        if now % 1.0 == 0.0:
            judged.append(health.judge(now + 1e-3, timeout=2.0))
    assert [level for level, _, _ in judged[1:4]] == [Level.OK] * 3
    assert [level for level, _, _ in judged[7:]] == [Level.WARN] * 3
    assert "gate" in judged[-1][1]
    assert not health.alive(10.0, 2.0)
    assert health.judge(10.0, 2.0)[2]["refused at the gate"] == str(health.refused)
    assert health.judge(20.0, 2.0)[0] is Level.STALE


@pytest.mark.parametrize("kind", [FusionNode, CompassNode])
def test_node_names_what_its_own_compass_saw(kind):
    """A size that changes in mid drive is a lost turn, and grows the variance that is published."""
    rclpy.init()
    node, texture = kind(), scene()
    try:
        stream = node._stream
        for k, width in enumerate((512, 512, 256, 256)):
            view = panorama(0.1 * k, texture)[:, :: 512 // width]
            stream._work(image_message(START_NS + k * SECOND // 10, view.copy()))
        _, message, values = node._diagnostics._sources["images"]()
        variance = stream._compass.yaw_variance
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    assert values["warnings"] == "turn_lost"
    assert "up to 17 deg of turning unknown" in message
    assert variance == pytest.approx((0.1 * 3.0) ** 2 / 3.0, rel=0.1)


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


@pytest.mark.parametrize("kind", [FusionNode, CompassNode])
def test_node_shows_and_logs_what_its_sources_say(kind, monkeypatch):
    monkeypatch.setattr(ImuLevel, "warnings", lambda level: (STUCK,), raising=False)
    rclpy.init()
    node, said = kind(), []
    try:
        node._tell = WarningLogger(said.append)
        sources = node._pipeline.warning_sources if kind is FusionNode else node.warning_sources
        sources.append(lambda: [LOST])
        statuses = {name: find() for name, find in node._diagnostics._sources.items()}
        statuses |= {name: find() for name, find in node._diagnostics._sources.items()}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    assert statuses["images"][2]["warnings"] == "samples_lost"
    expected = ["3 lost [samples_lost, compass]"]
    if kind is FusionNode:
        assert statuses["fusion"][2]["warnings"] == "gyro_stuck, samples_lost"
        assert statuses["gyro"][2]["warnings"] == "gyro_stuck"
        assert "warnings" not in statuses["tracks"][2]
        expected.append("says 0.1; replace it [gyro_stuck, gyro]")
    assert sorted(said) == sorted(expected)


def test_images_that_contradict_gyro_and_tracks_are_named_and_do_not_feed_the_filter(robot, tmp_path):
    """The panoramas are mirrored: gyro and tracks turn to the left, the images to the right."""
    texture, rate = scene(), math.radians(40.0)
    with started("nodes.fusion_node", tmp_path / "log") as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        gyro, tracks = robot.connect(Imu, "/imu/data"), robot.connect(Odometry, "/odom")
        image = robot.connect(Image, "/viz/pano/image")
        robot.meet("/fusion_node")
        steps = itertools.count()

        def send():
            k = next(steps)
            t_ns, turned = START_NS + k * SECOND // 20, rate * max(k / 20 - 1.0, 0.0)
            now = rate if k > 20 else 0.0
            gyro(imu_message(t_ns, now))
            tracks(odometry_message(t_ns, now))
            image(image_message(t_ns, panorama(-turned, texture)))

        def warnings():
            return figures(diagnostics, "images").get("warnings") and figures(diagnostics, "fusion").get("warnings")

        send_until(send, warnings, "a warning about the images", pause=0.03)
        status = newest(diagnostics, "images")
        assert status.level == bytes([Level.WARN])
        codes = figures(diagnostics, "images")["warnings"].split(", ")
        values = [pair.value for pair in status.values if pair.key.startswith(f"warning: {codes[0]}")]
        assert status.message in values
        assert set(codes) <= set(figures(diagnostics, "fusion")["warnings"].split(", "))

        def refused():
            images = figures(diagnostics, "images")
            return int(images["refused at the gate"]) > int(images["used"]) / 2

        send_until(send, refused, "images that are refused", pause=0.03)

        def not_live():
            fusion = newest(diagnostics, "fusion")
            return any(
                "only 2 of 3 sensors feed" in text
                for text in (fusion.message, *figures(diagnostics, "fusion").values())
            )

        send_until(send, not_live, "a filter that the images do not feed", pause=0.03)
        wait_for(lambda: f"[{codes[0]}, " in node.text(), "the warning in the log")
        said = [line for line in node.complaints() if f"[{codes[0]}, " in line]
        assert len(said) == len({line.rsplit("[", 1)[1] for line in said})  # once per code and sensor
        assert fused
