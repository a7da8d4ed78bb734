"""What the gyro has said of late, and the exposure of an image in it."""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import NamedTuple

from compass.tilt import Vector
from fusion.imu.tilt import NEAR_NS
from fusion.record import record

TRAIL_NS = 1_000_000_000  # of what the gyro said that is remembered
SHORTEST_STEP = 0.02  # s; over less the gyro's noise says more of its rate than the rate
# Not derived: `CAUTION`.
CAUTION = 100.0  # the gyro's noise, as a turn rate that changes, must not drive the delay however long it lasts


@record
class Exposure:
    """What happened between the exposure of an image and its stamp, as far as the delay is known.

    Attributes
    ----------
    delay : float
        From the exposure to the stamp, s; negative where the stamp is the earlier.
    turn : float
        By the robot meanwhile, rad.
    rate : float
        By how much that grows with the delay, rad/s: the turn rate around the exposure.
    variance : float
        Of `turn`, beyond what an error of the delay does to it in proportion, rad^2.
    watched : bool
        Whether `turn` is what a gyro says, and not the present rate's.
    rate_variance : float
        Of `rate`, (rad/s)^2.
    """

    delay: float = 0.0
    turn: float = 0.0
    rate: float = 0.0
    variance: float = 0.0
    watched: bool = False
    rate_variance: float = 0.0


class TrailPoint(NamedTuple):
    """A rate (rad/s) that a gyro claimed, the integral (rad) since the first of all, and the vertical then."""

    t_ns: int
    rate: float
    turn: float
    up: Vector | None


@record
class GyroTrail:
    """What a gyro claimed lately; between two samples the rate changes linearly, after the last it stays.

    A sample that the gate has `refused` waits for the next one: if that is nearer to it than to the last one that was
    not, the robot did turn so.
    """

    points: tuple[TrailPoint, ...] = ()
    refused: tuple[int, float, Vector | None] | None = None

    def add(self, t_ns: int, rate: float, up: Vector | None) -> GyroTrail:
        """With one more rate (rad/s), not older than the last, and the vertical then."""
        return GyroTrail(self._with_refused(rate)._and(t_ns, rate, up))

    def refusing(self, t_ns: int, rate: float, up: Vector | None) -> GyroTrail:
        """The same of one that the gate has refused."""
        return GyroTrail(self._with_refused(rate).points, (t_ns, rate, up))

    def _with_refused(self, rate: float) -> GyroTrail:
        if self.refused is None or not self.points:
            return self
        nearer = abs(rate - self.refused[1]) < abs(rate - self.points[-1].rate)
        return GyroTrail(self._and(*self.refused)) if nearer else self

    def _and(self, t_ns: int, rate: float, up: Vector | None) -> tuple[TrailPoint, ...]:
        turn = 0.0
        if self.points:
            last = self.points[-1]
            turn = last.turn + 0.5 * (last.rate + rate) * (t_ns - last.t_ns) * 1e-9
        return (*self.points[self._place(t_ns - TRAIL_NS) :], TrailPoint(t_ns, rate, turn, up))

    def _place(self, t_ns: int) -> int:
        """Where the first point is that is not before a time."""
        return bisect_left(self.points, (t_ns,))

    def up_at(self, t_ns: int) -> Vector | None:
        """The vertical in the robot's frame at a time, from the next sample; None where none was near."""
        i = min(self._place(t_ns), len(self.points) - 1)
        return self.points[i].up if i >= 0 and abs(self.points[i].t_ns - t_ns) <= NEAR_NS else None

    def turn_at(self, t_ns: int) -> float:
        """The integral at a time; the first rate is held before the first sample, the last after the last."""
        i = max(self._place(t_ns + 1) - 1, 0)
        point, slope = self.points[i], 0.0
        seconds = (t_ns - point.t_ns) * 1e-9
        if seconds > 0.0 and i + 1 < len(self.points):
            after = self.points[i + 1]
            slope = (after.rate - point.rate) / ((after.t_ns - point.t_ns) * 1e-9)
        return point.turn + (point.rate + 0.5 * slope * seconds) * seconds

    def exposure(self, t_ns: int, delay: float, variance: float, noise: float) -> Exposure:
        """What the gyro, whose samples' noise has the variance `noise`, says of an image stamped `t_ns`.

        The delay (s, its variance s^2) enters by a statistical linearisation over three points, as the turn rate may
        change a lot while it is uncertain (Norgaard, Poulsen & Ravn 2000, doi:10.1016/S0005-1098(00)00089-3).
        """
        step = max(math.sqrt(3.0 * variance), SHORTEST_STEP)
        now = self.turn_at(t_ns)
        less, turn, more = (now - self.turn_at(t_ns - round(1e9 * d)) for d in (delay - step, delay, delay + step))
        weight = 0.5 * variance / step**2
        rate, mean = 0.5 * (more - less) / step, turn + weight * (less - 2.0 * turn + more)
        spread = weight * ((less - mean) ** 2 + (more - mean) ** 2) + (1.0 - 2.0 * weight) * (turn - mean) ** 2
        bent = max(spread - rate**2 * variance, 0.0)
        first_ns, last_ns = (t_ns - round(1e9 * d) for d in (delay + step, delay - step))
        held = min(max(last_ns - self.points[-1].t_ns, 0) / (last_ns - first_ns), 1.0)  # by the last sample alone
        averaged = max(self._place(last_ns) - self._place(first_ns), 1)
        rate_variance = noise * (held**2 + (1.0 - held) ** 2 / averaged)
        return Exposure(delay, mean, rate, bent + CAUTION * noise * variance, watched=True, rate_variance=rate_variance)
