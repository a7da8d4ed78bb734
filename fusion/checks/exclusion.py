"""A sensor that is excluded, and when it shows that it is well."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fusion.buffer.events import Sensor
from fusion.checks.contradiction import GROSS
from fusion.checks.windows import Claim, Window

CHANGED = 0.1  # rad/s in a window; who errs at less errs at a steady rate, too; not derived


def fits_anything(sensor: Sensor, turn_rate: float, window: Window) -> bool:
    """Whether a bias found at a turn rate (rad/s) may stand for a wrong scale, too, or for images that do not turn."""
    return sensor is Sensor.GYRO and not window.gyro_beyond and (abs(turn_rate) > GROSS or window.tracks is None)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A sensor that is not listened to.

    Attributes
    ----------
    sensor : Sensor
    since_ns : int
        Beginning of the first window in which it contradicted.
    least_turn, least_size, least_change : float
        Least turn rate in which it contradicted, by how much it did at least, and by how much the turn rate at least
        changed meanwhile, rad/s: only in as much turning, and against one who knows better than that, it can show that
        it is well; one that is late, only where the rate changes.
    windows : int
        In how many it has contradicted.
    agreed : int
        In how many telling ones in a row it has agreed since.
    fitted : float or None
        Turn rate, rad/s, at which a gyro was given the bias with which it would agree. At that rate it agrees whatever
        is wrong with it; at another one only if that is its bias. None while it has erred at rest only: that is bias.
    silent : bool
        Whether it is excluded because it never said anything but zero.
    """

    sensor: Sensor
    since_ns: int
    least_turn: float
    least_size: float
    least_change: float = 0.0
    windows: int = 1
    agreed: int = 0
    fitted: float | None = None
    silent: bool = False

    def again(self, turn: float, size: float, window: Window) -> Exclusion:
        """After one more window with a contradiction by `size`, while the others turned by `turn`, rad."""
        turn_rate, size = turn / window.seconds, size / window.seconds
        turning, least_size = min(self.least_turn, abs(turn_rate)), min(self.least_size, abs(size))
        changing = min(self.least_change, abs(window.rate_change))
        fitted = turn_rate if self.fitted is not None or fits_anything(self.sensor, turn_rate, window) else None
        least = turning, least_size, changing
        return Exclusion(*(self.sensor, self.since_ns, *least, self.windows + 1), fitted=fitted, silent=self.silent)

    def shows_well(self, claim: Claim, reference: Claim, window: Window) -> bool:
        """Whether it agrees with a reference in a window in which it would have been seen to err."""
        seconds = window.seconds
        if self.least_change > CHANGED and abs(window.rate_change) < 0.5 * self.least_change:
            return False
        telling = 0.5 * self.least_size * seconds  # nearer to none than to the least contradiction there was
        sharp = max(abs(claim.turn - reference.turn), math.hypot(claim.sigma, reference.sigma)) < telling
        if self.fitted is not None:
            return sharp and abs(reference.turn - self.fitted * seconds) >= telling
        return sharp and abs(reference.turn) >= 0.5 * self.least_turn * seconds
