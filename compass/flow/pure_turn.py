"""A turn and nothing else: all rows pooled, to the Cramer-Rao bound, and how far that can be trusted."""

from __future__ import annotations

import numpy as np

from compass.flow.correlation import FLOOR_PX, TINY, Peak, continuous_peak, pooled_spectrum
from compass.images.strip import Spectrum, Strip

# Edges of the bands of spatial frequency that are asked for a shift of their own, waves per column: octaves, and from
# 1/8 on, where most of a photograph's information lies, steps of 1/16.
BANDS = np.array([1 / 1024, 1 / 32, 1 / 16, 1 / 8, 3 / 16, 1 / 4, 5 / 16, 3 / 8, 1 / 2])


def pooled_turn(reference: Strip, current: Strip, near_px: float) -> tuple[Peak, Spectrum]:
    """Shift of all rows together, known to be near `near_px`, and the spectrum of their correlation."""
    spectrum = pooled_spectrum(reference, current)
    return continuous_peak(spectrum, reference.columns, near_px), spectrum


def turn_variance(peak: Peak, spectrum: Spectrum, reference: Strip) -> float:
    """Variance of a shift that `pooled_turn` has found, columns^2."""
    bound = _bound(peak, reference)
    return bound + _bands_apart(spectrum, reference.columns, peak, bound)


def _bound(peak: Peak, reference: Strip) -> float:
    """Cramer-Rao bound of the variance of the shift of all rows pooled, columns^2."""
    bound = 2.0 * max(1.0 - peak.value, 1e-6) / (reference.pixels.size * max(-peak.curvature, 1e-12))
    return bound if reference.seen is None else bound + FLOOR_PX**2  # the edges of a mask stay


def _bands_apart(spectrum: Spectrum, columns: int, peak: Peak, bound: float) -> float:
    """Variance between the shifts that bands of spatial frequency find by themselves, beyond that of noise, columns^2.

    Compression and resampling move fine detail towards the grid they work on: all round the circle alike, so that no
    scatter of sectors shows it, by hundredths of a column where noise leaves thousandths. Coarse detail does not
    follow. How far the bands lie apart is how far their weighted mean, the peak, may lie from the truth; it is not
    divided by their number, because they err to the same side. The estimate is that of random effects (DerSimonian and
    Laird 1986, doi:10.1016/0197-2456(86)90046-2): chi-square less its expectation, where that is more than its
    deviation; white noise passes one in six.
    """
    edges = np.unique(np.minimum(np.round(BANDS * columns), spectrum.size - 1).astype(np.intp))
    omega = 2.0 * np.pi / columns * np.arange(spectrum.size)
    wave = spectrum * np.exp(1j * omega * peak.shift_px) * (2.0 / columns)
    slope = np.add.reduceat(omega * wave.imag, edges)[:-1]  # of the band's correlation, where all of them are best
    bend = np.add.reduceat(omega**2 * wave.real, edges)[:-1]
    informative = bend > TINY * bend.sum()  # a band with less has no shift of its own
    if not informative.any():  # an image of a few columns has no bands
        return 0.0
    between = float((slope[informative] ** 2 / bend[informative]).sum() / bend[informative].sum())
    free = np.count_nonzero(informative) - 1
    excess = between - free * bound
    return excess if excess > np.sqrt(2.0 * free) * bound else 0.0
