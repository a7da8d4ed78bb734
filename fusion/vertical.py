"""The rate about the vertical, from an IMU mounted any way round on a robot that rolls and pitches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from compass.parameters import ParameterSet, parameter
from fusion.events import FASTEST
from fusion.samples import GyroSample

Vector = tuple[float, float, float]

_AXES: dict[str, Vector] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
_AGREEMENT = math.cos(
    math.radians(20.0)
)  # an orientation further off gravity than a filter's transients is in another frame
_LONGEST_STEP_NS = 500_000_000  # over a longer silence the turn is unknown: gravity alone decides


@dataclass(frozen=True)
class ImuConfig(ParameterSet):
    """How the IMU sits on the robot; the defaults find it out."""

    up: str = parameter(
        "auto",
        "where the vertical comes from: the orientation field, gravity, a fixed axis of the IMU, or auto: the"
        " orientation while it agrees with gravity, else gravity",
        choices=("auto", "orientation", "gravity", *_AXES),
    )
    forward: str = parameter(
        "auto", "axis of the IMU that looks along the robot's +x; auto: +x, or +y where x stands upright",
        choices=("auto", *_AXES),
    )  # fmt: skip
    gravity_time: float = parameter(
        10.0, "time over which accelerations average out to gravity", unit="s", low=0.1, high=1000.0
    )


class ImuLevel:
    """Takes roll, pitch and mount out of the gyro: angular velocity in, yaw rate out.

    With `u` the vertical and `f` the forward direction, both unit vectors in the IMU's frame, the heading of `f`
    turns at ``(u.w - (u.f)(f.w)) / (1 - (u.f)^2)``. For an IMU aligned with the robot that is the textbook's
    ``(wy sin(roll) + wz cos(roll)) / cos(pitch)`` (Titterton & Weston 2004, Strapdown Inertial Navigation
    Technology, eq. 3.52). It is causal: the same samples give the same rates, live or from a bag.
    """

    def __init__(self, config: ImuConfig | None = None) -> None:
        self.config = config or ImuConfig()
        self.reset()

    def reset(self) -> None:
        """Forget the vertical found so far."""
        self._gravity: Vector | None = None
        self._forward = _AXES.get(self.config.forward)
        self._age = 0.0
        self._t_ns: int | None = None
        self.up: Vector | None = _AXES.get(self.config.up)
        self.source = self.config.up if self.up else "none"

    def sample(
        self,
        t_ns: int,
        angular_velocity: Sequence[float],
        linear_acceleration: Sequence[float] | None = None,
        orientation: Sequence[float] | None = None,
    ) -> GyroSample:
        """Turn one IMU reading into a gyro sample.

        Parameters
        ----------
        t_ns : int
            ``header.stamp``, ns.
        angular_velocity : (3,) sequence of float
            rad/s in the IMU's frame.
        linear_acceleration : (3,) sequence of float, optional
            Specific force in the IMU's frame, gravity included (points up at rest); any unit; None where unknown.
        orientation : (4,) sequence of float, optional
            Quaternion x, y, z, w, IMU to a world with z up; None where the IMU gives none.

        Returns
        -------
        GyroSample
            Its `yaw_rate` is not finite where `angular_velocity` isn't: the filter counts and refuses it.
        """
        rate = _vector(angular_velocity)
        if all(abs(r) <= FASTEST for r in rate):  # false for NaN, too; nonsense would tilt the vertical for long
            self._follow_gravity(t_ns, rate, _unit(linear_acceleration))
            self._choose_up(orientation)
        return GyroSample(t_ns, self._yaw_rate(rate))

    def _follow_gravity(self, t_ns: int, rate: Vector, force: Vector | None) -> None:
        """Turn the last vertical with the gyro, then draw it towards the accelerometer."""
        step_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        self._t_ns = t_ns
        if self._gravity is None or not 0 <= step_ns <= _LONGEST_STEP_NS:
            self._gravity, self._age = force or self._gravity, 0.0
            return
        dt = step_ns * 1e-9
        gx, gy, gz = self._gravity
        wx, wy, wz = rate
        turned = (gx - dt * (wy * gz - wz * gy), gy - dt * (wz * gx - wx * gz), gz - dt * (wx * gy - wy * gx))
        # A plain mean while young, then a mean that forgets.
        gain = dt / (self._age + 2.0 * dt) if force and dt > 0.0 else 0.0
        self._age = min(self._age + dt, self.config.gravity_time)
        towards = force or turned
        self._gravity = _unit([(1.0 - gain) * a + gain * b for a, b in zip(turned, towards, strict=True)])

    def _choose_up(self, orientation: Sequence[float] | None) -> None:
        """Take the vertical from the configured source, or from the best there is."""
        if self.config.up in _AXES:
            return
        level = None if self.config.up == "gravity" else _up_of(orientation)
        if level and self.config.up == "auto" and self._gravity and _dot(level, self._gravity) < _AGREEMENT:
            level = None
        found = level or (None if self.config.up == "orientation" else self._gravity)
        if found:
            self.up, self.source = found, "orientation" if level else "gravity"

    def _yaw_rate(self, rate: Vector) -> float:
        """Rate of heading of the forward axis, rad/s."""
        up = self.up or _AXES["+z"]  # nothing tells the vertical: REP-103 says z
        if self._forward is None and self.up is not None:
            self._forward = _AXES["+x"] if abs(up[0]) < math.sqrt(0.5) else _AXES["+y"]
        forward = self._forward or _AXES["+x"]
        tilt = _dot(up, forward)
        level = 1.0 - tilt * tilt
        if level < 0.1:  # forward points at the sky: it has no heading
            return _dot(up, rate)
        return (_dot(up, rate) - tilt * _dot(forward, rate)) / level


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = values
    return float(x), float(y), float(z)


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(values: Sequence[float] | None) -> Vector | None:
    """Direction of a vector; None when it has none."""
    if values is None:
        return None
    vector = _vector(values)
    length = math.sqrt(_dot(vector, vector))
    if not 1e-3 < length < math.inf:
        return None
    return vector[0] / length, vector[1] / length, vector[2] / length


def _up_of(orientation: Sequence[float] | None) -> Vector | None:
    """The world's z axis seen from the IMU: third row of the rotation matrix. None for an unusable quaternion."""
    if orientation is None:
        return None
    x, y, z, w = (float(value) for value in orientation)
    if not 0.9 < x * x + y * y + z * z + w * w < 1.1:  # false for NaN too
        return None
    return _unit((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z))
