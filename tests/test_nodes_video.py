"""A live video of panoramas: the node starts at a key frame, and again after a lost packet."""

from __future__ import annotations

import array
import math

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from ros_harness import START_NS, Robot, panorama, scene, send_until, stamp, stamp_of, wait_for, yaw_of
from ros_process import started
from sensor_msgs.msg import CompressedImage

from compass import CompassStatus

pytest.importorskip("av", reason="videos need PyAV")
from video_packets import encode

pytestmark = pytest.mark.slow
FRAME_NS = 50_000_000
TURN = math.radians(2.0)
GOP, COUNT, LOST = 8, 22, 11


def first(diagnostics):
    """Whether the compass has taken its first picture."""
    return any(CompassStatus.FIRST_FRAME.value == pair.value for one in diagnostics.status for pair in one.values)


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.close()


def test_compass_node_decodes_a_video(robot, tmp_path):
    texture = scene()
    packets = encode([panorama(k * TURN, texture) for k in range(COUNT)], gop=GOP)

    def message(k):
        return stamp(CompressedImage(format="h264", data=array.array("B", packets[k].data)), START_NS + k * FRAME_NS)

    parameters = {"image_transport": "compressed", "compass_image": "/camera"}
    parameters["qos_overrides./camera/compressed.subscription.reliability"] = "reliable"  # only those are lost that are
    with started("nodes.compass_node", tmp_path / "log", **parameters) as node:
        compass, told = robot.listen(Odometry, "/compass_pose"), robot.listen(DiagnosticArray, "/diagnostics")
        image = robot.connect(CompressedImage, "/camera/compressed", COUNT)
        robot.meet("/compass_node")
        send_until(lambda: image(message(3)), lambda: "waits for a key frame" in node.text(), "a word on the key frame")
        for k in range(GOP, COUNT):
            if k == LOST:
                continue
            given = len(compass)
            image(message(k))
            if k == GOP:  # it waits for its turn, in which the next one would overtake it
                wait_for(lambda: any(first(one) for one in told), "the first picture to be taken")
            if k > GOP and not LOST < k < 2 * GOP:  # the first key frame has nothing to be compared with
                wait_for(lambda given=given: len(compass) > given, f"an increment to picture {k}")
        answers = [(stamp_of(one) - START_NS) // FRAME_NS for one in compass]
        assert answers == [k for k in range(GOP + 1, COUNT) if not LOST <= k < 2 * GOP]
        assert math.degrees(yaw_of(compass[-1])) == pytest.approx(2.0 * (COUNT - 1 - GOP), abs=0.3)


def test_transport_whose_messages_are_not_installed_is_one_line(tmp_path):
    with started("nodes.compass_node", tmp_path / "log", image_transport="ffmpeg") as node:
        assert node.wait() == 1
        assert "apt install ros-jazzy-ffmpeg-image-transport-msgs" in node.text()
        assert "Traceback" not in node.text()
