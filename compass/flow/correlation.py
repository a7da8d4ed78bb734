"""Circular correlation: all shifts at once by FFT, and its maximum off the grid.

Everywhere a positive shift means that the current strip is the reference moved to the right, which is a turn to the
left (a panorama's columns run clockwise seen from above).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from compass.images.strip import Strip

Floats = npt.NDArray[np.floating]
# Columns by which a shift errs beside its noise: interpolation and compression pull it to the grid. Corners of
# photographs that all move by the same part of a column err by 0.012 together; halved and doubled in
# docs/lab-notes/constants-2026-11-29.md.
FLOOR_PX = 0.015
# What is nothing beside anything, and keeps finite what has no contrast, no error or no precision: grey values of 255,
# columns, rad^-2, or a share.
TINY = 1e-3


@dataclass(frozen=True, slots=True)
class Peak:
    """A maximum of a correlation.

    Attributes
    ----------
    shift_px : float
        Where, columns.
    value : float
        How high.
    curvature : float
        Second derivative there, per column^2, negative at a true maximum.
    """

    shift_px: float
    value: float
    curvature: float


def correlate_rows(reference: Strip, current: Strip) -> Floats:
    """Normalised coefficients of each row for every circular shift (paper, eq. 2, computed by eq. 3).

    Returns
    -------
    (rows, columns) array in -1..1
        Element (r, s) compares row r of `current` with row r of `reference` moved right by s columns. Rows without
        texture give zeros.
    """
    product = current.spectrum * reference.conjugate
    coefficients = scipy.fft.irfft(product, reference.columns, axis=1)
    energy = np.sqrt(np.einsum("rx,rx->r", reference.pixels, reference.pixels))
    energy *= np.sqrt(np.einsum("rx,rx->r", current.pixels, current.pixels))
    flat = energy < 1e-6 * max(float(energy.max()), 1.0)
    coefficients /= np.where(flat, np.inf, energy)[:, None]
    return coefficients  # type: ignore[no-any-return]


def pooled_spectrum(reference: Strip, current: Strip) -> npt.NDArray[np.complex64]:
    """Cross-spectrum of all rows together, normalised so that a perfect match correlates to 1."""
    energy = reference.contrast * current.contrast * reference.pixels.size
    spectrum = (reference.conjugate * current.spectrum).sum(axis=0)
    return spectrum / np.float32(max(energy, 1e-12))  # type: ignore[no-any-return]


def upright_spectrum(reference: Strip, current: Strip) -> npt.NDArray[np.complex64]:
    """The same of fewer rows: not as precise, and several times as quick."""
    energy = math.sqrt(reference.energy * current.energy)
    spectrum = (reference.upright_spectrum.conj() * current.upright_spectrum).sum(axis=0)
    return spectrum / np.float32(max(energy, 1e-12))  # type: ignore[no-any-return]


def signed(shift: npt.ArrayLike, columns: int) -> npt.NDArray[np.float64]:
    """Bring shifts of the circle into [-columns / 2, columns / 2)."""
    half = columns / 2.0
    return (np.asarray(shift, dtype=np.float64) + half) % columns - half


def continuous_peak(spectrum: npt.NDArray[np.complex64], columns: int, start_px: float, steps: int = 6) -> Peak:
    """Maximum of the continuous correlation near the sample `start_px`, by Newton's method.

    The correlation of sampled circles is a trigonometric polynomial, known between its samples exactly; a parabola
    through three samples is not, and errs by a hundredth of a column.
    """
    omega = 2.0 * np.pi / columns * np.arange(spectrum.size)
    weighted = spectrum * (2.0 / columns)
    weighted[0] *= 0.5
    if columns % 2 == 0:
        weighted[-1] = 0.0  # half a wave a column: its phase is not known, noise would pull the peak to whole columns
    shift = start_px
    for _ in range(steps):
        wave = weighted * np.exp(1j * omega * shift)
        slope = -float(omega @ wave.imag)
        curvature = -float((omega * omega) @ wave.real)
        if curvature >= 0.0:  # not a maximum: stay at the sample
            break
        step = min(max(-slope / curvature, -0.5), 0.5)
        shift = min(max(shift + step, start_px - 1.0), start_px + 1.0)
        if abs(step) < 1e-5:  # columns; the next step would be its square
            break
    return Peak(shift, float(wave.real.sum()), curvature)
