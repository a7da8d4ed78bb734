"""How many full turns an accumulated yaw may miss: across a long gap an increment tells the turn modulo a full one."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fusion.checks.warnings import Warning

NOTICED = math.radians(10.0)  # a sigma that nobody who counts turns would overlook; a chance of 1 in 1,300


@dataclass(frozen=True, slots=True)
class TurnCount:
    """What is not known of the number of full turns.

    Attributes
    ----------
    variance : float
        Of full turns that the accumulated yaw may have too many or too few, rad^2.
    since_ns : int or None
        Stamp of the first increment that left one open; None where there was none.
    """

    variance: float = 0.0
    since_ns: int | None = None

    def after(self, t_ns: int, innovation: float, S: float) -> TurnCount:
        """After an increment of which the nearest turn was taken: `innovation`, rad, of the variance `S`, rad^2.

        To be asked where no sensor spoke for so long that the robot could turn round; else somebody has counted. Other
        turns have the likelihoods of their innovations, those within 3 sigma.
        """
        farthest = 3.0 * math.sqrt(S)
        most = math.floor((farthest + math.pi) / math.tau)
        turns = [math.tau * count for count in range(-most, most + 1) if count]
        turns = [turn for turn in turns if abs(innovation + turn) <= farthest]
        odds = [math.exp(0.5 * (innovation**2 - (innovation + turn) ** 2) / S) for turn in turns]
        variance = sum(one * turn**2 for one, turn in zip(odds, turns, strict=True)) / (1.0 + sum(odds))
        noticed = self.since_ns is None and variance > NOTICED**2
        return TurnCount(self.variance + variance, t_ns if noticed else self.since_ns)

    def warnings(self) -> list[Warning]:
        """That full turns may be missing, if so."""
        if self.since_ns is None:
            return []
        text = (
            "an image found the heading again after a gap in which nobody measured, but not how often the robot turned "
            "round: whole turns may be missing in the accumulated yaw, as its sigma says; the heading is right"
        )
        return [Warning("turn_lost", "recording", self.since_ns, text)]
