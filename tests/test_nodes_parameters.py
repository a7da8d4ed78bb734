"""Parameters of the nodes: declared from the config dataclasses, refused when wrong, some live."""

from __future__ import annotations

import math
import os
import signal
from itertools import pairwise

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from ros_harness import (
    START_NS,
    Robot,
    image_message,
    imu_message,
    panorama,
    scene,
    send_until,
    stamp_of,
    wait_for,
)
from ros_process import started
from sensor_msgs.msg import Image, Imu

from fusion.settings import Settings
from nodes import fusion_node
from nodes.parameters import settings_specs, settings_values


@pytest.fixture(scope="module")
def robot():
    robot = Robot()
    yield robot
    robot.close()


@pytest.fixture(scope="module")
def running(robot, tmp_path_factory):
    with started("nodes.fusion_node", tmp_path_factory.mktemp("node") / "log", compass__min_confidence=0.25) as node:
        yield node


def set_double(robot, name, value):
    message = ParameterMessage(name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value))
    request = SetParameters.Request(parameters=[message])
    return robot.call(SetParameters, "/fusion_node/set_parameters", request).results[0]


def get_double(robot, name):
    return robot.call(GetParameters, "/fusion_node/get_parameters", GetParameters.Request(names=[name])).values[0]


def test_every_setting_is_a_parameter_with_its_description(robot, running):
    listed = robot.call(ListParameters, "/fusion_node/list_parameters", ListParameters.Request()).result.names
    specs = {name: spec for name, (group, spec) in settings_specs().items() if group != "offline"}
    assert set(specs) <= set(listed)
    request = DescribeParameters.Request(names=list(specs))
    descriptors = robot.call(DescribeParameters, "/fusion_node/describe_parameters", request).descriptors
    for (name, spec), descriptor in zip(specs.items(), descriptors, strict=True):
        assert descriptor.name == name
        assert descriptor.description.startswith(spec.description)
        assert descriptor.read_only == (not spec.live)
        if isinstance(spec.default, float) and spec.low is not None and spec.high is not None:
            limits = descriptor.floating_point_range[0]
            assert (limits.from_value, limits.to_value) == (spec.low, spec.high)


def test_values_are_the_defaults_save_the_one_given(robot, running):
    defaults = {name: value for name, value in settings_values(Settings()).items() if not name.startswith("offline.")}
    request = GetParameters.Request(names=list(defaults))
    got = robot.call(GetParameters, "/fusion_node/get_parameters", request).values
    fields = {bool: "bool_value", int: "integer_value", float: "double_value", str: "string_value"}
    values = {name: getattr(value, fields[type(defaults[name])]) for name, value in zip(defaults, got, strict=True)}
    assert values == defaults | {"compass.min_confidence": 0.25}


def test_live_parameter_changes_within_its_range_only(robot, running):
    assert set_double(robot, "compass.min_confidence", 0.5).successful
    assert get_double(robot, "compass.min_confidence").double_value == 0.5
    for wrong in (1.5, -0.1, math.nan):
        assert not set_double(robot, "compass.min_confidence", wrong).successful
    assert get_double(robot, "compass.min_confidence").double_value == 0.5


def test_structural_parameter_is_read_only(robot, running):
    result = set_double(robot, "compass.roi_top", 0.1)
    assert not result.successful
    assert "read-only" in result.reason


def test_live_change_acts_on_the_running_compass(robot, running):
    compass = robot.listen(Odometry, "/compass_pose")
    send = robot.connect(Image, "/viz/pano/image")
    robot.meet("/fusion_node")
    rng = np.random.default_rng(0)
    view, times = panorama(0.0, scene()), iter(range(START_NS, START_NS + 10**11, 50_000_000))

    def noisy():
        send(image_message(next(times), view + rng.integers(0, 20, view.shape, np.uint8)))

    send_until(noisy, lambda: compass, "an increment", pause=0.1)
    assert set_double(robot, "compass.min_confidence", 1.0).successful  # with noise no correlation is perfect
    send_until(noisy, lambda: "below min_confidence" in running.text(), "an image refused", pause=0.1)
    assert set_double(robot, "compass.min_confidence", 0.3).successful
    given = len(compass)
    send_until(noisy, lambda: len(compass) > given, "an increment again", pause=0.1)


def test_method_of_ones_own_turns_the_compass(robot, tmp_path, monkeypatch):
    lines = ("from compass import Match", "def three(reference, current, search):", "    return Match(3.0, 1.0, 0.9)")
    (tmp_path / "method_for_a_node.py").write_text("\n".join(lines))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    topics = {"compass_image": "/mine/image", "compass_output_topic": "/mine/pose"}
    with started("nodes.compass_node", tmp_path / "log", compass__method="method_for_a_node:three", **topics):
        poses = robot.listen(Odometry, "/mine/pose")
        send = robot.connect(Image, "/mine/image")
        robot.meet("/compass_node")
        view, times = panorama(0.0, scene()), iter(range(START_NS, START_NS + 10**11, 50_000_000))
        send_until(
            lambda: send(image_message(next(times), np.roll(view, next(times) % 7, axis=1))),
            lambda: len(poses) > 2,
            "three poses",
            pause=0.1,
        )
    turns = [2.0 * math.atan2(one.pose.pose.orientation.z, one.pose.pose.orientation.w) for one in poses[:3]]
    assert np.diff(turns) == pytest.approx(3.0 * math.tau / view.shape[1], rel=1e-6)


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"compass.method": "no_such_module_here:f"}, "no_such_module_here"),
        ({"compass.metod": "rows"}, "did you mean"),
        ({"compass.columns": 3}, "16"),
        ({"publish_tf": True}, "tf2_ros"),
    ],
)
def test_wrong_parameter_is_refused_in_one_line(parameters, says, capfd, monkeypatch):
    """In this process; the next test starts one."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # a node that ends hears no second one
    given = [part for name, value in parameters.items() for part in ("-p", f"{name}:={str(value).lower()}")]
    assert fusion_node.main(["--ros-args", *given]) == 1
    text = capfd.readouterr().err
    assert text.count("\n") == 1
    assert says in text


def test_name_that_no_topic_can_have_ends_the_node_with_one_line(tmp_path):
    with started("nodes.fusion_node", tmp_path / "log", gyro_topic="imu-data") as node:
        assert node.wait() == 1
        assert node.text().count("\n") == 1
        assert "gyro_topic: 'imu-data' is no name of a topic: topic name must not contain" in node.text()


def test_parameter_file_of_the_command_line_is_read(robot, tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    fused_output_topic: /yaw\n    fused_rate: 10\n"
        "    compass: {method: rows, min_confidence: 0}\n"
        "    gyro_topic: /imu\n    qos_overrides: {/imu: {subscription: {reliability: reliable}}}\n"
    )
    with started("nodes.fusion_node", tmp_path / "log", ["--params-file", str(file)]):
        fused = robot.listen(Odometry, "/yaw")
        gyro = robot.connect(Imu, "/imu", 100)
        robot.meet("/fusion_node")
        end_ns = START_NS + 1_000_000_000
        for t_ns in range(START_NS, end_ns, 10_000_000):
            gyro(imu_message(t_ns, 0.1))
        wait_for(lambda: fused and stamp_of(fused[-1]) > end_ns - 200_000_000, "the last of the thinned outputs")
        stamps = [stamp_of(message) for message in fused]
        assert all(after - before >= 100_000_000 for before, after in pairwise(stamps))
        subscription = robot.node.get_subscriptions_info_by_topic("/imu")[0]
        assert subscription.qos_profile.reliability.name == "RELIABLE"


def test_unreadable_parameter_file_is_refused(tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("/**:\n  ros__parameters:\n    compass: {columns: [1, 2}\n")
    with started("nodes.fusion_node", tmp_path / "log", ["--params-file", str(file)]) as node:
        assert node.wait() == 1
        assert "Error parsing" in node.text()
        assert "Traceback" not in node.text()
