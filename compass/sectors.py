"""The paper's future work: sectors find their own shift, their median is the turn."""

from __future__ import annotations

import numpy as np

from compass.correlation import pooled_spectrum, signed
from compass.local import coarse_shift, local_shifts
from compass.match import Match, Search
from compass.strip import Strip

SECTORS = 32  # Hann windows an eighth of the circle wide, a quarter of that apart
PER_CIRCLE = 8.0


def match_sectors(reference: Strip, current: Strip, search: Search) -> Match:
    """Coarse shift of all rows pooled, a sub-pixel shift in each overlapping sector, the median of these.

    A sector that sees something near is pushed aside when the robot drives; as long as fewer than half are pushed to
    one side, the median is not.
    """
    coarse = coarse_shift(pooled_spectrum(reference, current), reference.columns, search)
    sectors = local_shifts(reference, current, coarse.shift_px, SECTORS, PER_CIRCLE)
    if not sectors.shift_px.size:
        return Match(float(coarse.shift_px), np.inf, 0.0)
    median = float(np.median(sectors.shift_px))
    spread = 1.4826 * float(np.median(np.abs(sectors.shift_px - median)))
    # a median has pi / 2 times the variance of a mean; every fourth sector is independent
    independent = max(sectors.shift_px.size * PER_CIRCLE / SECTORS, 1.0)
    variance = 0.5 * np.pi * max(spread**2, float(np.median(sectors.sigma_px**2))) / independent
    confidence = float(np.clip(coarse.correlation, 0.0, 1.0))
    return Match(float(signed(median, reference.columns)), variance, confidence, coarse.status)
