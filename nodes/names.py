"""Names of topics: checked before they are used, resolved for who reads them, with image_transport's suffix."""

from __future__ import annotations

from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.validate_full_topic_name import validate_full_topic_name

from compass.errors import ConfigError
from compass.parameters import shown
from fusion.settings import TopicSettings, absent

INPUTS = ("compass_image", "gyro_topic", "odometry_topic")
OUTPUTS = ("compass_output_topic", "fused_output_topic")
_SUFFIX = "/compressed"


def raw_topic(name: str) -> str:
    """The raw topic of a camera, given either of its topics."""
    return name.removesuffix(_SUFFIX)


def compressed_topic(name: str) -> str:
    """The compressed topic of a camera, given either of its topics."""
    return raw_topic(name) + _SUFFIX


def check_names(node: Node, topics: TopicSettings) -> None:
    """See to it that every topic has a name that ROS takes, or that a sensor is said to be absent.

    Raises
    ------
    ConfigError
        A name is invalid: which, and why.
    """
    for parameter in (*INPUTS, *OUTPUTS):
        name = getattr(topics, parameter)
        if not (parameter in INPUTS and absent(name)):
            resolved_name(node, name, parameter)


def resolved_name(node: Node, name: str, parameter: str) -> str:
    """The fully qualified name of a topic as `node` uses it: in its namespace, and remapped.

    Raises
    ------
    ConfigError
        The value of `parameter` is no valid name.
    """
    try:
        resolved = node.resolve_topic_name(name)
        validate_full_topic_name(resolved)
    except (RuntimeError, NameValidationException) as error:  # rcl's say in which line of its source, or draw a caret
        why = str(error).split(", at /")[0].splitlines()[0].rpartition("name: ")[2].rstrip(":")
        raise ConfigError(
            f"{parameter}: {shown(name)} is no name of a topic: {why}; an example: robot1/imu/data"
        ) from None
    return resolved
