"""Increments that the gate refuses: until it is known who was wrong, the yaw may be wrong by as much."""

from __future__ import annotations

from dataclasses import dataclass

from compass import YawIncrement
from fusion.buffer.events import Sensor
from fusion.checks.alternative import ALTERNATIVE_PROBABILITY

# Not derived: `GREW`, `REPEATED`.
GREW = 1.5  # times the first innovation; one that has grown so is no single wrong match, but rates differ

REPEATED = 0.2  # of the first innovation; a second one that differs by less repeats it, as the robot turns meanwhile


@dataclass(frozen=True, slots=True)
class Refusal:
    """A row of refused increments.

    Attributes
    ----------
    t_ref_ns : int
        Reference of the first.
    first, last : float
        Innovations of the first and of the last with the same reference, rad.
    """

    t_ref_ns: int
    first: float
    last: float

    @staticmethod
    def of(increment: YawIncrement, innovation: float, before: Refusal | None) -> Refusal:
        """With one more refused increment (its innovation, rad)."""
        if before is None:
            return Refusal(increment.t_ref_ns, innovation, innovation)
        return Refusal(before.t_ref_ns, before.first, max(before.last, innovation, key=abs))

    def grew(self, innovation: float) -> bool:
        """Whether the last innovation, rad, is beyond what one wrong match at the beginning would explain."""
        return abs(innovation) > GREW * abs(self.first) and innovation * self.first > 0.0

    def is_repeated_by(self, increment: YawIncrement, innovation: float) -> bool:
        """Whether a refused increment from the same reference says the same again."""
        return increment.t_ref_ns == self.t_ref_ns and abs(innovation - self.first) < REPEATED * abs(self.first)

    @property
    def variance(self) -> float:
        """By how much the yaw may be wrong, rad^2."""
        return ALTERNATIVE_PROBABILITY[Sensor.COMPASS] * self.last**2
