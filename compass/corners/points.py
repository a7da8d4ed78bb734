"""Corners of a keyframe: where they are, what surrounds them, and how well a shift of that can be told."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from compass.corners.picture import HALF, MARGIN, Picture
from compass.strip import Pixels

Floats = npt.NDArray[np.floating]

SECTORS, PER_SECTOR = 32, 7  # corners are spread over the circle: the strongest of each sector
WEAKEST = 3e-3  # smaller eigenvalue of a corner, of that of the strongest
FLAT = 1e-2  # grey values^2 per pixel^2: keeps what has no gradient finite
_OFFSETS = np.arange(-HALF, HALF + 1, dtype=np.float32)
ACROSS, DOWN = (one.ravel() for one in np.meshgrid(_OFFSETS, _OFFSETS))
WINDOW = np.exp(-(ACROSS**2 + DOWN**2) / (2.0 * (0.6 * HALF) ** 2))
WINDOW /= WINDOW.sum()


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
        Where, from the middle, the texture is that tells the shift, pixels: a patch that grows moves as that does.
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
    strength = cv2.cornerMinEigenVal(half, HALF, ksize=3)
    peak = strength >= cv2.dilate(strength, np.ones((3, 3), np.uint8))
    row, column = np.nonzero(peak)
    at = np.stack([2.0 * column + 0.5 - MARGIN, 2.0 * row + 0.5], axis=1).astype(np.float32)
    inside = (at[:, 0] >= 0.0) & (at[:, 0] < picture.columns) & (at[:, 1] > HALF) & (at[:, 1] < picture.rows - HALF - 1)
    if picture.clear is not None:
        inside &= picture.clear[row.astype(np.intp) * 2, (at[:, 0].astype(np.intp)) % picture.columns]
    at, strong = at[inside], strength[row, column][inside]
    if not at.size:
        return at
    order = np.argsort(-strong)
    order = order[strong[order] > WEAKEST * strong[order[0]]]
    sector = (at[order, 0] * (SECTORS / picture.columns)).astype(np.intp)
    grouped = np.argsort(sector, kind="stable")
    first = np.searchsorted(sector[grouped], sector[grouped])
    return at[order[grouped[np.arange(grouped.size) - first < PER_SECTOR]]]


def cut_patches(picture: Picture, at: Pixels) -> Patches:
    """What surrounds corners at (n, 2) columns and rows of the strip."""
    values, contrast = levelled(sample(picture.soft, at))
    right, down = (sample(cv2.Sobel(picture.soft, cv2.CV_32F, *axes, ksize=1, scale=0.5), at) for axes in ((1, 0), (0, 1)))
    slopes = np.stack([right, down], axis=1)
    growing = right * ACROSS + down * DOWN
    # a change of brightness or contrast is no shift: both are taken out of the slopes
    slopes -= (slopes @ WINDOW)[..., None]
    like = (slopes @ (values * WINDOW)[..., None])[..., 0] / (contrast**2)[:, None]
    slopes -= like[..., None] * values[:, None]
    weighed = slopes * WINDOW
    information = weighed @ slopes.transpose(0, 2, 1) + np.float32(FLAT) * np.eye(2, dtype=np.float32)
    inverse = np.linalg.inv(information)
    answer = inverse @ weighed
    centre = (answer @ growing[..., None])[..., 0]
    return Patches(at, values, contrast, answer, inverse[:, [0, 0, 1], [0, 1, 1]], centre)


def sample(pixels: Pixels, at: Pixels) -> Pixels:
    """(n, pixels) grey values about (n, 2) columns and rows of the strip, interpolated by a cubic."""
    column, row = at[:, :1] + (ACROSS + np.float32(MARGIN)), at[:, 1:] + DOWN
    return np.asarray(cv2.remap(pixels, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.float32)


def levelled(patches: Pixels) -> tuple[Pixels, Pixels]:
    """Patches without their weighted means, and (n,) their weighted root mean squares."""
    patches = patches - (patches @ WINDOW)[:, None]
    return patches, np.sqrt((patches * patches) @ WINDOW) + np.float32(1e-3)
