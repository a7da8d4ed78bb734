"""What every method of comparing two strips takes and gives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from compass.images.strip import Strip
from compass.increment import CompassStatus


@dataclass(frozen=True, slots=True)
class Search:
    """Where to look.

    Attributes
    ----------
    expected_px : float
        Shift that is expected, columns.
    reach_px : float
        How far from it a shift can be, columns; half the circle or more means anywhere.
    forward_px : float
        Column that looks along +x.
    """

    expected_px: float
    reach_px: float
    forward_px: float


@dataclass(frozen=True, slots=True)
class Match:
    """How the current strip lies on the reference.

    Attributes
    ----------
    shift_px : float
        Turn to the left, columns, in [-columns / 2, columns / 2).
    variance_px2 : float
        Variance of `shift_px`, columns^2.
    confidence : float
        Normalised correlation, 0..1, of what was found of the reference.
    status : CompassStatus
        OK, or why the shift must not be used.
    spread_px : float
        How far the parts of the panorama moved apart, columns; infinite where a method does not know, which makes
        every image the next one's reference.
    tilt : tuple of float
        Rotation of the scene about x and y since the reference, rad; zero where a method does not know.
    badly_known : bool
        Whether a shift that must not be used is the right one all the same, as far as its variance goes: used where the
        turn would be lost else.
    """

    shift_px: float
    variance_px2: float
    confidence: float
    status: CompassStatus = CompassStatus.OK
    spread_px: float = math.inf
    tilt: tuple[float, float] = (0.0, 0.0)
    badly_known: bool = False

    @staticmethod
    def none(shift_px: float = 0.0, confidence: float = 0.0) -> Match:
        """No answer: the corners agree on no motion."""
        return Match(shift_px, math.inf, confidence, CompassStatus.LOW_CONFIDENCE)


Method = Callable[[Strip, Strip, Search], Match]
