"""What a gyro turned while no images watched it: in doubt as soon as images contradict it."""

from __future__ import annotations

from fusion.buffer.events import Sensor
from fusion.checks.alternative import ALTERNATIVE_PROBABILITY
from fusion.checks.gyro_faults import TURNED
from fusion.checks.isolation import Isolation
from fusion.checks.silence import SILENT_NS
from fusion.checks.windows import Window
from fusion.record import record, replace


@record
class Unwatched:
    """Since gyro and images last agreed on a turn.

    Attributes
    ----------
    yaw : float
        When images were last heard, or it was set, rad.
    t_ns : int or None
        When that was; None before the first sample of all.
    turn, seconds : float
        What was turned until then while they were not, rad, and for how long.
    doubt : float
        By how much all that is wrong if the images are right, that contradict the gyro, rad^2.
    """

    yaw: float
    t_ns: int | None = None
    turn: float = 0.0
    seconds: float = 0.0
    doubt: float = 0.0

    @property
    def variance(self) -> float:
        """What it adds to that of the yaw, rad^2, while nobody knows who errs."""
        return ALTERNATIVE_PROBABILITY[Sensor.COMPASS] * self.doubt

    def heard(self, t_ns: int, yaw: float, before: float | None) -> Unwatched:
        """After an image; `before`: the yaw before it, rad, if none had been heard for a while."""
        if before is None:
            return replace(self, t_ns=t_ns, yaw=yaw)
        turn, seconds = self._until(t_ns, before)
        return replace(self, t_ns=t_ns, yaw=yaw, turn=turn, seconds=seconds)

    def _until(self, t_ns: int, yaw: float) -> tuple[float, float]:
        since_ns = t_ns if self.t_ns is None else self.t_ns
        return self.turn + yaw - self.yaw, self.seconds + max(t_ns - since_ns, 0) * 1e-9

    def judged(self, iso: Isolation, window: Window, yaw: float) -> tuple[Unwatched, float]:
        """After a window, at whose beginning the yaw was this, rad; and what the yaw is known less for good, rad^2."""
        watched = Unwatched(self.yaw, self.t_ns)
        if iso.gyro_shown_right:
            return watched, 0.0
        if not iso.contradicted:
            return (watched, self.variance) if self.doubt else (self, 0.0)
        known = self if self.doubt else self._contradicted(window, yaw)
        if iso.excludes(Sensor.GYRO) and iso.alternative(Sensor.GYRO) is None:
            return watched, known.doubt
        if iso.excludes(Sensor.COMPASS) and iso.alternative(Sensor.COMPASS) is None:
            return watched, 0.0
        return known, 0.0

    def _contradicted(self, window: Window, yaw: float) -> Unwatched:
        """With what the factor, or the bias, by which the gyro errs would make of all that it turned."""
        gyro, compass, turn, seconds = window.gyro, window.compass, self.turn, self.seconds
        if gyro is None or compass is None:
            return self
        if self.t_ns is None or window.start_ns - self.t_ns > SILENT_NS:  # none has been accepted yet
            turn, seconds = self._until(window.start_ns, yaw)
        off = gyro.turn - compass.turn
        by_factor = turn * off / gyro.turn if abs(gyro.turn) > TURNED and seconds else 0.0
        return replace(self, doubt=max(by_factor**2, (off / window.seconds * seconds) ** 2))
