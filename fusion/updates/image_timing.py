"""When an image was exposed: not quite at its stamp, and what the gyro says of the turn in between."""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import TYPE_CHECKING, NamedTuple

from compass.tilt import Vector
from fusion.buffer.events import Sensor
from fusion.imu.tilt import NEAR_NS
from fusion.record import record
from fusion.samples import GyroSample
from fusion.state.ekf import IDENTITY, State, YawEkf

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState

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
    """

    delay: float = 0.0
    turn: float = 0.0
    rate: float = 0.0
    variance: float = 0.0
    watched: bool = False


class TrailPoint(NamedTuple):
    """A rate (rad/s) that a gyro claimed, the integral (rad) since the first of all, and the vertical then."""

    t_ns: int
    rate: float
    turn: float
    up: Vector | None


@record
class GyroTrail:
    """What a gyro claimed lately; between two samples the rate changes linearly, after the last it stays."""

    points: tuple[TrailPoint, ...] = ()

    def add(self, sample: GyroSample) -> GyroTrail:
        """With one more sample, not older than the last."""
        t_ns, rate, turn = sample.t_ns, sample.yaw_rate, 0.0
        if self.points:
            last = self.points[-1]
            turn = last.turn + 0.5 * (last.rate + rate) * (t_ns - last.t_ns) * 1e-9
        return GyroTrail((*self.points[self._place(t_ns - TRAIL_NS) :], TrailPoint(t_ns, rate, turn, sample.up)))

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
        return Exposure(delay, mean, rate, bent + CAUTION * noise * variance, watched=True)


def exposure_of(state: FilterState) -> Exposure:
    """What happened between the exposure of an image stamped at present, and now."""
    if state.stillness.standing:
        return Exposure()
    return exposure(
        state.ekf, state.t_ns or 0, state.trail if state.trail.points and state.hears(Sensor.GYRO) else None
    )


def exposure(ekf: YawEkf, t_ns: int, trail: GyroTrail | None) -> Exposure:
    """What happened between the exposure of an image stamped `t_ns`, the present, and that stamp.

    Without a gyro's `trail` the delay is taken for known: it is not observable, and as an unknown it would let the
    tracks draw the yaw about.
    """
    delay, variance = float(ekf.x[State.CAMERA_DELAY]), float(ekf.P[State.CAMERA_DELAY, State.CAMERA_DELAY])
    if trail is None:
        return Exposure(delay, float(ekf.x[State.RATE]) * delay)
    claimed = trail.exposure(t_ns, delay, variance, ekf.config.gyro_sigma**2)
    bias, gain = float(ekf.x[State.BIAS]), 1.0 + float(ekf.x[State.GYRO_SCALE])
    turn, rate = (claimed.turn - bias * delay) / gain, (claimed.rate - bias) / gain
    unseen = ekf.config.watched_rate_walk**2 * max(-delay, 0.0) ** 3 / 3.0  # exposed after the last sample
    return Exposure(delay, turn, rate, claimed.variance + unseen, watched=True)


def clone_exposure(ekf: YawEkf, into: int, exposure: Exposure) -> None:
    """Copy the yaw that an image of the present stamp shows: that of its exposure, with its timestamp jitter."""
    T = IDENTITY.copy()
    T[into] = T[State.YAW]
    T[into, State.CAMERA_DELAY] = -exposure.rate
    if exposure.watched:
        gain = 1.0 + float(ekf.x[State.GYRO_SCALE])
        T[into, State.BIAS], T[into, State.GYRO_SCALE] = exposure.delay / gain, exposure.turn / gain
    else:
        T[into, State.RATE] = -exposure.delay
    exposed = float(ekf.x[State.YAW]) - exposure.turn
    rate_squared = float(ekf.x[State.RATE]) ** 2 + float(ekf.P[State.RATE, State.RATE])
    ekf.transform(T)
    ekf.x[into] = exposed
    ekf.widen(into, ekf.jitter * rate_squared + exposure.variance)
