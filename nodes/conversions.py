"""ROS messages to the samples of the pipeline, and its results to ROS messages. Pure functions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CompressedImage, Image, Imu

from compass.errors import VisualCompassError
from compass.image import image_from_compressed, image_from_raw
from fusion import GyroSample, OdometrySample, YawEstimate
from fusion.vertical import ImuLevel

UNMEASURED = 1e6  # variance of an axis nobody measured: large, yet finite, so that a filter can invert it
YAW = 35  # place of the yaw's variance in a row-major 6x6 covariance


class MessageError(VisualCompassError, ValueError):
    """A message that cannot become a sample."""


def stamp_to_ns(stamp: Any) -> int:
    """Integer nanoseconds of a ``builtin_interfaces/Time``; `MessageError` where it was never set."""
    t_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    if t_ns <= 0:
        raise MessageError("header.stamp is zero: the driver must stamp its messages with the moment of capture")
    return t_ns


def ns_to_stamp(t_ns: int) -> Time:
    """``builtin_interfaces/Time`` of integer nanoseconds."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def image_of(message: Image | CompressedImage, columns: int) -> tuple[npt.NDArray[Any], str]:
    """Pixels of an image message and their encoding; a view of the message where no decoding is needed.

    Parameters
    ----------
    message : Image or CompressedImage
        Raw image, or JPEG or PNG bytes.
    columns : int
        Width the compass works at; a JPEG is decoded no larger than this needs.

    Raises
    ------
    ImageError
        Unknown encoding, zero size, wrong `step` or length of `data`, corrupt JPEG.
    """
    if isinstance(message, CompressedImage):
        return image_from_compressed(message.data, columns), ""
    m = message
    return image_from_raw(m.data, m.encoding, m.height, m.width, m.step, bool(m.is_bigendian)), m.encoding


def gyro_sample(message: Imu, level: ImuLevel) -> GyroSample:
    """Turn rate about the vertical from an IMU message; `level` knows how the IMU is mounted.

    Raises
    ------
    MessageError
        Zero stamp, or an IMU that says it has no gyro.
    """
    t_ns = stamp_to_ns(message.header.stamp)
    rate, force, turn = message.angular_velocity, message.linear_acceleration, message.orientation
    if message.angular_velocity_covariance[0] < 0.0:  # sensor_msgs/Imu: -1 says that the field is not measured
        raise MessageError("Imu without angular velocity (its covariance begins with -1)")
    return level.sample(
        t_ns,
        (rate.x, rate.y, rate.z),
        None if message.linear_acceleration_covariance[0] < 0.0 else (force.x, force.y, force.z),
        None if message.orientation_covariance[0] < 0.0 else (turn.x, turn.y, turn.z, turn.w),
    )


def odometry_sample(message: Odometry) -> OdometrySample:
    """What the tracks claim; `MessageError` for a zero stamp."""
    twist = message.twist.twist
    return OdometrySample(
        stamp_to_ns(message.header.stamp), twist.angular.z, twist.linear.x, yaw_of(message.pose.pose.orientation)
    )


def pose_yaw(message: PoseWithCovarianceStamped) -> tuple[float, float]:
    """Yaw, rad, and its variance, rad^2, of a ``set_pose`` message.

    Raises
    ------
    MessageError
        The quaternion is no rotation, or the variance of yaw is negative or not finite.
    """
    yaw, variance = yaw_of(message.pose.pose.orientation), float(message.pose.covariance[YAW])
    if yaw is None:
        raise MessageError("set_pose: the orientation is no unit quaternion")
    if not 0.0 <= variance < math.inf:
        raise MessageError(f"set_pose: variance of yaw is {variance:g}; give 0 or more")
    return yaw, variance


def yaw_of(quaternion: Any) -> float | None:
    """Yaw of a quaternion message, rad in [-pi, pi]; None where it is no rotation (REP-103: about z, up)."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    if not 0.9 < x * x + y * y + z * z + w * w < 1.1:  # false for NaN too
        return None
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def yaw_odometry(
    t_ns: int, yaw: float, yaw_variance: float, yaw_rate: float, rate_variance: float, frames: tuple[str, str]
) -> Odometry:
    """Odometry that speaks of yaw alone: position and linear twist zero, their variances large.

    Parameters
    ----------
    t_ns : int
        Stamp, ns.
    yaw, yaw_variance : float
        rad (wrapped or not) and rad^2.
    yaw_rate, rate_variance : float
        rad/s and (rad/s)^2.
    frames : (str, str)
        ``header.frame_id`` and ``child_frame_id``.
    """
    message = Odometry()
    message.header.stamp = ns_to_stamp(t_ns)
    message.header.frame_id, message.child_frame_id = frames
    orientation = message.pose.pose.orientation
    orientation.z, orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    message.twist.twist.angular.z = yaw_rate
    message.pose.covariance = yaw_covariance(yaw_variance)
    message.twist.covariance = yaw_covariance(rate_variance)
    return message


def yaw_covariance(variance: float) -> npt.NDArray[np.float64]:
    """Row-major 6x6 covariance with `variance` for yaw and a large one for every other axis."""
    diagonal = np.full(6, UNMEASURED)
    diagonal[5] = variance
    return np.diag(diagonal).reshape(36)


def fused_odometry(estimate: YawEstimate, frames: tuple[str, str]) -> Odometry:
    """The fused estimate as Odometry."""
    return yaw_odometry(
        estimate.t_ns, estimate.yaw, estimate.yaw_variance, estimate.yaw_rate, estimate.yaw_rate_variance, frames
    )
