"""Density of a residual along its epipolar line: noise, plus a parallax that is never negative.

A point's inverse distance times the camera's step is exponentially distributed with one of a few means, whose shares
are found from the image itself; or the point is too far away to move at all. Noise plus an exponential variable has the
exponentially modified normal distribution (Grushka 1972, doi:10.1021/ac60319a011).
"""

from __future__ import annotations

import math
import sys

import numpy as np
from scipy.special import erfcx

from compass.features.points import Floats


def exponentially_modified(scaled: Floats, ratio: Floats) -> tuple[Floats, Floats, Floats]:
    """Density of the sum of a standard normal and an exponential variable.

    Parameters
    ----------
    scaled : array
        Where, in deviations of the normal part.
    ratio : array
        Deviation of the normal part, of the exponential's mean; broadcast against `scaled`.

    Returns
    -------
    density : array
        Times ``sqrt(2 pi)``, as the normal's is ``exp(-scaled ** 2 / 2)``.
    slope, bend : arrays
        Derivative of the density's logarithm, and that derivative's negative derivative, never negative.
    """
    z = scaled - ratio
    # further up the normal part is not felt, and its factors leave the range of floats: each has half of that
    near = np.maximum(-math.sqrt(0.5) * z, -math.sqrt(0.5 * math.log(sys.float_info.max)))
    hazard = math.sqrt(2.0 / math.pi) / erfcx(near)
    density = np.exp(ratio * (0.5 * ratio - scaled) - near * near) * ratio / hazard
    return density, hazard - ratio, hazard * (z + hazard)
