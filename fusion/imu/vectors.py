"""Vectors of three plain floats: an IMU's samples come one by one, where arrays would cost ten times as much."""

from __future__ import annotations

import math
from collections.abc import Sequence

from compass.tilt import Vector

AXES: dict[str, Vector] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}


def vector(values: Sequence[float]) -> Vector:
    """Three plain floats."""
    x, y, z = values
    return float(x), float(y), float(z)


def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def unit(values: Sequence[float] | None) -> Vector | None:
    """Direction of a vector; None when it has none."""
    if values is None:
        return None
    one = vector(values)
    length = math.sqrt(dot(one, one))
    if not 1e-3 < length < math.inf:  # false for NaN too
        return None
    return one[0] / length, one[1] / length, one[2] / length


def turned(fixed: Vector, rate: Vector, seconds: float) -> Vector:
    """Where the IMU, turning at `rate` rad/s, sees a fixed direction after some seconds (Rodrigues' formula).

    To the first order would do for the turns of a robot; a gyro in deg/s turns by a radian between two samples.
    """
    speed = math.sqrt(dot(rate, rate))
    if not speed:
        return fixed
    angle = speed * seconds
    c, s = math.cos(angle), math.sin(angle) / speed
    along = (1.0 - c) * dot(rate, fixed) / (speed * speed)
    (x, y, z), (wx, wy, wz), (tx, ty, tz) = fixed, rate, cross(rate, fixed)
    return c * x - s * tx + along * wx, c * y - s * ty + along * wy, c * z - s * tz + along * wz


def nearest_axis(direction: Vector) -> tuple[str, float]:
    """The IMU's axis next to a unit vector, and the angle between them, rad."""
    name = max(AXES, key=lambda axis: dot(AXES[axis], direction))
    return name, math.acos(min(dot(AXES[name], direction), 1.0))
