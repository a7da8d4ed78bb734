"""The paper's future work: sectors find their own shift, their median is the turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from compass.features.points import SECTORS
from compass.flow.coarse_shift import coarse_shift, quantile
from compass.flow.correlation import FLOOR_PX, Floats, pooled_spectrum, signed
from compass.flow.pure_turn import pooled_turn, turn_variance
from compass.images.strip import Pixels, Strip
from compass.methods.match import Match, Search

PER_CIRCLE = SECTORS / 4.0  # Hann windows as wide as four of them, an eighth of the circle
REACH_PX = 20  # how far a sector may lie from the coarse shift, columns
TAPS = 6  # samples on either side of the best one that its interpolation uses
FINE = 16  # interpolated samples per column
CORRELATED_PIXELS = 4.0  # that share their error: smoothing, and parallax inside a sector; not derived
SPREAD_FACTOR = 8.0  # times as far as sectors may corners move apart until the keyframe is renewed: by 8 columns, not 1
AGREED = 1.5  # deviations: three sectors of four this near to all rows pooled saw nothing but a turn


@dataclass(frozen=True, slots=True)
class SectorShifts:
    """What each sector that has an answer says; arrays of one length.

    Attributes
    ----------
    centre_px : array
        Column in the middle of each sector, in the reference.
    shift_px, sigma_px : array
        Shift to the right and its standard deviation from image noise, columns.
    """

    centre_px: Floats
    shift_px: Floats
    sigma_px: Floats


def match_sectors(reference: Strip, current: Strip, search: Search) -> Match:
    """Coarse shift of all rows pooled, a sub-pixel shift in each overlapping sector, the median of these.

    A sector that sees something near is pushed aside when the robot drives; as long as fewer than half are pushed to
    one side, the median is not.
    """
    coarse = coarse_shift(pooled_spectrum(reference, current), reference.columns, search)
    sectors = local_shifts(reference, current, coarse.shift_px)
    if not sectors.shift_px.size:
        return Match(float(coarse.shift_px), np.inf, 0.0)
    median = float(np.median(sectors.shift_px))
    spread = 1.4826 * float(np.median(np.abs(sectors.shift_px - median)))
    # a median has pi / 2 times the variance of a mean; every fourth sector is independent
    independent = max(sectors.shift_px.size * PER_CIRCLE / SECTORS, 1.0)
    variance = 0.5 * np.pi * max(spread**2, float(np.median(sectors.sigma_px**2))) / independent
    confidence = float(np.clip(coarse.correlation, 0.0, 1.0))
    return Match(float(signed(median, reference.columns)), variance, confidence, coarse.status)


def match_small(reference: Strip, current: Strip, search: Search) -> Match:
    """The same of images that are too small for corners, or have none, with how far the sectors have moved apart.

    So a keyframe lasts while the camera only turns; where sectors agree on that, all rows pooled measure it best.
    """
    median = match_sectors(reference, current, search)
    sectors = local_shifts(reference, current, round(median.shift_px))
    if not sectors.shift_px.size:
        return median
    apart = quantile(np.abs(sectors.shift_px - median.shift_px), 0.75)
    match = replace(median, spread_px=SPREAD_FACTOR * apart)
    peak, spectrum = pooled_turn(reference, current, median.shift_px)
    off = quantile(np.abs(sectors.shift_px - peak.shift_px) / sectors.sigma_px, 0.75)
    if off > AGREED or peak.curvature >= 0.0:  # pixels that were doubled have no maximum half a column off
        return match
    shift, variance = float(signed(peak.shift_px, reference.columns)), turn_variance(peak, spectrum, reference)
    return replace(match, shift_px=shift, variance_px2=variance)


def local_shifts(
    reference: Strip, current: Strip, coarse_px: int, sectors: int = SECTORS, per_circle: float = PER_CIRCLE
) -> SectorShifts:
    """Sub-pixel shifts of overlapping sectors around a coarse one.

    Those within `TAPS` of the end of their reach have none, nor has an image too narrow for sectors.

    Parameters
    ----------
    coarse_px : int
        Shift to the right around which to look, columns.
    sectors : int
        How many, evenly spread.
    per_circle : float
        How many of their width make a full circle.
    """
    columns = reference.columns
    reach = min(REACH_PX, columns // 4)
    if reach <= TAPS or columns < 2 * per_circle:
        return SectorShifts(np.empty(0), np.empty(0), np.empty(0))
    windows = _windows(columns, sectors, per_circle)
    before, now = reference.smoothed(), current.smoothed()
    scores, energy = _lag_scores(before, now, windows, coarse_px, reach)
    best = scores.argmax(axis=0)
    lag, height, bend = _interpolated_peaks(scores, np.clip(best, TAPS, 2 * reach - TAPS))
    inside = (best >= TAPS) & (best <= 2 * reach - TAPS) & (bend < 0.0) & (energy > 1e-3 * energy.mean())
    if reference.seen is not None and current.seen is not None:
        both = (reference.seen.smoothed * np.roll(current.seen.smoothed, -coarse_px, axis=1)).mean(axis=0)
        inside &= 2.0 * (windows @ both) > windows.sum(axis=1)  # most of a sector
    # Cramer-Rao: noise energy over gradient energy; the gradient's is the curvature of the correlation
    pixels = windows.sum(axis=1) * len(before) / CORRELATED_PIXELS
    noise = 2.0 * np.clip(1.0 - height, 1e-5, None) / (pixels * np.where(inside, -bend, 1.0))
    centre = columns / sectors * np.arange(sectors)
    sigma = np.sqrt(noise + FLOOR_PX**2)
    return SectorShifts(centre[inside], (coarse_px - reach + lag)[inside], sigma[inside])


def _lag_scores(before: Pixels, now: Pixels, windows: Pixels, whole: int, reach: int) -> tuple[Pixels, Pixels]:
    """(2 * reach + 1, sectors) normalised correlation of each windowed sector for each whole lag around `whole`.

    And (sectors,) the energy of each in the reference.
    """
    columns = before.shape[1]
    products, energies = np.empty((2, 2 * reach + 1, columns), np.float32)
    squares = np.einsum("rx,rx->x", now, now)
    for k, lag in enumerate(range(whole - reach, whole + reach + 1)):
        products[k] = np.einsum("rx,rx->x", before, np.roll(now, -lag, axis=1))
        energies[k] = np.roll(squares, -lag)
    own = windows @ np.einsum("rx,rx->x", before, before)
    scores: Pixels = products @ windows.T / np.sqrt(np.maximum(own * (energies @ windows.T), np.float32(1e-6)))
    return scores, own


def _interpolated_peaks(scores: Pixels, best: np.ndarray[tuple[int], np.dtype[np.intp]]) -> tuple[Floats, ...]:
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
    from scipy.interpolate import make_interp_spline  # brings half of scipy, and small strips alone need it

    samples = np.arange(-TAPS, TAPS + 1)
    spline = make_interp_spline(samples, np.eye(samples.size), k=5)
    return np.asarray(spline(np.arange(-FINE, FINE + 1) / FINE), dtype=np.float64).T


@lru_cache(maxsize=8)
def _windows(columns: int, sectors: int, per_circle: float) -> Pixels:
    """(sectors, columns) circular Hann windows, evenly spread."""
    centre = columns / sectors * np.arange(sectors)
    distance = signed(np.arange(columns)[None, :] - centre[:, None], columns) / (columns / per_circle)
    return np.where(np.abs(distance) < 0.5, np.cos(np.pi * distance) ** 2, 0.0).astype(np.float32)
