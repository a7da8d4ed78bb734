"""What the launch file of a bag tells the nodes, from the bag and its arguments."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag

from compass.errors import VisualCompassError

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from nodes.bag_plan import plan_bag

ARGUMENTS = {"rate": "2", "start_offset": "0.0", "loop": "false", "compass_image": "", "gyro_topic": ""}


@pytest.fixture
def parameters(tmp_path):
    """A parameter file that says nothing."""
    path = tmp_path / "empty.yaml"
    path.write_text("/**: {ros__parameters: {compass_textout: false}}")
    return str(path)


def make_bag(path, images="/cam/compressed", gyros=("/imu",), tracks=("/wheels",), raw=False):
    with TinyBag(path) as bag:
        pixels = np.zeros((8, 16), np.uint8)
        if images:
            (bag.image if raw else bag.compressed)(images, START_NS, pixels)
        for topic in gyros:
            bag.imu(topic, START_NS, 0.0)
        for topic in tracks:
            bag.odometry(topic, START_NS, 0.0, 0.0)
    return str(path)


def test_plan_finds_the_only_topic_of_each_type(tmp_path, parameters):
    plan = plan_bag(ARGUMENTS | {"bagfile": make_bag(tmp_path / "a.mcap")}, parameters)
    assert plan.arguments == {
        "compass_image": "/cam",
        "gyro_topic": "/imu",
        "odometry_topic": "/wheels",
        "image_transport": "raw",
    }
    assert plan.republish
    assert plan.remappings == []
    assert plan.player.wait_for == "/cam/compressed,/imu,/wheels"
    assert plan.player.rate == 2.0


def test_plan_without_republisher_where_compressed_images_are_wanted(tmp_path, parameters):
    given = ARGUMENTS | {"bagfile": make_bag(tmp_path / "a.mcap"), "image_transport": "compressed"}
    plan = plan_bag(given, parameters)
    assert not plan.republish
    assert plan.arguments["image_transport"] == "compressed"


def test_plan_takes_raw_images_as_they_are(tmp_path, parameters):
    bag = make_bag(tmp_path / "a.mcap", images="/cam", raw=True)
    plan = plan_bag(ARGUMENTS | {"bagfile": bag, "image_transport": "compressed"}, parameters)
    assert (plan.arguments["compass_image"], plan.arguments["image_transport"]) == ("/cam", "raw")
    assert not plan.republish


def test_plan_moves_compressed_images_of_an_unusual_name(tmp_path, parameters):
    plan = plan_bag(ARGUMENTS | {"bagfile": make_bag(tmp_path / "a.mcap", images="/cam/jpeg")}, parameters)
    assert plan.remappings == [("/cam/jpeg", "/cam/jpeg/compressed")]
    assert plan.arguments["compass_image"] == "/cam/jpeg"


def test_plan_of_the_compass_alone_asks_for_images_alone(tmp_path, parameters):
    bag = make_bag(tmp_path / "a.mcap", gyros=("/imu", "/imu2"))
    plan = plan_bag(ARGUMENTS | {"bagfile": bag, "node": "compass_node"}, parameters)
    assert list(plan.topics) == ["compass_image"]
    assert plan.player.wait_for == "/cam/compressed"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"gyro_topic": "/nope"}, "gyro_topic:=/nope not in the bag; topics of type sensor_msgs/Imu: /imu"),
        ({"rate": "fast"}, "rate: 'fast' is not of type float"),
        ({"rate": "1000"}, "rate: 1000.0 is outside"),
        ({"image_transport": "jpeg"}, "one of: raw, compressed"),
    ],
)
def test_plan_refuses_unusable_arguments(tmp_path, parameters, arguments, says):
    with pytest.raises(VisualCompassError, match=says):
        plan_bag(ARGUMENTS | {"bagfile": make_bag(tmp_path / "a.mcap")} | arguments, parameters)


def test_plan_asks_which_of_two_gyros(tmp_path, parameters):
    bag = make_bag(tmp_path / "a.mcap", gyros=("/imu", "/imu2"))
    with pytest.raises(VisualCompassError, match="choose one with gyro_topic:="):
        plan_bag(ARGUMENTS | {"bagfile": bag}, parameters)
    plan = plan_bag(ARGUMENTS | {"bagfile": bag, "gyro_topic": "none"}, parameters)
    assert plan.arguments["gyro_topic"] == "none"


@pytest.mark.parametrize(
    ("given", "done"),
    [({}, "/fusion_node/image_done"), ({"namespace": "robot1", "name": "heading"}, "/robot1/heading/image_done")],
)
def test_plan_without_losses_waits_for_the_node_and_republishes_nothing(given, done, tmp_path, parameters):
    bag = make_bag(tmp_path / "a.mcap")
    plan = plan_bag(ARGUMENTS | {"bagfile": bag, "reliable": "true"} | given, parameters)
    assert plan.player.image_done == done
    assert (plan.arguments["reliable"], plan.transport, plan.republish) == ("true", "compressed", False)
    assert "reliable" not in plan_bag(ARGUMENTS | {"bagfile": bag}, parameters).arguments
