"""Shifts of sectors: how far each part of the panorama moved, to a fraction of a column."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy.interpolate import make_interp_spline

from compass.correlation import Floats, signed
from compass.increment import CompassStatus
from compass.match import Search
from compass.strip import SMOOTHED_ROWS, Pixels, Spectrum, Strip

REACH_PX = 20  # how far a sector may lie from the coarse shift, columns
OUTSIDE = 0.5  # of the highest peak anywhere is enough for one within reach
RIVAL = 0.97  # of the highest peak makes another, APART-th of the circle away, as likely
APART = 16
TAPS = 6  # samples on either side of the best one that its interpolation uses
BLOCK = 16  # columns that are multiplied at a time
FINE = 16  # interpolated samples per column
CORRELATED_PIXELS = 4.0  # that share their error: smoothing, and parallax inside a sector
MOSTLY = 0.3  # of a sector must show the world in both strips; losing more on one side misleads their median
NOISE_FLOOR_PX = 0.01  # what interpolation and JPEG leave of a shift's error, columns


@dataclass(frozen=True, slots=True)
class SectorShifts:
    """What each sector that has an answer says; arrays of one length.

    Attributes
    ----------
    centre_px : array
        Column in the middle of each sector, in the reference.
    shift_px, sigma_px : array
        Shift to the right and its standard deviation from image noise, columns.
    correlation : array
        Normalised peak correlation, -1..1.
    energy : array
        Sum of squared grey values, the sector's weight in an average.
    texture_px : array
        Column in the middle of each sector's texture: what moves unevenly has moved by `shift_px` there.
    """

    centre_px: Floats
    shift_px: Floats
    sigma_px: Floats
    correlation: Floats
    energy: Floats
    texture_px: Floats

    @property
    def apart_px(self) -> float:
        """How far at most three sectors of four lie from their median, columns."""
        return quantile(np.abs(self.shift_px - quantile(self.shift_px, 0.5)), 0.75)

    @property
    def mean_correlation(self) -> float:
        """Correlation of all sectors together, each where it matches best."""
        total = float(self.energy.sum())
        return float(self.correlation @ self.energy) / total if total > 0.0 else 0.0


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


def coarse_shift(spectrum: Spectrum, columns: int, search: Search) -> CoarseShift:
    """Shift of all rows pooled: the highest peak within reach, unless only one outside it matches.

    Parameters
    ----------
    spectrum : (columns // 2 + 1,) array
        Of the strips' correlation, as `pooled_spectrum` or `upright_spectrum` gives it.
    """
    values = scipy.fft.irfft(spectrum, columns)
    best = anywhere = int(values.argmax())
    lags = np.arange(columns)
    possible = np.abs(signed(lags - search.expected_px, columns)) <= search.reach_px + 1.0
    if not possible[best]:
        best = int(np.where(possible, values, -np.inf).argmax())
        shoulder = max(values[best - 1], values[(best + 1) % columns]) > values[best]  # of a peak beyond reach
        if shoulder or values[best] < OUTSIDE * values[anywhere]:
            best, possible = anywhere, np.ones(columns, bool)
    rivals = possible & (np.abs(signed(lags - best, columns)) > columns / APART)
    ambiguous = bool(rivals.any()) and float(values[rivals].max()) > RIVAL * float(values[best])
    status = CompassStatus.AMBIGUOUS if ambiguous else CompassStatus.OK
    return CoarseShift(int(signed(best, columns)), float(values[best]), status)


def local_shifts(
    reference: Strip,
    current: Strip,
    coarse_px: int,
    sectors: int,
    per_circle: float,
    rows: int = SMOOTHED_ROWS,
    reach_px: int = REACH_PX,
) -> SectorShifts:
    """Sub-pixel shifts of overlapping sectors around a coarse one.

    Parameters
    ----------
    coarse_px : int
        Shift to the right around which to look, columns.
    sectors : int
        How many, evenly spread.
    per_circle : float
        How many of their width make a full circle.
    rows : int
        As how many rows at most the strips are compared.
    reach_px : int
        How far from the coarse shift, columns. Those within `TAPS` of the end have no answer.
    """
    columns = reference.columns
    reach = min(reach_px, columns // 4)
    if reach <= TAPS or columns < 2 * per_circle:  # an image too narrow to have sectors
        nothing = np.empty(0)
        return SectorShifts(nothing, nothing, nothing, nothing, nothing, nothing)
    before, now = reference.smoothed(rows), current.smoothed(rows)
    scores, energy = _lag_scores(before, now, sectors, per_circle, coarse_px, reach)
    best = scores.argmax(axis=0)
    lag, height, bend = _interpolated_peaks(scores, np.clip(best, TAPS, 2 * reach - TAPS))
    inside = (best >= TAPS) & (best <= 2 * reach - TAPS) & (bend < 0.0) & (energy > 1e-3 * energy.mean())
    seen = _seen_in_both(reference, current, sectors, per_circle, coarse_px)
    if seen is not None:
        inside &= seen > MOSTLY
    # Cramer-Rao: noise energy over gradient energy; the gradient's is the curvature of the correlation
    pixels = _window_area(columns, sectors, per_circle) * len(before) / CORRELATED_PIXELS
    noise = 2.0 * np.clip(1.0 - height, 1e-5, None) / (pixels * np.where(inside, -bend, 1.0))
    centre = columns / sectors * np.arange(sectors)
    return SectorShifts(
        centre[inside],
        (coarse_px - reach + lag)[inside],
        np.sqrt(noise + NOISE_FLOOR_PX**2)[inside],
        height[inside],
        energy[inside],
        (centre + _texture_offset(reference, sectors, per_circle, rows))[inside],
    )


@lru_cache(maxsize=4)
def _texture_offset(strip: Strip, sectors: int, per_circle: float, rows: int) -> Floats:
    """(sectors,) how far to the right of each sector's centre its texture lies on average, columns.

    A shift weighs columns by the square of what changes when they move.
    """
    pixels, columns = strip.smoothed(rows), strip.columns
    change = np.roll(pixels, -1, axis=1) - np.roll(pixels, 1, axis=1)
    weight = np.einsum("rx,rx->x", change, change)
    mean: Floats = _window_moments(columns, sectors, per_circle) @ weight
    return mean / np.maximum(sector_sums(weight, sectors, per_circle), 1e-9)


@lru_cache(maxsize=8)
def _window_area(columns: int, sectors: int, per_circle: float) -> Floats:
    """(sectors,) columns under each window."""
    area: Floats = sector_windows(columns, sectors, per_circle).sum(axis=1)
    return area


@lru_cache(maxsize=8)
def _window_moments(columns: int, sectors: int, per_circle: float) -> Floats:
    """(sectors, columns) windows times the distance from their middle, columns."""
    centre = columns / sectors * np.arange(sectors)
    distance = signed(np.arange(columns) - centre[:, None], columns)
    moments: Floats = sector_windows(columns, sectors, per_circle) * distance
    return moments


def _seen_in_both(reference: Strip, current: Strip, sectors: int, per_circle: float, whole: int) -> Pixels | None:
    """Share of each sector that shows the world both here and `whole` columns further on; None where all does."""
    if reference.seen is None or current.seen is None:
        return None
    both = (reference.seen.smoothed * np.roll(current.seen.smoothed, -whole, axis=1)).mean(axis=0)
    seen: Pixels = sector_sums(both, sectors, per_circle) / sector_windows(reference.columns, 1, per_circle).sum()
    return seen


def _lag_scores(
    reference: Pixels, current: Pixels, sectors: int, per_circle: float, whole: int, reach: int
) -> tuple[Pixels, Pixels]:
    """Normalised correlation of each windowed sector for each whole lag around `whole`.

    Returns
    -------
    (2 * reach + 1, sectors) and (sectors,) arrays
        The scores, and each sector's energy in the reference.
    """
    columns = reference.shape[1]
    extended = _unrolled(current, (whole - reach) % columns, columns + 2 * reach)
    energy = np.einsum("rx,rx->x", extended, extended)
    lags = 2 * reach + 1
    sums = np.empty((2, lags, columns), np.float32)
    sums[0] = _lag_products(reference, extended, lags)
    sums[1] = np.lib.stride_tricks.sliding_window_view(energy, columns)
    products, energies = sector_sums(sums, sectors, per_circle)
    own = sector_sums(np.einsum("rx,rx->x", reference, reference), sectors, per_circle)
    return products / np.sqrt(np.maximum(own * energies, np.float32(1e-6))), own


def _lag_products(reference: Pixels, extended: Pixels, lags: int) -> Pixels:
    """(lags, columns) products of each column with all those it may have come from, one of them per lag.

    Blocks of columns are multiplied as matrices, which is twice as fast, and the band about their diagonals taken out.
    """
    rows, columns = reference.shape
    block = math.gcd(columns, BLOCK)
    before = np.ascontiguousarray(reference.T).reshape(-1, block, rows)
    now = np.lib.stride_tricks.sliding_window_view(extended, block + lags - 1, axis=1)[:, ::block].transpose(1, 0, 2)
    products = before @ now
    across, down, along = products.strides
    band = np.lib.stride_tricks.as_strided(products, (len(before), block, lags), (across, down + along, along))
    return band.reshape(columns, lags).T


def _unrolled(pixels: Pixels, first: int, count: int) -> Pixels:
    """`count` columns from `first` on, round the circle as often as needed."""
    columns = pixels.shape[1]
    whole, rest = divmod(first + count - columns, columns)
    return np.concatenate([pixels[:, first:], *[pixels] * whole, pixels[:, :rest]], axis=1)


def _interpolated_peaks(scores: Pixels, best: npt.NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
    """Maximum of the scores between their samples: lag, height and curvature for each sector."""
    sector = np.arange(scores.shape[1])
    around = scores[best[:, None] + np.arange(-TAPS, TAPS + 1), sector[:, None]]
    fine = around @ _spline_weights()
    top = np.clip(fine.argmax(axis=1), 1, fine.shape[1] - 2)
    left, mid, right = fine[sector, top - 1], fine[sector, top], fine[sector, top + 1]
    bend = left - 2.0 * mid + right
    offset = np.clip(0.5 * (left - right) / np.where(bend < 0.0, bend, -np.inf), -0.5, 0.5)
    return best - 1.0 + (top + offset) / FINE, mid, bend * FINE**2


@lru_cache(maxsize=1)
def _spline_weights() -> Floats:
    """(2 * TAPS + 1, 2 * FINE + 1) weights of a quintic spline through the samples, from -1 to 1 column."""
    samples = np.arange(-TAPS, TAPS + 1)
    spline = make_interp_spline(samples, np.eye(samples.size), k=5)
    return np.asarray(spline(np.arange(-FINE, FINE + 1) / FINE), dtype=np.float64).T


@lru_cache(maxsize=8)
def sector_windows(columns: int, sectors: int, per_circle: float) -> Pixels:
    """(sectors, columns) circular Hann windows, evenly spread."""
    centre = columns / sectors * np.arange(sectors)
    distance = signed(np.arange(columns)[None, :] - centre[:, None], columns) / (columns / per_circle)
    return np.where(np.abs(distance) < 0.5, np.cos(np.pi * distance) ** 2, 0.0).astype(np.float32)


def sector_sums(values: Pixels, sectors: int, per_circle: float) -> Pixels:
    """Sums of columns under each of the windows, (..., columns) -> (..., sectors).

    The same as ``values @ sector_windows(...).T``, without its many zeros where the windows begin on whole columns.
    """
    columns = values.shape[-1]
    overlap = round(sectors / per_circle)  # windows over every column
    if columns % sectors or overlap % 2 or overlap * per_circle != sectors:
        dense: Pixels = values @ sector_windows(columns, sectors, per_circle).T
        return dense
    parts = values.reshape(*values.shape[:-1], sectors, columns // sectors) @ _window_parts(columns, sectors, overlap)
    around = np.concatenate([parts[..., -(overlap // 2) :, :], parts, parts[..., : overlap // 2, :]], axis=-2)
    total: Pixels = around[..., :sectors, 0] + around[..., 1 : sectors + 1, 1]
    for part in range(2, overlap):
        total += around[..., part : sectors + part, part]
    return total


@lru_cache(maxsize=8)
def _window_parts(columns: int, sectors: int, overlap: int) -> Pixels:
    """(columns / sectors, overlap) window that is `overlap` times as wide as its distance from the next, in pieces."""
    step = columns // sectors
    window = sector_windows(columns, sectors, sectors / overlap)[0]
    return np.ascontiguousarray(np.roll(window, overlap * step // 2)[: overlap * step].reshape(overlap, step).T)
