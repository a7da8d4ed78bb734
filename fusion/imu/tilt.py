"""A tilted robot: what its camera and tracks measure are turns about its own axis, not changes of its heading.

On a floor that has sunk by 20 deg the two differ by up to 1.8 deg within a quarter turn, and by 6 % in rate.
The tilt is given by the vertical in the robot's frame (x forward, y left, z up): ``(0, 0, 1)`` on level ground.
"""

from __future__ import annotations

import math
from collections import deque

from compass.config import CompassConfig
from compass.tilt import STEEPEST_COSINE, Tilted, Vector, about_z
from fusion.record import record
from fusion.samples import GyroSample

TILT_ERROR = CompassConfig.tilt_sigma  # rad, of roll and pitch as IMUs measure them; the parameter's default
LOG_LENGTH = 2000  # samples that are remembered, of a fast gyro those of two seconds
NEAR_NS = 100_000_000  # for so long about a sample the robot's tilt is taken for that of the sample
SETTLED_NS = 10_000_000  # before an image: what is younger may or may not have come, and must not decide
NOTICED = 0.005  # of a bias; a hundredth of what a gyro has is nothing
STEEPEST_SQUARED = STEEPEST_COSINE**2  # and the cosine of a robot on its side; beyond, a heading is none


def heading_change(up: Vector, turn: float, tilt: tuple[float, float] = (0.0, 0.0)) -> float:
    """Change of heading of a tilted robot that has tilted further, then turned; rad, within half a turn of `turn`.

    Parameters
    ----------
    up : (3,) tuple of float
        The vertical in the robot's frame after that, a unit vector: the newest is what is known best of the mount.
    turn : float
        About the robot's own z axis, rad.
    tilt : (2,) tuple of float
        Of the scene about the robot's x and y axes before the turn, rad.
    """
    heading = Tilted.upright(up).before(turn, tilt)[1]
    return heading + math.tau * round((turn - heading) / math.tau)


def tilt_angle(up: Vector) -> float:
    """How far from upright, rad."""
    return math.atan2(math.hypot(up[0], up[1]), up[2])


def heading_gain(up: Vector) -> float:
    """Rate of the heading over that of a turn about the robot's own axis."""
    level = 1.0 - up[0] ** 2
    return up[2] / level if level >= STEEPEST_SQUARED else 1.0


@record
class BiasGain:
    """How much of a gyro's biases about the robot's own axis and its y axis is a bias of the rate of its heading."""

    own: float = 1.0
    cross: float = 0.0

    @staticmethod
    def tilted(up: Vector) -> BiasGain:
        """Of a robot in whose frame `up` is the vertical, see `heading_gain`."""
        level = 1.0 - up[0] ** 2
        return BiasGain(up[2] / level, up[1] / level) if min(level, up[2]) >= STEEPEST_SQUARED else BiasGain()

    def differs(self, other: BiasGain) -> bool:
        """Whether the tilt is another by more than matters."""
        return abs(self.own - other.own) + abs(self.cross - other.cross) > NOTICED


@record
class TiltedTurn:
    """What the yaw owes to a vertical that may err: the integral of the tilt over the turn.

    On a slope a vertical that is off by an angle changes the rate of the heading by that angle times the sine of the
    tilt, times the rate; gyro, tracks and compass all go by the same vertical, so that none contradicts. Bumps cancel,
    and so does a full turn.

    Attributes
    ----------
    x, y : float
        Integrals of the vertical's components in the robot's frame over the turn, rad.
    """

    x: float = 0.0
    y: float = 0.0

    def after(self, up: Vector | None, turn: float) -> TiltedTurn:
        """After a turn, rad, while `up` was the vertical in the robot's frame; None: not known, taken for level."""
        return self if up is None else TiltedTurn(self.x + up[0] * turn, self.y + up[1] * turn)

    @property
    def variance(self) -> float:
        """Of the yaw, rad^2."""
        return TILT_ERROR**2 * (self.x**2 + self.y**2)


def up_later(up: Vector, rate: float, seconds: float) -> Vector:
    """The vertical in the frame of a robot that goes on turning about its own axis, by `rate` rad/s."""
    return about_z(up, -rate * seconds)


class TiltLog:
    """The robot's tilt of late, written by one thread and read by another."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Vector, float]] = deque(maxlen=LOG_LENGTH)

    def add(self, sample: GyroSample) -> None:
        """Take in what a sample says of the vertical, if it says anything."""
        if sample.up is not None and all(map(math.isfinite, (*sample.up, sample.yaw_rate))):
            self._samples.append((sample.t_ns, sample.up, sample.yaw_rate))

    def at(self, t_ns: int) -> Vector | None:
        """The vertical at a stamp, ns, by the last sample `SETTLED_NS` or more before it; None where none was near."""
        latest_ns = t_ns - SETTLED_NS
        before = (sample for sample in list(self._samples) if latest_ns - NEAR_NS <= sample[0] <= latest_ns)
        found = max(before, default=None)
        return found and up_later(found[1], found[2], (t_ns - found[0]) * 1e-9)

    def clear(self) -> None:
        """Forget all."""
        self._samples.clear()
