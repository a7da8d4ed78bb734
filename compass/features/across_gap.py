"""Whether a match across a gap, in which the camera may have turned anyhow, is the only one there can be."""

from __future__ import annotations

import math

from compass.agreement import DISAGREE
from compass.features.landmarks import shows_landmarks
from compass.features.matching import match_landmarks
from compass.features.prior import GAP
from compass.flow.coarse_shift import OUTSIDE, PEAKS_PER_CIRCLE, coarse_shift
from compass.flow.correlation import pooled_spectrum, signed
from compass.images.strip import Strip
from compass.increment import CompassStatus
from compass.methods.match import Match, Search


def is_confirmed(match: Match, reference: Strip, current: Strip, search: Search) -> bool:
    """Whether the corners of both views say the same, or all their rows where the view is too small or has a gap.

    Corners say nothing where the place repeats itself (`match_landmarks`), rows where they correlate half as much
    somewhere else.
    """
    if shows_landmarks(reference) and (reference.seen is None or reference.seen.widest_hidden <= GAP):
        again = match_landmarks(reference, current, search)
        status, shift = again.status, again.shift_px
        reach = DISAGREE * math.sqrt(match.variance_px2 + again.variance_px2)
    else:
        coarse = coarse_shift(pooled_spectrum(reference, current), reference.columns, search, OUTSIDE)
        status, shift = coarse.status, float(coarse.shift_px)
        reach = reference.columns / PEAKS_PER_CIRCLE
    apart = abs(float(signed(match.shift_px - shift, reference.columns)))
    return status is CompassStatus.OK and apart <= reach
