"""The integral of a turn rate over a window, with spikes left out."""

from __future__ import annotations

import math

from compass import wrap_angle
from fusion.record import record

# Not derived: `LONGEST_GAP`.
LONGEST_GAP = 0.4  # of a window, in which an integrated sensor may have been silent and still be a witness
FASTEST_ROBOT = 4.0 * math.pi  # rad/s; two turns a second, faster than tracked robots spin
FASTEST_CHANGE = FASTEST_ROBOT / 0.25  # rad/s^2: at its fastest in a quarter of a second; not derived
COMES_BACK = 0.5  # of a spike is enough to be back, as the robot may turn meanwhile; not derived
SAME = 1e-6  # rad/s; less than any gyro's least step, more than one number varies when it is levelled


@record
class RateTurn:
    """Integral (rad) of a turn rate since `start_ns`, as the sensor gives it.

    Spikes are left out: samples that no robot can have turned to since the last `steady` one, nor back from them.

    Attributes
    ----------
    start_ns, t_ns : int
        Of the integral and of the newest sample, ns.
    start_rate, rate : float
        At these, rad/s.
    turn : float
        By the trapezoidal rule up to `t_ns`, rad.
    distance : float
        Driven meanwhile as the odometry claims, m.
    unseen : float
        Variance of the turn, rad^2, as nobody saw when the rate changed between two samples: at once, but at any time.
    gap_ns : int
        Longest time between two samples.
    count, repeats, beyond : int
        How many samples; how many at the end were the same number; how many were beyond `FASTEST_ROBOT`.
    steady_ns, steady_rate, steady_turn : int, float, float
        Stamp, rate and integral at the last sample that was no spike.
    spike : float
        By how much the rate has gone off since, at most, rad/s.
    yaw : float or None
        Of the newest sample, rad, where its poses are followed: a driver's rates may lag.
    """

    start_ns: int
    t_ns: int
    start_rate: float
    rate: float
    turn: float = 0.0
    distance: float = 0.0
    unseen: float = 0.0
    gap_ns: int = 0
    count: int = 0
    repeats: int = 0
    beyond: int = 0
    steady_ns: int = 0
    steady_rate: float = 0.0
    steady_turn: float = 0.0
    spike: float = 0.0
    yaw: float | None = None

    @staticmethod
    def begun(t_ns: int, rate: float, yaw: float | None = None, repeats: int = 0) -> RateTurn:
        """From `t_ns` on, with the rate that is held since."""
        return RateTurn(t_ns, t_ns, rate, rate, repeats=repeats, steady_ns=t_ns, steady_rate=rate, yaw=yaw)

    def add(self, t_ns: int, rate: float, speed: float = 0.0, yaw: float | None = None) -> RateTurn:
        """With one more sample (rad/s, m/s, rad)."""
        dt_ns = t_ns - self.t_ns
        seconds = dt_ns * 1e-9
        if yaw is not None and self.yaw is not None and dt_ns > 0:
            step = float(wrap_angle(yaw - self.yaw))
            rate, turn = step / seconds, self.turn + step
        else:
            turn = self.turn + 0.5 * (self.rate + rate) * seconds
        spike, off, within = self.spike, abs(rate - self.steady_rate), (t_ns - self.steady_ns) * 1e-9
        if off > FASTEST_CHANGE * within:
            steady, spike = (self.steady_ns, self.steady_rate, self.steady_turn), max(spike, off)
        else:
            if off < COMES_BACK * spike:
                turn = self.steady_turn + 0.5 * (self.steady_rate + rate) * within
            steady, spike = (t_ns, rate, turn), 0.0
        return RateTurn(
            self.start_ns,
            t_ns,
            self.start_rate,
            rate,
            turn,
            self.distance + abs(speed) * seconds,
            self.unseen + ((rate - self.rate) * seconds) ** 2 / 12.0,
            max(self.gap_ns, dt_ns),
            self.count + 1,
            self.repeats + 1 if abs(rate - self.rate) <= SAME else 0,
            self.beyond + (abs(rate) > FASTEST_ROBOT),
            *steady,
            spike,
            yaw,
        )

    def anew(self, t_ns: int) -> RateTurn:
        """From `t_ns` on; the last rate is held until then."""
        rate = self.steady_rate if self.spike else self.rate
        yaw = None if self.yaw is None else self.yaw + rate * (t_ns - self.t_ns) * 1e-9
        return RateTurn.begun(t_ns, rate, yaw, self.repeats)

    def turn_until(self, t_ns: int) -> float:
        """Turn up to a time after the newest sample, whose rate is held."""
        return self.turn + self.rate * (t_ns - self.t_ns) * 1e-9

    def spans(self, start_ns: int, t_ns: int) -> bool:
        """Whether there were samples all the way from the beginning of a window to its end."""
        longest_ns = LONGEST_GAP * (t_ns - start_ns)
        return self.start_ns <= start_ns and self.count > 0 and max(self.gap_ns, t_ns - self.t_ns) <= longest_ns
