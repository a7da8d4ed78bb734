"""Where the robot really goes: smooth in speed and turn rate, exact in yaw.

A drive is a list of legs, each with a constant speed and turn rate. Between legs both change along a smooth step, so
the yaw is a sum of integrated steps, known in closed form. A driver's small steering corrections and the slope of rough
ground are closed forms too; only the position is integrated numerically.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Floats = npt.NDArray[np.float64]

_GRID_HZ = 1000


@dataclass(frozen=True, slots=True)
class Leg:
    """For `duration` s drive at `speed` m/s and turn at `yaw_rate` rad/s."""

    duration: float
    speed: float
    yaw_rate: float


def stand(duration: float) -> Leg:
    """Stand still for `duration` s."""
    return Leg(duration, 0.0, 0.0)


def straight(distance: float, speed: float) -> Leg:
    """Drive `distance` m ahead at `speed` m/s; both negative: backward."""
    return Leg(distance / speed, speed, 0.0)


def spin(angle_deg: float, rate: float) -> Leg:
    """Turn on the spot by `angle_deg`, positive to the left, at `rate` rad/s (positive)."""
    return Leg(abs(np.deg2rad(angle_deg)) / rate, 0.0, float(np.copysign(rate, angle_deg)))


def curve(angle_deg: float, radius: float, speed: float) -> Leg:
    """Drive round a bend of `radius` m, positive angles to the left."""
    rate = float(np.copysign(speed / radius, angle_deg))
    return Leg(abs(np.deg2rad(angle_deg)) / abs(rate), speed, rate)


@dataclass(frozen=True, slots=True)
class Ground:
    """Bumps of the ground: waves of `height` m (each, deviation) and 1 to 6 m long; their pattern depends on `seed`."""

    height: float = 0.0
    seed: int = 0

    def slope(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Height, m, and its slopes along x and y at points (x, y), m."""
        rng = np.random.default_rng(self.seed)
        total, along_x, along_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
        if self.height == 0.0:
            return total, along_x, along_y
        for length in (1.1, 1.7, 2.6, 4.0, 6.0):
            direction, phase = rng.uniform(0, 2 * np.pi, 2)
            kx, ky = 2 * np.pi / length * np.cos(direction), 2 * np.pi / length * np.sin(direction)
            swell = self.height * length / 3.0
            angle = kx * x + ky * y + phase
            total += swell * np.sin(angle)
            along_x += swell * kx * np.cos(angle)
            along_y += swell * ky * np.cos(angle)
        return total, along_x, along_y


@dataclass(frozen=True, slots=True)
class Motion:
    """The robot's true motion at times `t`; arrays of one shape.

    Attributes
    ----------
    t : ndarray
        s since the start.
    x, y, z : ndarray
        Position of the robot's base in the world, m.
    yaw, pitch, roll : ndarray
        Attitude, rad, yaw unwrapped; rotation Rz(yaw) Ry(pitch) Rx(roll), pitch positive with the nose down.
    speed, yaw_rate : ndarray
        Along +x of the base, m/s; of the yaw angle, rad/s.
    """

    t: Floats
    x: Floats
    y: Floats
    z: Floats
    yaw: Floats
    pitch: Floats
    roll: Floats
    speed: Floats
    yaw_rate: Floats


@dataclass(frozen=True)
class Trajectory:
    """A drive along `legs`.

    Attributes
    ----------
    legs : sequence of Leg
        Beginning and ending at rest is up to them.
    start : tuple of float
        x, y in m and heading in rad in the world.
    ramp : float
        Time in which speed and turn rate change from leg to leg, s.
    wobble : float
        Deviation of the steering corrections at full speed, rad.
    unsteady : float
        Deviation of the turn rate from the legs', relative to the fastest of them.
    wander : float
        How far a full turn on the spot displaces the robot, m.
    ground : Ground
        Its bumps.
    sunk : float
        The whole place, floor and walls, has sunk at the far end of its x axis by this angle, rad.
    """

    legs: Sequence[Leg]
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.6
    wobble: float = 0.0
    unsteady: float = 0.0
    wander: float = 0.0
    ground: Ground = Ground()
    sunk: float = 0.0

    @cached_property
    def in_place(self) -> Trajectory:
        """The same drive as seen from the place, however that has sunk."""
        return replace(self, sunk=0.0)

    @property
    def duration(self) -> float:
        """s."""
        return float(sum(leg.duration for leg in self.legs))

    def at(self, t: Floats) -> Motion:
        """The true motion at times `t`, s since the start, z being up; before and after, the robot stands."""
        if self.sunk:
            half = 0.5e-3
            before, after = (self._sunk(t + dt).yaw for dt in (-half, half))
            return replace(self._sunk(t), yaw_rate=(after - before) / (2.0 * half))
        t = np.asarray(t, np.float64)
        yaw, yaw_rate = self._yaw(t)
        x, y = (np.interp(t, self._grid, path) for path in self._path)
        z, along_x, along_y = self.ground.slope(x, y)
        forward = along_x * np.cos(yaw) + along_y * np.sin(yaw)
        left = along_y * np.cos(yaw) - along_x * np.sin(yaw)
        pitch = -np.arctan(forward)
        roll = np.arctan(left * np.cos(pitch))
        return Motion(t, x, y, z, yaw, pitch, roll, self._steps(t, "speed")[0], yaw_rate)

    def _sunk(self, t: Floats) -> Motion:
        """The motion in a place that has sunk, but for the rate of the yaw."""
        motion, whole = self.in_place.at(t), Rotation.from_euler("y", self.sunk)
        angles = np.stack([motion.yaw, motion.pitch, motion.roll], axis=1)
        x, y, z = whole.apply(np.stack([motion.x, motion.y, motion.z], axis=1)).T
        yaw, pitch, roll = (whole * Rotation.from_euler("ZYX", angles)).as_euler("ZYX").T
        yaw += 2.0 * np.pi * np.round((motion.yaw - yaw) / (2.0 * np.pi))
        return replace(motion, x=x, y=y, z=z, yaw=yaw, pitch=pitch, roll=roll)

    def _steps(self, t: Floats, quantity: str) -> tuple[Floats, Floats, Floats]:
        """A leg's quantity with smooth steps between legs; its integral; its derivative."""
        value, integral, slope = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
        durations = [leg.duration for leg in self.legs]
        levels = [0.0, *(getattr(leg, quantity) for leg in self.legs), 0.0]
        times = np.concatenate([[0.0], np.cumsum(durations)])
        for k, time in enumerate(times):
            change = levels[k + 1] - levels[k]
            if change == 0.0:
                continue
            ramp = min([self.ramp, *durations[max(k - 1, 0) : k + 1]])
            p = np.clip((t - time) / ramp + 0.5, 0.0, 1.0)
            value += change * p**3 * (10.0 + p * (6.0 * p - 15.0))
            beyond = np.maximum(t - time - ramp / 2.0, 0.0)
            integral += change * (ramp * p**4 * (2.5 + p * (p - 3.0)) + beyond)
            slope += change * 30.0 * p**2 * (1.0 - p) ** 2 / ramp
        return value, integral, slope

    def _yaw(self, t: Floats) -> tuple[Floats, Floats]:
        """Yaw and yaw rate: the legs', the driver's corrections while driving, the tracks' unevenness while turning."""
        rate, yaw, slope = self._steps(t, "yaw_rate")
        speed, _, acceleration = self._steps(t, "speed")
        top_rate, top_speed = (
            max((abs(getattr(leg, k)) for leg in self.legs), default=0.0) for k in ("yaw_rate", "speed")
        )
        yaw, total = yaw + self.start[2], rate
        if self.wobble and top_speed:
            share, change = (speed / top_speed) ** 2, 2.0 * speed * acceleration / top_speed**2
            sway, sway_rate = _sway(t, ((0.13, 0.4, 0.70), (0.31, 2.1, 0.60), (0.72, 4.4, 0.35)))
            yaw = yaw + self.wobble * share * sway
            total = total + self.wobble * (share * sway_rate + change * sway)
        if self.unsteady and top_rate:
            share, change = (rate / top_rate) ** 2, 2.0 * rate * slope / top_rate**2
            sway, sway_rate = _sway(t, ((0.23, 1.3, 0.45), (0.57, 5.2, 0.18), (1.31, 3.0, 0.06)))
            yaw = yaw + self.unsteady * top_rate * share * sway
            total = total + self.unsteady * top_rate * (share * sway_rate + change * sway)
        return yaw, total

    @cached_property
    def _grid(self) -> Floats:
        return np.arange(0.0, self.duration + 2.0 / _GRID_HZ, 1.0 / _GRID_HZ)

    @cached_property
    def _path(self) -> tuple[Floats, Floats]:
        """Position on the grid, integrated by the trapezoidal rule (error below 1 um at 1 kHz)."""
        t = self._grid
        speed, (yaw, rate) = self._steps(t, "speed")[0], self._yaw(t)
        slide = self.wander * np.abs(rate) / (2.0 * np.pi)
        velocity = speed * np.cos(yaw) + slide, speed * np.sin(yaw) + 0.4 * slide
        path = []
        for origin, v in zip(self.start[:2], velocity, strict=True):
            steps = (v[1:] + v[:-1]) / (2.0 * _GRID_HZ)
            path.append(origin + np.concatenate([[0.0], np.cumsum(steps)]))
        return path[0], path[1]


def _sway(t: Floats, waves: Sequence[tuple[float, float, float]]) -> tuple[Floats, Floats]:
    """Sum of (frequency Hz, phase, amplitude) waves, and its rate."""
    value, rate = np.zeros_like(t), np.zeros_like(t)
    for frequency, phase, amplitude in waves:
        angle = 2.0 * np.pi * frequency * t + phase
        value += np.sqrt(2.0) * amplitude * np.sin(angle)
        rate += np.sqrt(2.0) * amplitude * 2.0 * np.pi * frequency * np.cos(angle)
    return value, rate
