"""Corners of a keyframe: where they are, the patches around them, and how well these show a shift.

Shi & Tomasi 1994, doi:10.1109/CVPR.1994.323794.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from compass.features.padded_strip import MARGIN, WINDOW, Picture
from compass.flow.correlation import TINY
from compass.images.strip import Pixels

Floats = npt.NDArray[np.floating]

# Corners are spread over the circle: the strongest of each sector. With 3 and 12 of each, increments of held-out drives
# err by 1.39 and 1.03 times as much (docs/lab-notes/constants-2026-11-30.md), with 16 and 64 sectors by 1.18 and 0.97,
# at 0.8 and 1.2 of the time (docs/lab-notes/halves-and-doubles-2026-11-30.md).
SECTORS, PER_SECTOR = 32, 6
# Smaller eigenvalue of a corner, of that of the strongest: without, increments err by 1.15 times as much
# (docs/lab-notes/constants-2026-11-29.md).
WEAKEST = 3e-3


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """What surrounds n corners, and what a shift of it looks like.

    Attributes
    ----------
    at : (n, 2) float32 array
        Columns and rows of their middles in the strip.
    values, contrast : (n, pixels) and (n,) arrays
        Grey values without their weighted means, and their weighted root mean squares.
    answer : (n, 2, pixels) array
        How far to the right and down a patch has moved, pixels, per difference of its pixels from `values`.
    covariance : (n, 3) array
        Of that, for a noise of one grey value in weighted means: right-right, right-down, down-down, pixels^2.
    centre : (n, 2) array
        Where, from the middle, the texture is that shows the shift, pixels: a patch that grows moves as that does.
    """

    at: Pixels
    values: Pixels
    contrast: Pixels
    answer: Pixels
    covariance: Pixels
    centre: Pixels

    def __len__(self) -> int:
        """How many corners."""
        return len(self.at)


def find_corners(picture: Picture) -> Pixels:
    """(n, 2) columns and rows of the strongest corners of each sector (Shi & Tomasi 1994), clear of the robot.

    They are sought at half the size, which costs a quarter: where exactly a patch is cut does not matter.
    """
    half = cv2.resize(picture.soft, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    strength = cv2.cornerMinEigenVal(half, WINDOW.half, ksize=3)
    peak = strength >= cv2.dilate(strength, np.ones((3, 3), np.uint8))
    row, column = np.nonzero(peak)
    at = np.stack([2.0 * column - MARGIN, 2.0 * row], axis=1).astype(np.float32)
    inside = (
        (at[:, 0] >= 0.0)
        & (at[:, 0] < picture.columns)
        & (at[:, 1] > WINDOW.half + 2)
        & (at[:, 1] < picture.rows - WINDOW.half - 4)
    )
    if picture.clear is not None:
        inside &= picture.clear[row.astype(np.intp) * 2, (at[:, 0].astype(np.intp)) % picture.columns]
    at, strong = at[inside], strength[row, column][inside]
    if not at.size:
        return at
    order = np.argsort(-strong)
    order = order[strong[order] > WEAKEST * strong[order[0]]]
    sector = sectors_of(at[order], picture.columns)
    grouped = np.argsort(sector, kind="stable")
    first = np.searchsorted(sector[grouped], sector[grouped])
    chosen: Pixels = at[order[grouped[np.arange(grouped.size) - first < PER_SECTOR]]]
    return chosen


def sectors_of(at: Pixels, columns: int) -> npt.NDArray[np.intp]:
    """(n,) which of the `SECTORS` of the circle (n, 2) columns and rows lie in."""
    return (at[:, 0] % columns * (SECTORS / columns)).astype(np.intp)


def cut_patches(picture: Picture, at: Pixels) -> Patches:
    """What surrounds corners at (n, 2) columns and rows of the strip."""
    around = _windows(picture.soft, at.astype(np.intp), 1)
    values, contrast = levelled(around[:, 1:-1, 1:-1].reshape(len(at), WINDOW.side * WINDOW.side))
    right, down = around[:, 1:-1, 2:] - around[:, 1:-1, :-2], around[:, 2:, 1:-1] - around[:, :-2, 1:-1]
    right, down = (0.5 * one.reshape(len(at), WINDOW.side * WINDOW.side) for one in (right, down))
    slopes = np.stack([right, down], axis=1)
    growing = right * WINDOW.across + down * WINDOW.down
    # a change of brightness or contrast is no shift: both are taken out of the slopes
    slopes -= (slopes @ WINDOW.weights)[..., None]
    like = (slopes @ (values * WINDOW.weights)[..., None])[..., 0] / (contrast**2)[:, None]
    slopes -= like[..., None] * values[:, None]
    weighed = slopes * WINDOW.weights
    information = weighed @ slopes.transpose(0, 2, 1) + np.float32(TINY) * np.eye(2, dtype=np.float32)
    inverse = np.asarray(np.linalg.inv(information), np.float32)
    answer = inverse @ weighed
    centre = (answer @ growing[..., None])[..., 0]
    return Patches(at, values, contrast, answer, inverse[:, [0, 0, 1], [0, 1, 1]], centre)


def sample(pixels: Pixels, at: Pixels) -> Pixels:
    """(n, pixels) grey values about (n, 2) columns and rows of the strip, interpolated.

    By the six-point cubic convolution of Keys (1981, doi:10.1109/TASSP.1981.1163711): errors go with the fourth power
    of a pixel. `cv2.remap` would be no quicker, and its cubic pulls a shift by up to 0.04 pixels to whole ones.
    """
    whole = np.floor(at).astype(np.intp)
    across, down = _interpolations(at - whole)
    patches = np.asarray(down @ _windows(pixels, whole, 2, 3) @ across, np.float32)
    return patches.reshape(len(at), WINDOW.side * WINDOW.side)


def _windows(pixels: Pixels, whole: npt.NDArray[np.intp], before: int, after: int | None = None) -> Pixels:
    """(n, rows, columns) patches about (n, 2) whole columns and rows, and so many pixels more on their sides."""
    side = WINDOW.side + before + (before if after is None else after)
    rows, columns = (size - side + 1 for size in pixels.shape)
    windows = np.lib.stride_tricks.as_strided(pixels, (rows, columns, side, side), 2 * pixels.strides)
    row = np.minimum(np.maximum(whole[:, 1] - WINDOW.half - before, 0), rows - 1)
    return np.asarray(windows[row, whole[:, 0] - WINDOW.half - before + MARGIN])


def _interpolations(part: Pixels) -> tuple[Pixels, Pixels]:
    """Matrices that interpolate at (n, 2) parts of a pixel: rows from their right, columns from their left.

    They are (n, WINDOW.side + 5, WINDOW.side) and (n, WINDOW.side, WINDOW.side + 5); small matrices are multiplied
    twice as fast where none is transposed.
    """
    # weights, times 12, of six neighbours at a part p of the way from the third to the fourth: by 1, p, p^2, p^3
    keys = [[0, 0, 12, 0, 0, 0], [1, -8, 0, 8, -1, 0], [-2, 15, -28, 20, -6, 1], [1, -7, 16, -16, 7, -1]]
    square = part * part
    powers = np.stack([np.ones_like(part), part, square, square * part], axis=-1).reshape(-1, 4)
    weights = (powers @ (np.array(keys, np.float32) / np.float32(12.0))).reshape(len(part), 2, 6)
    across = np.zeros((len(part), WINDOW.side + 5, WINDOW.side), np.float32)
    down = np.zeros((len(part), WINDOW.side, WINDOW.side + 5), np.float32)
    for matrices, taps in ((across.transpose(0, 2, 1), weights[:, 0]), (down, weights[:, 1])):
        one, row, column = matrices.strides
        bands = np.lib.stride_tricks.as_strided(matrices, (len(part), WINDOW.side, 6), (one, row + column, column))
        bands[:] = taps[:, None]
    return across, down


def levelled(patches: Pixels) -> tuple[Pixels, Pixels]:
    """Patches without their weighted means, taken out in place, and (n,) their weighted root mean squares."""
    patches -= (patches @ WINDOW.weights)[:, None]
    return patches, np.maximum(np.sqrt((patches * patches) @ WINDOW.weights), np.float32(TINY))
