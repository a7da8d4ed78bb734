"""The rate about the vertical, from an IMU mounted any way round on a robot that rolls and pitches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from compass.parameters import ParameterSet, parameter
from compass.tilt import Vector
from fusion.buffer.events import NONSENSE_RATE
from fusion.checks.warnings import Warning
from fusion.imu.end_stop import EndStop
from fusion.imu.gravity import Gravity
from fusion.imu.halves import Halves
from fusion.imu.orientation import Orientation
from fusion.imu.robot_axes import RobotAxes
from fusion.imu.tilt import STEEPEST_SQUARED
from fusion.imu.vectors import AXES, dot, nearest_axis, vector
from fusion.imu.warnings import REMEMBERED_NS, Complaints
from fusion.samples import GyroSample

# Of a rate: IMUs are mounted level or nearly so, by a bracket's 20 deg at most, which nobody has counted: not derived.
UNKNOWN_MOUNT = 1.0 - math.cos(math.radians(20.0))
FASTEST_GYRO = 35.0  # rad/s; 2000 deg/s is the largest range of such gyros


@dataclass(frozen=True)
class ImuConfig(ParameterSet):
    """How the IMU sits on the robot; the defaults find it out."""

    up: str = parameter(
        "auto",
        "where the vertical comes from: the orientation field, gravity, a fixed axis of the IMU, or auto: the"
        " orientation while it agrees with gravity, else gravity",
        choices=("auto", "orientation", "gravity", *AXES),
    )
    forward: str = parameter(
        "auto", "axis of the IMU that looks along the robot's +x; auto: +x, or +y where x stands upright",
        choices=("auto", *AXES),
    )  # fmt: skip
    gravity_time: float = parameter(
        10.0, "time over which accelerations average out to gravity", unit="s", low=0.1, high=1000.0
    )


class ImuLevel:
    """Takes roll, pitch and mount out of the gyro: angular velocity in, yaw rate out.

    With `u` the vertical and `f` the forward direction, both unit vectors in the IMU's frame, the heading of `f`
    turns at ``(u.w - (u.f)(f.w)) / (1 - (u.f)^2)``. For an IMU aligned with the robot that is the textbook's
    ``(wy sin(roll) + wz cos(roll)) / cos(pitch)`` (Titterton & Weston 2004, Strapdown Inertial Navigation
    Technology, eq. 3.52). It is causal: the same samples give the same rates and warnings, live or from a bag.

    What the driver's fields really hold is looked at, not taken for granted: an accelerometer without gravity, an
    orientation that does not move with the gyro, and messages that carry half of the IMU are left out.

    Attributes
    ----------
    up : (3,) tuple of float or None
        The vertical in the IMU's frame; None while it is not known, and the IMU's z axis is taken.
    source : str
        Where it came from last: ``orientation``, ``gravity``, an axis by `ImuConfig.up`, or ``none``.
    """

    def __init__(self, config: ImuConfig | None = None) -> None:
        self.config = config or ImuConfig()
        self.reset()

    def reset(self) -> None:
        """Forget the vertical found so far, and what was wrong."""
        config = self.config
        self._gravity = Gravity(config.gravity_time, any_length=config.up == "gravity")
        self._orientation = Orientation(config.gravity_time)
        self._halves, self._stops = Halves(), (EndStop(), EndStop(), EndStop())
        self._force: Sequence[float] | None = None
        self._complaints = Complaints()
        self._t_ns: int | None = None
        self._fastest = 0.0
        self._moved_ns: int | None = None
        self._forget_up()

    def _forget_up(self) -> None:
        self._forward = AXES.get(self.config.forward)
        self._axes = RobotAxes()
        self.up: Vector | None = AXES.get(self.config.up)
        self.source = self.config.up if self.up else "none"

    def sample(
        self,
        t_ns: int,
        angular_velocity: Sequence[float],
        linear_acceleration: Sequence[float] | None = None,
        orientation: Sequence[float] | None = None,
    ) -> GyroSample | None:
        """Turn one IMU reading into a gyro sample.

        Parameters
        ----------
        t_ns : int
            ``header.stamp``, ns.
        angular_velocity : (3,) sequence of float
            rad/s in the IMU's frame; three times NaN where the message carries none.
        linear_acceleration : (3,) sequence of float, optional
            Specific force in the IMU's frame, gravity included (points up at rest); m/s^2 or g; None where unknown.
        orientation : (4,) sequence of float, optional
            Quaternion x, y, z, w, IMU to a world with z up; None where the IMU gives none.

        Returns
        -------
        GyroSample or None
            None for a message that carries no gyro. Its `yaw_rate` is not finite where
            `angular_velocity` isn't: the filter counts and refuses it. Its `variance` is large at an end stop.
        """
        rate = vector(angular_velocity)
        force = linear_acceleration if linear_acceleration is not None and any(linear_acceleration) else None
        absent = all(map(math.isnan, rate))
        carries = not absent and self._halves.carries_gyro(any(rate), force is not None)
        if force is None or any(map(math.isnan, force)):
            force = self._force  # the half that came before belongs to this gyro
        self._force = None if carries else force
        if not carries:
            return None
        variance = None
        if all(abs(r) <= NONSENSE_RATE for r in rate):  # false for NaN, too; nonsense would tilt the vertical for long
            step_ns = 0 if self._t_ns is None else t_ns - self._t_ns
            self._t_ns = t_ns
            self._gravity.follow(step_ns, rate, force)
            if self._gravity.moved:
                self._moved_ns = t_ns
                if self.source == "gravity":
                    self._forget_up()
                    self._axes = RobotAxes(moved=True)
            self._orientation.follow(step_ns, rate, orientation, self._gravity.up)
            self._choose_up()
            if self.up is not None and self.config.up not in AXES:
                self._axes.learn(step_ns, rate, self.up)
            variance = self._variance(rate)
            self._complain(t_ns, rate, variance is not None)
        doubtful = self._gravity.doubtful and self.source == "gravity"
        if doubtful:
            variance = max(variance or 0.0, dot(rate, rate))  # any share of it may be about the vertical
        yaw_rate, axes = self._yaw_rate(rate), self._axes.known(self._forward)
        if axes is None or self.up is None or doubtful:
            return GyroSample(t_ns, yaw_rate, variance, factor_sigma=self._factor_sigma)
        x, y, z = axes
        up = dot(self.up, x), dot(self.up, y), dot(self.up, z)
        return GyroSample(t_ns, yaw_rate, variance, up=up, cross_rate=None if variance else dot(y, rate))

    def warnings(self) -> tuple[Warning, ...]:
        """What is wrong with the IMU after the newest sample."""
        return self._complaints.present

    @property
    def vertical(self) -> str:
        """Where up came from, in words."""
        if self.config.up in AXES:
            return f"the IMU's {self.config.up} axis, as imu.up says"
        if self.up is None:
            return "nothing; the IMU's +z axis was taken"
        name, angle = nearest_axis(self.up)
        where = f"{math.degrees(angle):.0f} deg from the IMU's {name} axis"
        if self.source == "orientation":
            return f"the orientation field, {where}"
        return f"the accelerometer, {where} ({self._gravity.length:.3g} {self._gravity.unit or 'of unknown unit'})"

    def _choose_up(self) -> None:
        """Take the vertical from the configured source, or from the best there is."""
        config, orientation = self.config.up, self._orientation
        if config in AXES:
            return
        if config == "orientation" or (config == "auto" and orientation.believed):
            found, source = orientation.up, "orientation"
        else:
            found, source = self._gravity.up, "gravity"
        if found is not None:
            self.up, self.source = found, source
        elif self.source == "orientation" and config == "auto" and orientation.unlike_gyro:
            self._forget_up()  # it never was the vertical
        elif self.source == "gravity" and not self._gravity.settled:
            self._forget_up()  # taken from too few samples

    @property
    def _known(self) -> bool:
        """Whether the vertical is measured or given at present."""
        measured = {"orientation": self._orientation.up, "gravity": self._gravity.up, "none": None}
        return measured.get(self.source, self.up) is not None

    @property
    def _factor_sigma(self) -> float:
        """Of the rate about an axis that was taken for the vertical, as nothing says where that is."""
        unknown = self.up is None and any(one.code == "vertical_unknown" for one in self.warnings())
        return UNKNOWN_MOUNT if unknown else 0.0

    def _variance(self, rate: Vector) -> float | None:
        """Of a sample whose gyro is at an end stop, (rad/s)^2: the rate may be twice as high; None of any other."""
        at_stop = [stop.value for stop, one in zip(self._stops, rate, strict=True) if stop.reached(one)]
        return max(at_stop) ** 2 if at_stop else None

    def _yaw_rate(self, rate: Vector) -> float:
        """Rate of heading of the forward axis, rad/s."""
        up = self.up or AXES["+z"]  # the vertical is not known: REP-103 says z
        if self._forward is None and self.up is not None:
            self._forward = AXES["+x"] if abs(up[0]) < math.sqrt(0.5) else AXES["+y"]
        forward = self._forward or AXES["+x"]
        tilt = dot(up, forward)
        level = 1.0 - tilt * tilt
        if level < STEEPEST_SQUARED:  # forward points at the sky: it has no heading
            return dot(up, rate)
        return (dot(up, rate) - tilt * dot(forward, rate)) / level

    # ------------------------------------------------------------ what is wrong

    def _complain(self, t_ns: int, rate: Vector, at_stop: bool) -> None:
        """Bring the warnings up to date."""
        wrong, config, gravity, orientation = self._complaints, self.config.up, self._gravity, self._orientation
        self._fastest = max(self._fastest, *map(abs, rate))
        wrong.event("gyro_units", t_ns, max(map(abs, rate)) > FASTEST_GYRO, self._units_words)
        wrong.event("gyro_saturated", t_ns, at_stop, self._stop_words)
        wrong.state("imu_half_messages", t_ns, self._halves.certain, _half_words)
        moved = self._moved_ns is not None and t_ns - self._moved_ns <= REMEMBERED_NS
        wrong.state("imu_moved", t_ns, moved, self._moved_words)
        if config in AXES:
            return
        wrong.state("vertical_unknown", t_ns, not self._known, self._unknown_words)
        unusual = gravity.up is not None and gravity.unit != "m/s^2"
        wrong.state("accelerometer_units", t_ns, unusual and config != "orientation", self._acceleration_words)
        contradicted = config == "auto" and orientation.up is not None and not orientation.believed
        wrong.state("orientation_wrong", t_ns, contradicted, self._orientation_words)

    def _units_words(self) -> str:
        return (
            f"angular velocities of up to {self._fastest:.0f} rad/s, beyond the {FASTEST_GYRO:.0f} rad/s"
            " (2000 deg/s) of such gyros: in deg/s? sensor_msgs/Imu wants rad/s; mend the driver's scale"
        )

    def _stop_words(self) -> str:
        stops = {axis: stop.value for axis, stop in zip("xyz", self._stops, strict=True) if stop.value}
        named = ", ".join(
            f"{axis} at {value:.4g} rad/s ({math.degrees(value):.0f} deg/s)" for axis, value in stops.items()
        )
        return (
            f"the gyro's axis {named} repeats its greatest value to the last bit: at its end stop, the true rate may be"
            " anything beyond; set a larger range in the driver, or turn more slowly"
        )

    def _moved_words(self) -> str:
        return (
            "the accelerometer sees up elsewhere than before, and the gyro did not turn there: the IMU came loose, was"
            f" mounted anew, or its driver gives other axes; up comes from {self.vertical} since. Fix it, start anew"
        )

    def _unknown_words(self) -> str:
        kept = "the gyro's +z axis was taken" if self.up is None else "the last known vertical was kept"
        return (
            f"where up is in the IMU's frame is not known: {self._no_gravity()}; {self._no_orientation()}."
            f" So {kept}; say which axis points up with `imu.up`, such as `imu.up: +z`"
        )

    def _no_gravity(self) -> str:
        """Why the accelerometer gives no vertical."""
        if self._gravity.silent:
            return "no accelerations (zero, not finite, or their covariance begins with -1)"
        return (
            f"the accelerations average to {self._gravity.length:.2g}, where gravity would be 9.8 m/s^2"
            " (does the driver remove it?)"
        )

    def _no_orientation(self) -> str:
        """Why the orientation gives no vertical."""
        if self._orientation.up is None:
            return "no orientation (no unit quaternion, or its covariance begins with -1)"
        return "the orientation does not turn as the gyro does"

    def _acceleration_words(self) -> str:
        if self._gravity.unit is None:
            return (
                f"gravity measures {self._gravity.length:.3g}, which it does in no unit known; it was taken for the"
                " vertical, as `imu.up: gravity` says; sensor_msgs/Imu wants m/s^2"
            )
        return (
            f"gravity measures {self._gravity.length:.3g}, as in {self._gravity.unit}, where sensor_msgs/Imu wants"
            " m/s^2; its direction was used all the same; mend the driver's scale"
        )

    def _orientation_words(self) -> str:
        orientation, gravity = self._orientation.up, self._gravity.up
        if not self._orientation.contradicts_gravity or orientation is None or gravity is None:
            seen = "does not turn as the gyro does"
        else:
            cosine = max(-1.0, min(1.0, dot(orientation, gravity)))
            seen = f"says up is {math.degrees(math.acos(cosine)):.0f} deg off where gravity says"
        return (
            f"the IMU's orientation {seen} (never set, the yaw only, or in another frame?) and was left out;"
            f" up is taken from {self.vertical}; if the orientation is right: `imu.up: orientation`"
        )


def _half_words() -> str:
    return (
        "messages bring the gyro and the accelerometer in turn, exact zeros standing for the other; those without"
        " a gyro were not taken for a gyro at rest; let the driver send both in one message"
    )
