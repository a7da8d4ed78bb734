"""Turns that no image measured: how long, how large they may have been, and what that does to the accumulated yaw."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LostTurn:
    """A time in which the camera may have turned unseen.

    Attributes
    ----------
    t_from_ns, t_to_ns : int
        Stamps of the last image whose yaw is known and of the new keyframe, ns; the latter is the lower one where the
        clock jumped back.
    bound : float
        Largest turn to either side, rad.
    """

    t_from_ns: int
    t_to_ns: int
    bound: float

    @property
    def variance(self) -> float:
        """Variance of that turn, rad^2.

        Uniform within the bound. It is not limited to that of a uniform circle, (pi rad)^2 / 3: the heading is no
        less known than "anywhere", but the accumulated yaw counts full turns, and misses those that nobody counted.
        """
        return self.bound**2 / 3.0


class LostTurns:
    """Keeps the stamps up to which the yaw is known, and what was lost between them and new keyframes.

    Attributes
    ----------
    all : list of LostTurn
        In the order of occurrence; those that follow each other without an image between are one.
    """

    def __init__(self) -> None:
        self.all: list[LostTurn] = []
        # Two: where the last one was stamped far ahead by mistake, the one before it dates the gap.
        self._known_ns: deque[int] = deque(maxlen=2)

    def known(self, t_ns: int) -> None:
        """Take note of an image whose yaw is known."""
        self._known_ns.append(t_ns)

    def lose(self, t_ns: int, max_yaw_rate: float, waited_ns: int = 0) -> float:
        """Take note of a new keyframe that was not compared with any image before.

        Parameters
        ----------
        t_ns : int
            Its stamp.
        max_yaw_rate : float
            Fastest turn to expect, rad/s.
        waited_ns : int
            How long images with earlier stamps came before they were believed, ns.

        Returns
        -------
        float
            Variance of the turn since the last image whose yaw is known, rad^2; 0 for the very first image.
        """
        before = [known for known in self._known_ns if known <= t_ns]
        last = self._known_ns[-1] if self._known_ns else None
        self.known(t_ns)
        if last is None:
            return 0.0
        if before:
            lost = LostTurn(max(before), t_ns, max_yaw_rate * (t_ns - max(before)) * 1e-9)
        else:  # the clock jumped back, and nobody knows how long the camera was away: it may look anywhere
            lost = LostTurn(last, t_ns, max(math.pi, max_yaw_rate * waited_ns * 1e-9))
        added = lost.variance
        if self.all and self.all[-1].t_to_ns == lost.t_from_ns:
            joined = LostTurn(self.all[-1].t_from_ns, t_ns, self.all[-1].bound + lost.bound)
            # one unknown turn over both times, not two independent ones
            added = joined.variance - self.all[-1].variance
            lost = joined
            self.all.pop()
        self.all.append(lost)
        return added
