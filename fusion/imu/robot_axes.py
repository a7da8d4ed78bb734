"""How the IMU is mounted, by the axis about which the robot turns."""

from __future__ import annotations

import math

from compass.tilt import Vector
from fusion.checks.silence import RATE_SILENT_NS
from fusion.imu.vectors import AXES, cross, dot, unit

_TELLING = 0.5  # rad of turning that show the robot's own axis; not derived
# How near to the vertical (cosines) an axis of the IMU begins that is taken for the robot's own, and the turning (rad)
# that this counts for. Within 10 deg it is mounted right to 2 deg, and bumps of 6 deg turn the robot about other axes
# by 0.1 rad in all. From 18 to 35 deg it counts for little, slope or IMU pitched on purpose: to guess wrong costs
# 0.1 deg, as the compass then contradicts the gyro; to wait costs 0.5 deg on a slope. Between, a wrong guess would pass
# unseen and cost 0.6 deg: nothing is guessed.
_ALIGNED = (
    (math.cos(math.radians(10.0)), 1.0, 0.1 / math.radians(2.0)),
    (math.cos(math.radians(35.0)), math.cos(math.radians(18.0)), 0.1),
)
# Not derived: `_TURNING`, `_MOSTLY`.
_TURNING = 0.3  # rad/s; slower, and the gyro's bias counts
_MOSTLY = 0.7  # of the rate is about the vertical when a robot turns; else it tips over an edge


class RobotAxes:
    """Distinguishes a tilted robot from an IMU that is mounted askew, by the axis about which the robot turns.

    At first that is taken to be the axis of the IMU next to the vertical, firmly within 10 deg of it, loosely from 18
    to 35 deg; where there is none, the tilt is not known until the robot has turned by 0.5 rad. Nor is it of an IMU
    that has `moved` in its mount.
    """

    def __init__(self, *, moved: bool = False) -> None:
        self._turned: Vector = (0.0, 0.0, 0.0)  # all turning, to the right taken for to the left, rad
        self._aligned: Vector | None = (
            (0.0, 0.0, 0.0) if moved else None
        )  # axis of the IMU taken for the robot's own, times what it counts, squared

    def learn(self, step_ns: int, rate: Vector, up: Vector) -> None:
        """Note about which axis the robot turns: time since the last reading, ns; rad/s; the vertical."""
        if self._aligned is None:
            cosine, (x, y, z) = max((dot(axis, up), axis) for axis in AXES.values())
            counts = next((counts for low, high, counts in _ALIGNED if low <= cosine <= high + 1e-9), 0.0)
            self._aligned = counts**2 * x, counts**2 * y, counts**2 * z
        turning = dot(up, rate)
        if abs(turning) < max(_TURNING, _MOSTLY * math.sqrt(dot(rate, rate))) or not 0 < step_ns <= RATE_SILENT_NS:
            return
        turn = math.copysign(step_ns * 1e-9, turning)
        (x, y, z), (wx, wy, wz) = self._turned, rate
        self._turned = x + turn * wx, y + turn * wy, z + turn * wz

    def known(self, along: Vector | None) -> tuple[Vector, Vector, Vector] | None:
        """The robot's axes in the IMU's frame, `along` looking forward; None while the mount is not known."""
        aligned = self._aligned
        if along is None or aligned is None:
            return None
        turned = math.sqrt(dot(self._turned, self._turned))  # its direction errs by one over that
        z = unit([one + turned * other for one, other in zip(aligned, self._turned, strict=True)])
        if z is None or (turned < _TELLING and not any(aligned)):
            return None
        y = unit(cross(z, along))
        return (cross(y, z), y, z) if y else None
