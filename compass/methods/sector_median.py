"""The paper's future work: sectors find their own shift, their median is the turn."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from compass.agreement import DISAGREE
from compass.features.points import SECTORS
from compass.flow.coarse_shift import coarse_shift, quantile
from compass.flow.correlation import FLOOR_PX, TINY, Floats, continuous_peak, pooled_spectrum, signed
from compass.flow.pure_turn import pooled_turn, turn_variance
from compass.images.strip import Pixels, Strip, softened_columns
from compass.methods.match import Match, Search

# Sectors in a row share columns; with 2 and 8 images of 128 columns err by 1.3 and 1.2 times as much
# (docs/lab-notes/halves-and-doubles-2026-11-30.md).
OVERLAP = 4
# Times as far as sectors may corners move apart until the keyframe is renewed: by 8 columns, not 1. With half of it
# increments of such images err twice as much, with twice as much the raw yaw by 0.9 to 1.5 (the same note).
SPREAD_FACTOR = 8.0


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
    # a median has pi / 2 times the variance of a mean, and sectors that share columns are one
    independent = max(sectors.shift_px.size / OVERLAP, 1.0)
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
    if off > DISAGREE or peak.curvature >= 0.0:  # pixels that were doubled have no maximum half a column off
        return match
    shift, variance = float(signed(peak.shift_px, reference.columns)), turn_variance(peak, spectrum, reference)
    return replace(match, shift_px=shift, variance_px2=variance)


def local_shifts(
    reference: Strip, current: Strip, coarse_px: int, sectors: int = SECTORS, overlap: int = OVERLAP
) -> SectorShifts:
    """Sub-pixel shifts of overlapping sectors: of each the peak on whose slope the coarse one lies.

    Sectors without texture have none, nor has an image too narrow for them.

    Parameters
    ----------
    coarse_px : int
        Shift to the right around which to look, columns.
    sectors : int
        How many, evenly spread.
    overlap : int
        How many of them in a row share columns: so many times as wide as they are apart.
    """
    columns = reference.columns
    if columns < sectors:
        return SectorShifts(np.empty(0), np.empty(0), np.empty(0))
    windows = _windows(columns, sectors, overlap)
    before, now = softened_columns(reference.pixels), np.roll(softened_columns(current.pixels), -coarse_px, axis=1)
    inside, scores = _lag_scores(before, now, windows)
    lag = _uphill(scores)
    if reference.seen is not None and current.seen is not None:
        both = (reference.seen.pixels * np.roll(current.seen.pixels, -coarse_px, axis=1)).mean(axis=0)
        inside &= 2.0 * (windows @ both) > windows.sum(axis=1)  # most of a sector
    found = []
    for index in np.flatnonzero(inside):
        peak = continuous_peak(scipy.fft.rfft(scores[index]), columns, float(lag[index]))
        if peak.curvature < 0.0:
            # Cramer-Rao: noise energy over gradient energy; the gradient's is the curvature of the correlation
            pixels = float(windows[index].sum()) * len(before)
            noise = 2.0 * max(1.0 - peak.value, 1e-5) / (pixels * -peak.curvature)
            found.append((columns / sectors * index, coarse_px + peak.shift_px, math.sqrt(noise + FLOOR_PX**2)))
    return SectorShifts(*np.array(found).reshape(-1, 3).T)


def _lag_scores(before: Pixels, now: Pixels, windows: Pixels) -> tuple[npt.NDArray[np.bool_], Pixels]:
    """(sectors,) whether each windowed sector has any texture; (sectors, columns) its normalised correlation.

    For each lag to the right.
    """
    columns, seen = before.shape[1], scipy.fft.rfft(now, axis=1)
    own = windows @ np.einsum("rx,rx->x", before, before)
    least = TINY * float(own.mean())
    spectra = np.array([(scipy.fft.rfft(window * before, axis=1).conj() * seen).sum(axis=0) for window in windows])
    squares = scipy.fft.rfft(np.einsum("rx,rx->x", now, now))
    energy = scipy.fft.irfft(scipy.fft.rfft(windows, axis=1).conj() * squares, columns, axis=1)
    scale = np.sqrt(np.maximum(own, least)[:, None] * np.maximum(energy, max(least, 1e-6)))
    level = ((before @ windows.T) ** 2).sum(axis=0) / windows.sum(axis=1)  # energy that is the same in all columns
    return own - level > least, scipy.fft.irfft(spectra, columns, axis=1) / scale


def _uphill(scores: Pixels) -> npt.NDArray[np.intp]:
    """(sectors,) lags of the maxima that are reached from lag 0 without a step down."""
    columns = scores.shape[1]
    left, right = np.roll(scores, 1, axis=1), np.roll(scores, -1, axis=1)
    way = np.where(right > left, 1, -1)
    way[(scores >= left) & (scores >= right)] = 0
    sector, lag = np.arange(len(scores)), np.zeros(len(scores), np.intp)
    for _ in range(columns):
        step = way[sector, lag]
        if not step.any():
            break
        lag = (lag + step) % columns
    return np.asarray(signed(lag, columns), np.intp)


@lru_cache(maxsize=8)
def _windows(columns: int, sectors: int, overlap: int) -> Pixels:
    """(sectors, columns) circular Hann windows, evenly spread."""
    centre = columns / sectors * np.arange(sectors)
    distance = signed(np.arange(columns)[None, :] - centre[:, None], columns) / (columns * overlap / sectors)
    return np.where(np.abs(distance) < 0.5, np.cos(np.pi * distance) ** 2, 0.0).astype(np.float32)
