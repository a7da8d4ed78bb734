"""A sensor that is excluded, and when it shows that it is well."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fusion.buffer.events import Sensor
from fusion.checks.contradiction import GROSS
from fusion.checks.recovery import Recovery
from fusion.checks.windows import Claim, Window
from fusion.record import replace

CHANGED = 0.1  # rad/s, change of the turn rate in a window; what shows without is no fault of time; not derived
UNLIKELY_BIAS = 0.2  # rad/s, 11 deg/s; a gyro that rests at more has another unit: 0.2 deg/s are common; not derived


def fits_anything(sensor: Sensor, turn_rate: float, window: Window) -> bool:
    """Whether a bias found at a turn rate (rad/s) may stand for a wrong scale, too, or for images that do not turn."""
    return sensor is Sensor.GYRO and not window.gyro_beyond and (abs(turn_rate) > GROSS or window.tracks is None)


def may_give_degrees(sensor: Sensor, off: float, window: Window) -> bool:
    """Whether a gyro that rests at so large a rate, rad in a window, may not have a bias but another unit.

    Tracks alone need it sooner than it shows that.
    """
    return sensor is Sensor.GYRO and window.compass is not None and abs(off) > UNLIKELY_BIAS * window.seconds


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A sensor that is not listened to.

    Attributes
    ----------
    sensor : Sensor
    since_ns : int
        Beginning of the first window in which it contradicted.
    least_turn, least_size, least_change : float
        Of all windows in which it contradicted the least turn rate, the least contradiction, and the least change of
        the turn rate, rad/s. Only windows with half of that turn rate, and half of that change where it errs in time,
        can show that it is well, and only against a reference that is known better than half of that contradiction.
    recovery : Recovery
        The size of its errors, and the evidence since that they are over.
    agreed : int
        In how many of such windows in a row it has agreed since.
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
    least_change: float
    recovery: Recovery
    agreed: int = 0
    fitted: float | None = None
    silent: bool = False

    def again(self, turn: float, size: float, window: Window) -> Exclusion:
        """After one more window with a contradiction by `size`, while the others turned by `turn`, rad."""
        turn_rate, size = turn / window.seconds, size / window.seconds
        turning, least_size = min(self.least_turn, abs(turn_rate)), min(self.least_size, abs(size))
        changing = min(self.least_change, abs(window.rate_change))
        fitted = turn_rate if self.fitted is not None or fits_anything(self.sensor, turn_rate, window) else None
        return replace(
            self,
            least_turn=turning,
            least_size=least_size,
            least_change=changing,
            recovery=self.recovery.erred(size),
            agreed=0,
            fitted=fitted,
        )

    @property
    def over(self) -> int:
        """In how many telling windows in a row it has agreed, where all that was seen since says that it is well."""
        return self.agreed if self.recovery.well else 0

    def weighed(self, claim: Claim, reference: Claim, window: Window) -> Exclusion:
        """After a window in which it does not contradict, and in which it would be seen to err, or not."""
        if not self._tells(reference, window):
            return self
        # at rest it would err as before, in half the turning by half as much
        share = 0.5 if self.least_turn > GROSS else 1.0
        off, variance = abs(claim.turn - reference.turn), claim.sigma**2 + reference.sigma**2
        # a gyro that says one number whatever turns errs by what the rate differs from that at which it was fitted
        most = math.inf if self.fitted is None else abs(reference.turn / window.seconds - self.fitted)
        recovery = self.recovery.weighed(off, variance, window.seconds, share, most)
        agreed = self.agreed + self._agrees(claim, reference, window) if recovery.odds > 0.0 else 0
        return replace(self, recovery=recovery, agreed=agreed)

    def _tells(self, reference: Claim, window: Window) -> bool:
        """Whether it would be seen to err in a window."""
        seconds = window.seconds
        if self.least_change > CHANGED and abs(window.rate_change) < 0.5 * self.least_change:
            return False
        if self.fitted is not None:
            return abs(reference.turn - self.fitted * seconds) >= 0.5 * self.least_size * seconds
        return abs(reference.turn) >= 0.5 * self.least_turn * seconds

    def _agrees(self, claim: Claim, reference: Claim, window: Window) -> bool:
        """Whether it is nearer to the reference, and both are known better, than the least contradiction there was."""
        off = max(abs(claim.turn - reference.turn), math.hypot(claim.sigma, reference.sigma))
        return off < 0.5 * self.least_size * window.seconds
