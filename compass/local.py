"""Shifts of sectors: how each part of the panorama moved, to a fraction of a column."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from compass.correlation import Peak, continuous_peak, pooled_spectrum, signed
from compass.match import Search
from compass.strip import Strip

SECTORS = 32  # Hann windows, a quarter of their width apart: each is an eighth of the circle wide
REACH_PX = 16  # how far a sector can lie from the coarse shift, columns


@dataclass(frozen=True, slots=True)
class SectorShifts:
    """What each sector says.

    Attributes
    ----------
    centre_px : (sectors,) array
        Column of the reference in the middle of each sector.
    shift_px : (sectors,) array
        Shift to the right, columns.
    variance_px2 : (sectors,) array
        Its variance from the image noise; infinite where the sector has no texture or no clear maximum.
    """

    centre_px: npt.NDArray[np.float64]
    shift_px: npt.NDArray[np.float64]
    variance_px2: npt.NDArray[np.float64]


def coarse_shift(reference: Strip, current: Strip, search: Search) -> Peak:
    """Shift of all rows pooled: the highest peak within reach, unless only one outside it matches."""
    spectrum = pooled_spectrum(reference, current)
    columns = reference.columns
    values = scipy.fft.irfft(spectrum, columns)
    lags = np.arange(columns)
    inside = np.abs(signed(lags - search.expected_px, columns)) <= search.reach_px + 1.0
    best = int(np.where(inside, values, -np.inf).argmax())
    anywhere = int(values.argmax())
    if values[best] < 0.5 * values[anywhere]:
        best = anywhere
    peak = continuous_peak(spectrum, columns, float(best))
    return Peak(float(signed(peak.shift_px, columns)), peak.value, peak.curvature)


def local_shifts(reference: Strip, current: Strip, coarse: Peak) -> SectorShifts:
    """Local sub-pixel shifts around a coarse one."""
    columns = reference.columns
    windows = sector_windows(columns)
    whole = round(coarse.shift_px)
    a = reference.pixels
    reach = min(REACH_PX, columns // 8)
    extended = np.take(current.pixels, np.arange(-reach, columns + reach) + whole, axis=1, mode="wrap")
    products = np.stack([np.einsum("rx,rx->x", a, extended[:, lag : lag + columns]) for lag in range(2 * reach + 1)])
    energy = np.einsum("rx,rx->x", extended, extended)
    energies = np.stack([energy[lag : lag + columns] for lag in range(2 * reach + 1)])
    own = windows @ np.einsum("rx,rx->x", a, a)
    other = energies @ windows.T
    scores = (products @ windows.T) / np.sqrt(np.maximum(own * other, 1e-6))
    best = scores.argmax(axis=0)
    inner = np.clip(best, 1, 2 * reach - 1)
    at = np.arange(SECTORS)
    left, mid, right = scores[inner - 1, at], scores[inner, at], scores[inner + 1, at]
    bend = left - 2.0 * mid + right
    offset = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, -1.0), 0.0)
    clear = (best == inner) & (bend < 0.0)
    shift = whole + inner - reach + np.clip(offset, -0.5, 0.5)
    variance = np.where(clear, np.maximum(1.0 - mid, 1e-6) / np.maximum(-bend, 1e-9) / 64.0, np.inf)
    centre = columns / SECTORS * np.arange(SECTORS)
    return SectorShifts(centre, shift.astype(np.float64), variance.astype(np.float64))


@lru_cache(maxsize=8)
def sector_windows(columns: int) -> npt.NDArray[np.float32]:
    """(sectors, columns) circular Hann windows, each an eighth of the circle wide."""
    centre = columns / SECTORS * np.arange(SECTORS)
    distance = signed(np.arange(columns)[None, :] - centre[:, None], columns) / (columns / 8.0)
    windows = np.where(np.abs(distance) < 0.5, np.cos(np.pi * distance) ** 2, 0.0)
    return windows.astype(np.float32)
