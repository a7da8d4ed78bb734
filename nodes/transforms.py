"""The fused yaw as a transform, for robots that want it in their tree."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Pose, Quaternion, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from compass.errors import ConfigError


def transform_broadcaster(node: Node, frames: tuple[str, str]) -> Any:
    """A ``tf2_ros.TransformBroadcaster``; `ConfigError` without ``tf2_ros`` or with frames that no tree can have."""
    if frames[0] == frames[1] or not all(frame and not frame.startswith("/") for frame in frames):
        raise ConfigError(
            f"publish_tf: odom_frame {frames[0]!r}, base_frame {frames[1]!r}: give two names without a leading slash"
        )
    try:
        from tf2_ros import TransformBroadcaster
    except ImportError as error:
        raise ConfigError(
            f"publish_tf: true needs tf2_ros ({error}); install ros-jazzy-tf2-ros-py, or set publish_tf: false"
        ) from None
    return TransformBroadcaster(node)


def transform_of(odometry: Odometry, *, inverted: bool = False) -> TransformStamped:
    """The transform from ``header.frame_id`` to ``child_frame_id`` that an Odometry message states.

    In a tree of frames each has one parent (REP-105). Where ``child_frame_id`` has one already, `inverted` gives the
    transform the other way round, with ``child_frame_id`` as the parent.
    """
    pose = odometry.pose.pose
    transform = TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id)
    x, y, turn = inverse_of(pose) if inverted else (pose.position.x, pose.position.y, pose.orientation)
    transform.transform.translation.x, transform.transform.translation.y = x, y
    transform.transform.rotation = turn
    if inverted:
        header = Header(stamp=odometry.header.stamp, frame_id=odometry.child_frame_id)
        transform.header, transform.child_frame_id = header, odometry.header.frame_id
    return transform


def inverse_of(pose: Pose) -> tuple[float, float, Quaternion]:
    """Translation, m, and rotation of the inverse of a pose in the plane."""
    q = pose.orientation
    yaw = 2.0 * math.atan2(q.z, q.w)
    x, y, _ = Rotation.from_euler("z", -yaw).apply([-pose.position.x, -pose.position.y, 0.0])
    return float(x), float(y), Quaternion(z=-q.z, w=q.w)
