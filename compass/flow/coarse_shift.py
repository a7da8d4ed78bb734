"""How far the panorama has moved by and large: the highest peak of the correlation of all rows.

Off the grid as phase correlation is (Foroosh, Zerubia & Berthod 2002, doi:10.1109/83.988953).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from compass.flow.correlation import Floats, signed
from compass.images.strip import Spectrum
from compass.increment import CompassStatus
from compass.methods.match import Search

# In seven drives, held out and tuned, no peak beyond reach is higher than the one within, and rivals, where reach is so
# wide, are at most 0.39 as high; a place that repeats itself has one within its noise of 1.
OUTSIDE = 0.5  # of the highest peak anywhere is enough for one within reach
RIVAL_HEIGHT = 0.97  # of the highest peak makes another as likely
# Nearer than this part of the circle it is the shoulder of the same peak: the correlation of 24 places, photographed,
# filmed and simulated, with themselves is below `RIVAL_HEIGHT` from 0.005 of the circle on, below `OUTSIDE` from 0.094.
PEAKS_PER_CIRCLE = 10


@dataclass(frozen=True, slots=True)
class CoarseShift:
    """Where all rows together match best.

    Attributes
    ----------
    shift_px : int
        Whole columns in [-columns / 2, columns / 2).
    correlation : float
        Normalised correlation there, -1..1.
    status : CompassStatus
        AMBIGUOUS where another peak within reach is as high, else OK.
    """

    shift_px: int
    correlation: float
    status: CompassStatus


def quantile(values: Floats, share: float) -> float:
    """The value at this share of the sorted ones; `np.quantile` takes fifty times as long for so few."""
    return float(np.sort(values)[int(share * (values.size - 1) + 0.5)])


def coarse_shift(spectrum: Spectrum, columns: int, search: Search, rival_height: float = RIVAL_HEIGHT) -> CoarseShift:
    """Shift of all rows pooled: the highest peak within reach, unless only one outside it matches.

    Parameters
    ----------
    spectrum : (columns // 2 + 1,) array
        Of the strips' correlation, as `pooled_spectrum` or `upright_spectrum` gives it.
    rival_height : float
        Of the highest peak, above which another one within reach makes it ambiguous.
    """
    values = scipy.fft.irfft(spectrum, columns)
    best = anywhere = int(values.argmax())
    off = abs(float(signed(best - search.expected_px, columns)))
    reach = search.reach_px + 1.0
    if off > reach:
        possible = np.abs(signed(np.arange(columns) - search.expected_px, columns)) <= reach
        best = int(np.where(possible, values, -np.inf).argmax())
        shoulder = max(values[best - 1], values[(best + 1) % columns]) > values[best]  # of a peak beyond reach
        off = abs(float(signed(best - search.expected_px, columns)))
        if shoulder or values[best] < OUTSIDE * values[anywhere]:
            best, off, reach = anywhere, 0.0, float(columns)
    ambiguous = False
    if off + reach > columns / PEAKS_PER_CIRCLE:  # another peak may be as far off
        lags = np.arange(columns)
        rivals = np.abs(signed(lags - search.expected_px, columns)) <= reach
        rivals &= np.abs(signed(lags - best, columns)) > columns / PEAKS_PER_CIRCLE
        ambiguous = bool(rivals.any()) and float(values[rivals].max()) > rival_height * float(values[best])
    status = CompassStatus.AMBIGUOUS if ambiguous else CompassStatus.OK
    return CoarseShift(int(signed(best, columns)), float(values[best]), status)
