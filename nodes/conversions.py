"""Results of the pipeline to ROS messages. Pure functions; the way in is `fusion.messages`."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

from fusion import YawEstimate
from fusion.dead_reckoning import Place
from fusion.messages import MessageError, yaw_of

UNMEASURED = 1e6  # variance of an axis nobody measured: large, yet finite, so that a filter can invert it
_CERTAIN = 1e-9  # rad^2, m^2; a pose set "exactly", with variance 0, still leaves the filter something to invert
_UNKNOWN = math.pi**2  # rad^2; a sigma of half a turn says nothing, and more would only cost the filter its digits
_UNMEASURED_COVARIANCE = np.diag(np.full(6, UNMEASURED)).reshape(36)
YAW = 35  # place of the yaw's variance in a row-major 6x6 covariance


def ns_to_stamp(t_ns: int) -> Time:
    """``builtin_interfaces/Time`` of integer nanoseconds."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def pose_yaw(message: PoseWithCovarianceStamped) -> tuple[float, float]:
    """Yaw, rad, and its variance, rad^2, of a ``set_pose`` message.

    Raises
    ------
    MessageError
        The quaternion is no rotation, or the variance of yaw is negative or not finite.
    """
    yaw, variance = yaw_of(message.pose.pose.orientation), float(message.pose.covariance[YAW])
    if yaw is None:
        raise MessageError("the orientation is no unit quaternion")
    if not 0.0 <= variance < math.inf:
        raise MessageError(f"variance of yaw is {variance:g}; give 0 or more")
    return yaw, min(max(variance, _CERTAIN), _UNKNOWN)


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
    covariance = _UNMEASURED_COVARIANCE.copy()
    covariance[YAW] = variance
    return covariance


def fused_odometry(estimate: YawEstimate, frames: tuple[str, str], place: Place | None = None) -> Odometry:
    """The fused estimate as Odometry; x, y and the speed as well where the `place` is known."""
    message = yaw_odometry(
        estimate.t_ns, estimate.yaw, estimate.heading_variance, estimate.yaw_rate, estimate.yaw_rate_variance, frames
    )
    if place is not None:
        message.pose.pose.position.x, message.pose.pose.position.y = place.x, place.y
        message.twist.twist.linear.x = place.speed
        for (row, column), value in np.ndenumerate(place.covariance):
            message.pose.covariance[6 * row + column] = value + (_CERTAIN if row == column else 0.0)
        message.twist.covariance[0] = place.speed_variance + _CERTAIN
    return message


def pose_place(message: PoseWithCovarianceStamped) -> tuple[float, float, tuple[float, float, float]]:
    """Position x, y, m, and its covariance xx, xy, yy, m^2, of a ``set_pose`` message.

    Raises
    ------
    MessageError
        A number is not finite, or the covariance is none.
    """
    position, covariance = message.pose.pose.position, message.pose.covariance
    xx, xy, yy = float(covariance[0]), float(covariance[1]), float(covariance[7])
    if not all(map(math.isfinite, (position.x, position.y, xx, xy, yy))) or min(xx, yy, xx * yy - xy * xy) < 0.0:
        raise MessageError("position or its covariance is not finite, or that is no covariance")
    return position.x, position.y, (xx, xy, yy)
