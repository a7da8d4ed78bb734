"""What ROS messages say, whoever deserialised them: rclpy live or a bag library offline. No ROS is imported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from compass.errors import VisualCompassError
from compass.images.decode import Image, image_from_compressed
from compass.images.raw import image_from_raw
from compass.tilt import Vector
from fusion.imu.levelling import ImuLevel
from fusion.samples import GyroSample, OdometrySample

NO_GYRO = "Imu without angular velocity (covariance -1, NaN, or exact zeros in turn with the accelerations)"
NO_VECTOR: Vector = (math.nan, math.nan, math.nan)  # a vector that was not measured


class MessageError(VisualCompassError, ValueError):
    """A message that cannot become a sample."""


@dataclass(frozen=True, slots=True)
class ImuReading:
    """What an IMU measured, in its own frame; None for what it says it does not measure.

    Attributes
    ----------
    t_ns : int
        ``header.stamp``, ns.
    angular_velocity : (3,) tuple of float or None
        rad/s.
    linear_acceleration : (3,) tuple of float or None
        m/s^2, gravity included.
    orientation : (4,) tuple of float or None
        Quaternion x, y, z, w from the IMU to a world with z up.
    """

    t_ns: int
    angular_velocity: Vector | None
    linear_acceleration: Vector | None
    orientation: tuple[float, float, float, float] | None


def stamp_to_ns(stamp: Any) -> int:
    """Integer nanoseconds of a ``builtin_interfaces/Time``; `MessageError` where it was never set."""
    t_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    if t_ns <= 0:
        raise MessageError("header.stamp is zero or negative: the driver must stamp with the moment of capture")
    return t_ns


def imu_reading(message: Any) -> ImuReading:
    """Fields of a ``sensor_msgs/Imu``.

    A covariance that begins with -1 says that the field is not measured.

    Raises
    ------
    MessageError
        Zero stamp.
    """
    rate, force, turn = message.angular_velocity, message.linear_acceleration, message.orientation
    return ImuReading(
        stamp_to_ns(message.header.stamp),
        None if message.angular_velocity_covariance[0] < 0.0 else (rate.x, rate.y, rate.z),
        None if message.linear_acceleration_covariance[0] < 0.0 else (force.x, force.y, force.z),
        None if message.orientation_covariance[0] < 0.0 else (turn.x, turn.y, turn.z, turn.w),
    )


def gyro_sample(message: Any, level: ImuLevel) -> GyroSample:
    """Turn rate about the vertical from a ``sensor_msgs/Imu``; `level` knows how the IMU is mounted.

    Raises
    ------
    MessageError
        Zero stamp, or no gyro in the message.
    """
    reading = imu_reading(message)
    rate = reading.angular_velocity or NO_VECTOR
    sample = level.sample(reading.t_ns, rate, reading.linear_acceleration, reading.orientation)
    if sample is None:
        raise MessageError(NO_GYRO)
    return sample


def odometry_sample(message: Any) -> OdometrySample:
    """What the tracks claim in a ``nav_msgs/Odometry``; `MessageError` for a zero stamp."""
    twist = message.twist.twist
    yaw = yaw_of(message.pose.pose.orientation)
    return OdometrySample(stamp_to_ns(message.header.stamp), twist.angular.z, twist.linear.x, yaw)


def yaw_of(quaternion: Any) -> float | None:
    """Yaw of a quaternion message, rad in [-pi, pi]; None where it is no rotation (REP-103: about z, up)."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    if not 0.9 < x * x + y * y + z * z + w * w < 1.1:  # false for NaN too
        return None
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def image_of(message: Any, columns: int, bottom: float = 1.0) -> tuple[Image, str]:
    """Pixels of a ``sensor_msgs/Image`` or ``CompressedImage`` and their encoding; a view where nothing is decoded.

    Parameters
    ----------
    message : Image or CompressedImage
        Raw image, or JPEG or PNG bytes.
    columns : int
        Width the compass works at; a JPEG is decoded no larger than this needs.
    bottom : float
        Share of the height, from the top, that it looks at; of a JPEG the rest may be left black.

    Raises
    ------
    ImageError
        Unknown encoding, zero size, wrong `step` or length of `data`, corrupt JPEG.
    """
    if hasattr(message, "format"):
        return image_from_compressed(message.data, columns, str(message.format), bottom), ""
    m = message
    return image_from_raw(m.data, m.encoding, m.height, m.width, m.step, bool(m.is_bigendian)), m.encoding
