"""The fused yaw as a transform, for robots that want it in their tree."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from compass.errors import ConfigError


def transform_broadcaster(node: Node) -> Any:
    """A ``tf2_ros.TransformBroadcaster``; `ConfigError` where ``tf2_ros`` is not installed."""
    try:
        from tf2_ros import TransformBroadcaster
    except ImportError as error:
        raise ConfigError(
            f"publish_tf: true needs tf2_ros ({error}); install ros-jazzy-tf2-ros-py, or set publish_tf: false"
        ) from None
    return TransformBroadcaster(node)


def transform_of(odometry: Odometry) -> TransformStamped:
    """The transform from ``header.frame_id`` to ``child_frame_id`` that an Odometry message states."""
    transform = TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id)
    transform.transform.rotation = odometry.pose.pose.orientation
    return transform
