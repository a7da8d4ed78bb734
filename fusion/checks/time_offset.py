"""By how much the clock of one sensor is off: the lag at which its turns are those of the others.

A lag of several seconds shows in no single window of turns: there the sensors seem to contradict each other anyhow.
So the last `HISTORY` windows are correlated at every lag, whatever the factor and the constant between two sensors are.
A lag is believed only where the robot has turned to and fro enough that no other one explains as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from fusion.buffer.events import Sensor
from fusion.checks.windows import Window

# Not derived: `HISTORY`, `EVERY_WINDOWS`, `FEWEST_WINDOWS`, `RICH`, `LEFT`, `DISTINCT`.
HISTORY = 80  # windows of half a second that are remembered
EVERY_WINDOWS = 8  # windows; so often they are correlated
FEWEST_WINDOWS = 20  # windows that two sensors must have in common at a lag
RICH = 0.1  # rad/s, standard deviation of the turn rate; with less there is nothing to correlate
LAGS = np.arange(-60, 61) / 10.0  # s
SAME_LAG = 0.25  # s; lags no further apart are one, and shorter ones are what drivers take and the filter estimates
LEFT = 0.15  # of the variance of the turn rate, which the best lag leaves unexplained at most, and every other more
DISTINCT = 3.0  # times as much is left by every other lag, and by none

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Turned:
    """What each sensor turned by in a window, as it claims it, the gyro with its bias.

    Attributes
    ----------
    start_ns, t_ns : int
        The window's stamps.
    turns : tuple of (float or None)
        In the order of `Sensor`, rad.
    rests : bool
        Whether the tracks rested.
    """

    start_ns: int
    t_ns: int
    turns: tuple[float | None, ...]
    rests: bool = False

    @staticmethod
    def of(window: Window, bias: float) -> Turned:
        """Of a window out of whose claims a gyro bias was taken, rad/s."""
        turns = [claim.turn if claim else None for claim in window.claims]
        if turns[0] is not None:
            turns[0] += bias * window.seconds  # it may change from window to window while the gyro contradicts
        return Turned(window.start_ns, window.t_ns, tuple(turns), window.tracks is not None and window.tracks.rests)

    def rate_of(self, sensor: Sensor) -> float | None:
        """Mean turn rate that a sensor claims, rad/s."""
        turn = dict(zip(Sensor, self.turns, strict=True))[sensor]
        return None if turn is None else turn / ((self.t_ns - self.start_ns) * 1e-9)


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """A sensor whose turns come later than another's by `seconds`, or earlier; `sure`: a third one agrees with that.

    Attributes
    ----------
    sensor, other : Sensor
    seconds : float
    since_ns : int
        Stamp of the first turn that shows it.
    sure : bool
    """

    sensor: Sensor
    other: Sensor
    seconds: float
    since_ns: int
    sure: bool = False


def with_window(history: tuple[Turned, ...], turned: Turned) -> tuple[Turned, ...]:
    """The last windows with one more; those before a gap give no lag."""
    joined = bool(history) and history[-1].t_ns == turned.start_ns
    return (*history, turned)[-HISTORY:] if joined else (turned,)


def time_offset(history: tuple[Turned, ...]) -> TimeOffset | None:
    """Whose clock is off: of three sensors the one beside two that go together; of two it is not known whose."""
    since_ns = history[0].start_ns if history else 0
    lags = {pair: lag for pair in combinations(Sensor, 2) if (lag := _lag(history, *pair)) is not None}
    together = [set(pair) for pair, lag in lags.items() if abs(lag) < SAME_LAG]
    off = [(pair, lag) for pair, lag in lags.items() if abs(lag) >= SAME_LAG]
    for (sensor, other), lag in off:
        if any(other in pair and sensor not in pair for pair in together):
            return TimeOffset(sensor, other, lag, since_ns, sure=True)
        if any(sensor in pair and other not in pair for pair in together):
            return TimeOffset(other, sensor, -lag, since_ns, sure=True)
    return next((TimeOffset(*pair, lag, since_ns) for pair, lag in off), None)


def _lag(history: tuple[Turned, ...], sensor: Sensor, other: Sensor) -> float | None:
    """By how much later a sensor turns than another, s; None where that is unknown."""
    if len(history) < FEWEST_WINDOWS:
        return None
    ends = np.array([history[0].start_ns, *(one.t_ns for one in history)], np.int64)
    t = (ends - ends[0]) * 1e-9
    (turned, missing), (by_other, not_measured) = (_summed(history, list(Sensor).index(one)) for one in (sensor, other))
    seconds, shifted = np.diff(t), t - LAGS[:, None]
    inside = (shifted[:, :-1] >= 0.0) & (shifted[:, 1:] <= t[-1])
    known = inside & (np.diff(missing) == 0.0) & (np.diff(np.interp(shifted, t, not_measured)) == 0.0)
    rates, others = np.diff(turned) / seconds, np.diff(np.interp(shifted, t, by_other)) / seconds
    left = _unexplained(np.broadcast_to(rates, known.shape), others, known)
    best, none = int(np.argmin(left)), int(np.argmin(np.abs(LAGS)))
    apart = left[(np.abs(LAGS - LAGS[best]) > 4.0 * SAME_LAG)]
    if left[best] > LEFT or apart.min() < max(LEFT, DISTINCT * left[best]) or best in (0, LAGS.size - 1):
        return None
    return 0.0 if left[none] < DISTINCT * left[best] else float(LAGS[best])


def _summed(history: tuple[Turned, ...], sensor: int) -> tuple[Floats, Floats]:
    """By how much a sensor has turned at each end of a window, rad, and in how many windows it did not measure."""
    turns = [one.turns[sensor] for one in history]
    missing = np.array([turn is None for turn in turns], float)
    known = np.array([turn or 0.0 for turn in turns])
    return np.concatenate([[0.0], np.cumsum(known)]), np.concatenate([[0.0], np.cumsum(missing)])


def _unexplained(rates: Floats, others: Floats, known: npt.NDArray[np.bool_]) -> Floats:
    """Share of the variance of two rates, (lag, window), that no factor and constant explains; 1 where too poor."""
    count = known.sum(axis=1)
    weight = known / np.maximum(count, 1)[:, None]
    a = rates - (weight * rates).sum(axis=1, keepdims=True)
    b = others - (weight * others).sum(axis=1, keepdims=True)
    aa, bb, ab = ((weight * product).sum(axis=1) for product in (a * a, b * b, a * b))
    rich = (count >= FEWEST_WINDOWS) & (np.minimum(aa, bb) > RICH**2) & (ab > 0.0)
    return np.where(rich, 1.0 - ab**2 / np.where(rich, aa * bb, 1.0), 1.0)
