"""What a topic can carry, a node survives: it says so once, counts it, and goes on."""

from __future__ import annotations

import array
import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from panoramas import as_bytes, seen_from, shifted
from panoramas import scene as corners
from ros_harness import (
    START_NS,
    Robot,
    figures,
    image_message,
    imu_message,
    jpeg_message,
    newest,
    odometry_message,
    panorama,
    scene,
    send_until,
    stamp,
    wait_for,
    yaw_of,
)
from ros_process import started
from sensor_msgs.msg import CompressedImage, Image, Imu

from compass import CompassStatus

SECOND = 1_000_000_000
NAN = float("nan")


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


def spoilt(message, **fields):
    """A message with some fields replaced."""
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def image(t_ns=START_NS + SECOND, **fields):
    return spoilt(image_message(t_ns, panorama(0.0, scene())), **fields)


BAD_IMAGES = {
    "'16SC1' is unknown": lambda: image(encoding="16SC1"),
    "xxxxx": lambda: image(encoding="'; \n\x1b[31m" + "x" * 5000),
    "0 x 0 pixels": lambda: image(width=0, height=0),
    "step 3 is shorter": lambda: image(step=3),
    "100 bytes": lambda: image(data=array.array("B", b"\x00" * 100)),
    "stamp is zero": lambda: image(t_ns=0),
}
BAD_GYRO = {
    "imu/data: refused: not finite": lambda: imu_message(START_NS, NAN),
    "imu/data: header.stamp is zero": lambda: imu_message(0, 0.1),
    "without angular velocity": lambda: spoilt(
        imu_message(START_NS, 0.1), angular_velocity_covariance=[-1.0] + 8 * [0.0]
    ),
}
BAD_TRACKS = {
    "odom: refused: not finite": lambda: odometry_message(START_NS, math.inf),
    "odom: header.stamp is zero": lambda: odometry_message(0, 0.1),
    "odom: refused: faster than": lambda: odometry_message(START_NS, 0.1, speed=1e300),
}
# These are of a kind that was said before: they make no line of their own.
SAME_AGAIN = (
    Image,
    lambda: image(t_ns=-5 * SECOND),
    lambda: image(height=2**32 - 1, step=2**32 - 1),
    lambda: image(encoding="16UC7"),
)


def level_of(status):
    return int.from_bytes(status.level, "little")


def said(diagnostics, source):
    """The newest message on a source, empty before the first."""
    status = newest(diagnostics, source)
    return status.message if status else ""


def faults(diagnostics, source):
    """How many faults the diagnostics have counted for a source."""
    return sum(int(value) for key, value in figures(diagnostics, source).items() if key.startswith("fault: "))


def test_fusion_node_survives_bad_messages(robot, tmp_path):
    with started("nodes.fusion_node", tmp_path / "log") as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        gyro = robot.connect(Imu, "/imu/data")
        tracks = robot.connect(Odometry, "/odom")
        view = robot.connect(Image, "/viz/pano/image")
        robot.meet("/fusion_node")

        for send, bad in ((view, BAD_IMAGES), (gyro, BAD_GYRO), (tracks, BAD_TRACKS)):
            for says, make in bad.items():
                send_until(lambda send=send, make=make: send(make()), lambda says=says: says in node.text(), says)
        for make in SAME_AGAIN:
            counted = faults(diagnostics, "images") + 1
            send_until(
                lambda make=make: view(make()),
                lambda counted=counted: faults(diagnostics, "images") >= counted,
                "a fault counted",
            )
        assert fused == []
        send_until(
            lambda: gyro(imu_message(0, 0.1)),
            lambda: level_of(newest(diagnostics, "gyro")) == 2,
            "gyro in error: messages come, none can be used",
        )

        send_until(lambda: gyro(imu_message(START_NS + SECOND, 0.1)), lambda: fused, "the fused yaw after all that")
        assert node.alive
        assert all(character.isprintable() or character == "\n" for character in node.text())
        lines = node.complaints()
        assert len(lines) == len(BAD_IMAGES) + len(BAD_GYRO) + len(BAD_TRACKS)  # each kind is said once
        assert max(map(len, lines)) < 600


def test_compass_node_survives_corrupt_jpeg(robot, tmp_path):
    texture = scene()
    with started("nodes.compass_node", tmp_path / "log", image_transport="compressed") as node:
        compass = robot.listen(Odometry, "/compass_pose")
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        view = robot.connect(CompressedImage, "/viz/pano/image/compressed")
        robot.meet("/compass_node")
        whole = jpeg_message(START_NS, panorama(0.0, texture))
        for data in (b"", b"\xff\xd8", b"not a jpeg", bytes(whole.data[:200]), b"\x89PNG\r\n\x1a\n" + b"\x00" * 64):
            counted = faults(diagnostics, "images") + 1
            message = spoilt(jpeg_message(START_NS, panorama(0.0, texture)), data=array.array("B", data))
            send_until(
                lambda message=message: view(message),
                lambda counted=counted: faults(diagnostics, "images") >= counted,
                "a corrupt image counted",
            )
        stamps = iter(range(START_NS, START_NS + 10 * SECOND, SECOND // 20))
        send_until(
            lambda: view(jpeg_message(next(stamps), panorama(0.0, texture))), lambda: compass, "an increment", 0.1
        )
        ours = [line for line in node.complaints() if "[compass_node]" in line]  # libpng has a line of its own
        assert 1 <= len(ours) <= 5  # each kind of fault once, however often it came
        assert any("corrupt" in line for line in ours)


def test_silent_sensors_are_explained_in_log_and_diagnostics(robot, tmp_path):
    robot.node.create_publisher(CompressedImage, "/viz/pano/image/compressed", 1)
    robot.node.create_publisher(Odometry, "/imu/data", 1)
    expected = {
        "images": "/viz/pano/image/compressed is there: set image_transport to compressed",
        "gyro": "/imu/data is a nav_msgs/msg/Odometry, not a sensor_msgs/msg/Imu",
        "tracks": "nobody publishes /odom",
    }
    with started("nodes.fusion_node", tmp_path / "log") as node:
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        for source, why in expected.items():
            wait_for(lambda source=source, why=why: f"{source}: nothing received yet; " in node.text(), why)
            assert why in node.text()
            wait_for(lambda source=source, why=why: why in said(diagnostics, source), f"{why} in the diagnostics")
        tracks = robot.connect(Odometry, "/odom")
        stamps = iter(range(START_NS, START_NS + 1000 * SECOND, SECOND))
        send_until(lambda: tracks(odometry_message(next(stamps), 0.1)), lambda: "tracks: back" in node.text(), "return")
        wait_for(lambda: figures(diagnostics, "tracks").get("filled in") == "twist", "what the tracks fill in")


def test_light_that_fails_for_a_second_costs_no_turn(robot, tmp_path):
    """While it drives: only the corners of what it saw tell how it has turned."""
    place, turn = corners(1, 1024, 512), -333.3 * math.tau / 1024
    further = shifted(seen_from(place, 0.6, 0.8, 1.5), -333.3)  # too far for tracks
    before, after = (jpeg_message(START_NS, as_bytes(image, 2.0)) for image in (place, further))
    found = f"images: {CompassStatus.FOUND_AGAIN.value}"
    dark = jpeg_message(START_NS, np.zeros((512, 1024), np.uint8))
    with started("nodes.fusion_node", tmp_path / "log", image_transport="compressed"):
        compass = robot.listen(Odometry, "/compass_pose")
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        view = robot.connect(CompressedImage, "/viz/pano/image/compressed")
        robot.meet("/fusion_node")
        stamps = iter(range(START_NS, START_NS + 1000 * SECOND, SECOND // 20))

        def send(message):
            view(stamp(message, next(stamps)))

        send_until(lambda: send(before), lambda: compass, "an increment", pause=0.05)
        for _ in range(20):
            send(dark)
            time.sleep(0.02)  # not to be sure of anything, but that they come as from a camera
        blind = f"images: {CompassStatus.NO_TEXTURE.value}"
        send_until(
            lambda: send(dark), lambda: blind in figures(diagnostics, "images"), "a dark image counted", pause=0.5
        )
        send_until(lambda: send(after), lambda: abs(yaw_of(compass[-1])) > 0.1, "the turn in the dark", pause=0.2)
        assert yaw_of(compass[-1]) == pytest.approx(turn, abs=0.02)
        wait_for(lambda: figures(diagnostics, "images").get(found) == "1", "its place in the diagnostics")


def test_turns_that_nobody_counted_in_a_pause_are_named(robot, tmp_path):
    """All sensors pause for 3 s while the robot spins; an image tells where it looks then, not how often it turned."""
    texture, rate = scene(), 2.0
    with started("nodes.fusion_node", tmp_path / "log", odometry_topic="none") as node:
        fused = robot.listen(Odometry, "/odometry/fused")
        diagnostics = robot.listen(DiagnosticArray, "/diagnostics")
        gyro, view = robot.connect(Imu, "/imu/data"), robot.connect(Image, "/viz/pano/image")
        robot.meet("/fusion_node")
        ticks = iter(range(100_000))

        def send(since_ns, turning):
            """A tenth of a second of both sensors."""
            tick = next(ticks)
            for k in range(5):
                gyro(imu_message(since_ns + tick * SECOND // 10 + k * SECOND // 50, turning * rate))
            view(image_message(since_ns + tick * SECOND // 10, panorama(turning * 0.1 * tick * rate, texture)))

        send_until(lambda: send(START_NS, 1.0), lambda: len(fused) > 60, "the turn", pause=0.05)
        send_until(
            lambda: send(START_NS + 3 * SECOND, 0.0), lambda: "whole turns" in node.text(), "the warning", pause=0.05
        )
        wait_for(lambda: "turn_lost" in figures(diagnostics, "fusion").get("warnings", ""), "it in the diagnostics")
        assert fused[-1].pose.covariance[35] < 0.1  # where it looks is known
