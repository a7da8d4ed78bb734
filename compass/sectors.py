"""The paper's future work: sectors find their own shift, their median is the turn."""

from __future__ import annotations

import numpy as np

from compass.local import coarse_shift, local_shifts
from compass.match import Match, Search
from compass.strip import Strip


def match_sectors(reference: Strip, current: Strip, search: Search) -> Match:
    """Coarse shift of all rows pooled, a sub-pixel shift in each overlapping sector, the median of these.

    A sector that sees something near is pushed aside when the robot drives; as long as fewer than half are pushed to
    one side, the median is not.
    """
    coarse = coarse_shift(reference, current, search)
    sectors = local_shifts(reference, current, coarse)
    good = np.isfinite(sectors.variance_px2)
    if not good.any():
        return Match(coarse.shift_px, np.inf, 0.0)
    shifts = sectors.shift_px[good]
    median = float(np.median(shifts))
    spread = 1.4826 * float(np.median(np.abs(shifts - median)))
    # the median of n normal numbers has pi / 2 times the variance of their mean; half-overlapping Hann windows are
    # about two thirds independent
    variance = 0.5 * np.pi * 1.5 * max(spread**2, float(np.median(sectors.variance_px2[good]))) / shifts.size
    return Match(median, variance, coarse.value)
