"""The paper's method: every row finds its own shift, their average weighted by correlation is the turn.

"Visual compass for the NIFTi robot", semester project of the course A3M33IRO, 2013,
cw.felk.cvut.cz/doku.php/misc/projects/nifti/sw/start/visual_compass.
"""

from __future__ import annotations

import numpy as np

from compass.flow.correlation import correlate_rows, signed
from compass.images.strip import Strip
from compass.methods.match import Match, Search


def match_rows(reference: Strip, current: Strip, search: Search) -> Match:
    """Compare two strips as the paper does (section 2, eq. 1 to 3).

    Each row is correlated circularly with the same row of the reference; the shift of its largest normalised
    coefficient counts with that coefficient as its weight. `search` is not used: the paper knows no bound.
    """
    coefficients = correlate_rows(reference, current)
    best = coefficients.argmax(axis=1)
    weights = np.clip(coefficients[np.arange(best.size), best], 0.0, 1.0).astype(np.float64)
    total = float(weights.sum())
    if total <= 0.0:
        return Match(0.0, np.inf, 0.0)
    # shifts are averaged on the circle's branch around the best row: at half a turn -180 and 180 are neighbours
    origin = float(best[weights.argmax()])
    shifts = signed(best - origin, reference.columns)
    mean = float(weights @ shifts) / total
    spread = float(weights @ (shifts - mean) ** 2) / total
    effective_rows = total**2 / float(weights @ weights)
    variance = spread / effective_rows + 1.0 / 12.0  # rows of one image share the error of whole columns
    return Match(float(signed(origin + mean, reference.columns)), variance, float(weights @ weights) / total)
