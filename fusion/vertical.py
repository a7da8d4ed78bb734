"""The rate about the vertical, from an IMU mounted any way round on a robot that rolls and pitches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from compass.attitude import Vector
from compass.parameters import ParameterSet, parameter
from fusion.events import FASTEST
from fusion.samples import GyroSample

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
_YOUNG = 3.0  # s; from less a start would be taken for a bias
_LONGEST_STEP_NS = 500_000_000  # over a longer silence the turn is unknown: gravity alone decides
_TELLING = 0.5  # rad of turning that tell the robot's own axis
# how near to the vertical (cosine) an axis of the IMU begins that is taken for the robot's own, and the turning (rad)
# that this counts for: within 10 deg it is mounted right to 2 deg, and bumps of 6 deg turn the robot about other axes
# by 0.1 rad in all; it counts for little if it is a slope, or an IMU pitched on purpose
_ALIGNED = ((math.cos(math.radians(10.0)), 0.1 / math.radians(2.0)), (math.cos(math.radians(35.0)), 0.1))
_TURNING = 0.3  # rad/s; slower, and the gyro's bias counts
_MOSTLY = 0.7  # of the rate is about the vertical when a robot turns; else it tips over an edge


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

    A robot that leans is told from an IMU that is mounted askew by the axis about which the robot turns. At first that
    is taken to be the axis of the IMU next to the vertical, firmly within 10 deg of it, loosely within 35 deg; where
    there is none, nothing is said of the lean until the robot has turned by 0.5 rad.
    """

    def __init__(self, config: ImuConfig | None = None) -> None:
        self.config = config or ImuConfig()
        self.reset()

    def reset(self) -> None:
        """Forget the vertical found so far."""
        self._gravity: Vector | None = None
        self._forward = _AXES.get(self.config.forward)
        self._age = 0.0
        self._drift: Vector = (0.0, 0.0, 0.0)  # bias of the gyro across the vertical, rad/s
        self._t_ns: int | None = None
        self._turned: Vector = (0.0, 0.0, 0.0)  # all turning, to the right taken for to the left, rad
        self._aligned: Vector | None = None  # axis of the IMU taken for the robot's own, times what it counts, squared
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
            step_ns = 0 if self._t_ns is None else t_ns - self._t_ns
            self._t_ns = t_ns
            self._follow_gravity(step_ns, rate, _unit(linear_acceleration))
            self._choose_up(orientation)
            self._learn_axis(step_ns, rate)
        yaw_rate, axes = self._yaw_rate(rate), self._robot_axes()
        if axes is None or self.up is None:
            return GyroSample(t_ns, yaw_rate)
        x, y, z = axes
        up = _dot(self.up, x), _dot(self.up, y), _dot(self.up, z)
        return GyroSample(t_ns, yaw_rate, up=up, cross_rate=_dot(y, rate))

    def _follow_gravity(self, step_ns: int, rate: Vector, force: Vector | None) -> None:
        """Turn the last vertical with the gyro, then draw it towards the accelerometer.

        What the gyro's bias does to it time after time is learnt (Mahony, Hamel & Pflimlin 2008,
        doi:10.1109/TAC.2008.923738): it would lean by the bias times `gravity_time`.
        """
        if self._gravity is None or not 0 <= step_ns <= _LONGEST_STEP_NS:
            self._gravity, self._age = force or self._gravity, 0.0
            return
        dt = step_ns * 1e-9
        (gx, gy, gz), (wx, wy, wz), (bx, by, bz) = self._gravity, rate, self._drift
        tx, ty, tz = _cross((wx - bx, wy - by, wz - bz), self._gravity)
        turned = gx - dt * tx, gy - dt * ty, gz - dt * tz
        # A plain mean while young, then a mean that forgets.
        gain = dt / (self._age + 2.0 * dt) if force and dt > 0.0 else 0.0
        self._age = min(self._age + dt, self.config.gravity_time)
        towards = force or turned
        if force and gain > 0.0:
            pull = dt / max(self._age, _YOUNG) ** 2
            across = _cross(turned, force)
            self._drift = _vector([drift + pull * a for drift, a in zip(self._drift, across, strict=True)])
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

    def _learn_axis(self, step_ns: int, rate: Vector) -> None:
        """Note about which axis the robot turns."""
        if self.up is None or self.config.up in _AXES:
            return
        if self._aligned is None:
            cosine, (x, y, z) = max((_dot(axis, self.up), axis) for axis in _AXES.values())
            counts = next((counts for near, counts in _ALIGNED if cosine >= near), 0.0)
            self._aligned = counts**2 * x, counts**2 * y, counts**2 * z
        turning = _dot(self.up, rate)
        if abs(turning) < max(_TURNING, _MOSTLY * math.sqrt(_dot(rate, rate))) or not 0 < step_ns <= _LONGEST_STEP_NS:
            return
        turn = math.copysign(step_ns * 1e-9, turning)
        (x, y, z), (wx, wy, wz) = self._turned, rate
        self._turned = x + turn * wx, y + turn * wy, z + turn * wz

    def _robot_axes(self) -> tuple[Vector, Vector, Vector] | None:
        """The robot's axes in the IMU's frame; None while it is not known how the IMU is mounted."""
        along, aligned = self._forward, self._aligned
        if along is None or aligned is None:
            return None
        turned = math.sqrt(_dot(self._turned, self._turned))  # its direction errs by one over that
        z = _unit([one + turned * other for one, other in zip(aligned, self._turned, strict=True)])
        if z is None or (turned < _TELLING and not any(aligned)):
            return None
        y = _unit(_cross(z, along))
        return (_cross(y, z), y, z) if y else None

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


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


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
