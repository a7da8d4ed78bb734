"""Textures that can be looked up at any size without aliasing: pyramids, blended between their levels.

A sub-pixel measurement on a simulated frame means something only if the frame is band limited. So every texture is kept
at halved and halved again resolutions (Williams 1983, doi:10.1145/964967.801126), and what a camera pixel gets is
interpolated in the two levels next to its footprint on the surface.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulation.materials import Image

Array = npt.NDArray[np.float32]
Levels = npt.NDArray[np.float64]

_PAD = 3  # texels of border around each level, for the interpolation
_SEAM = 2  # texels that a level surface repeats after its last: one for the interpolation, one for rounding
_KERNEL = np.array([1.0, 3.0, 3.0, 1.0], np.float32) / 8.0


def halve(image: Image, wrap_rows: bool) -> Image:
    """Half the size, low-passed; columns go round, rows do if `wrap_rows`."""
    padded = cv2.copyMakeBorder(image, 0, 0, 2, 2, cv2.BORDER_WRAP)
    padded = cv2.copyMakeBorder(padded, 2, 2, 0, 0, cv2.BORDER_WRAP if wrap_rows else cv2.BORDER_REPLICATE)
    smooth = cv2.sepFilter2D(padded, -1, _KERNEL, _KERNEL, anchor=(1, 1))
    return np.ascontiguousarray(smooth[2:-2:2, 2:-2:2])


def pyramid(image: Image, wrap_rows: bool) -> list[Image]:
    """`image`, its size rounded so that it can be halved evenly, and its halves down to a few texels."""
    halvings = int(np.clip(np.log2(min(image.shape) / 3.0), 0, 7))
    block = 2**halvings
    rows, columns = (max(1, round(n / block)) * block for n in image.shape)
    levels = [cv2.resize(image, (columns, rows), interpolation=cv2.INTER_LINEAR).astype(np.float32)]
    for _ in range(halvings):
        levels.append(halve(levels[-1], wrap_rows))
    return levels


class Skin:
    """Texture of an upright surface, wrapped round it; `u` runs to the right seen from outside, `v` down.

    Parameters
    ----------
    image : ndarray, shape (rows, columns), float32
        Grey 0..255.
    width, height : float
        What it covers, m. Beyond `width` it repeats.
    """

    def __init__(self, image: Image, width: float, height: float) -> None:
        levels = pyramid(image, wrap_rows=False)
        rows, columns = levels[0].shape
        self.width, self.height = width, height
        self.per_metre_u, self.per_metre_v = columns / width, rows / height
        self.top_level = len(levels) - 1
        # All levels in one image, so that one call serves pixels of different levels: the finest on the left, the
        # others below one another on the right. Transposed, because the camera works column by column.
        self._first_v = np.array([_PAD] + [rows + 3 * _PAD] * self.top_level, np.float32)
        lengths = np.array([level.shape[1] + 2 * _PAD for level in levels[1:]])
        self._first_u = np.append(_PAD, _PAD + np.cumsum(lengths) - lengths).astype(np.float32)
        self._last_v = self._first_v + np.array([level.shape[0] for level in levels], np.float32) - 1.0
        width_v = rows + 2 * _PAD + (levels[1].shape[0] + 2 * _PAD if self.top_level else 0)
        self._atlas = np.zeros((max(columns + 2 * _PAD, int(lengths.sum())), width_v), np.float32)
        for level, u, v in zip(levels, self._first_u.astype(int), self._first_v.astype(int), strict=True):
            padded = cv2.copyMakeBorder(level.T, 0, 0, _PAD, _PAD, cv2.BORDER_REPLICATE)
            padded = cv2.copyMakeBorder(padded, _PAD, _PAD, 0, 0, cv2.BORDER_WRAP)
            self._atlas[u - _PAD : u - _PAD + padded.shape[0], v - _PAD : v - _PAD + padded.shape[1]] = padded

    def level(self, footprint_u: Levels, footprint_v: Levels) -> Levels:
        """The level whose texel is as large as a pixel's footprint, given in m."""
        texels = np.maximum(footprint_u * self.per_metre_u, footprint_v * self.per_metre_v)
        return np.asarray(np.minimum(np.log2(np.maximum(texels, 1.0)), self.top_level), np.float64)

    def sample(self, u: Levels, v: float, slope: Levels, tangent: Array, level: Levels) -> Array:
        """Grey of a block of pixels, shape (columns, rows).

        Parameters
        ----------
        v : float
            Depth below its top at elevation 0, m.
        u, slope, level : ndarray, shape (columns,)
            Position along the surface, m; change of `v` with the tangent of the elevation; level of the pyramid.
        tangent : ndarray, shape (rows,)
            Tangent of each row's elevation.
        """
        low = level.astype(np.intp)
        mix = (level - low).astype(np.float32)[:, None]
        grey = self._fetch(u, v, slope, tangent, low)
        if not mix.any():
            return grey
        finer = self._fetch(u, v, slope, tangent, np.minimum(low + 1, self.top_level))
        finer -= grey
        finer *= mix
        grey += finer
        return grey

    def _fetch(self, u: Levels, v: float, slope: Levels, tangent: Array, level: npt.NDArray[np.intp]) -> Array:
        """Bilinear look-up in one level per column."""
        scale = 0.5**level
        down = scale * self.per_metre_v
        first = self._first_v[level]
        across = (u % self.width) * self.per_metre_u * scale + (self._first_u[level] - 0.5)
        y = np.repeat(across.astype(np.float32)[:, None], tangent.size, axis=1)
        x = (slope * down).astype(np.float32)[:, None] * tangent
        x += (v * down + (first - 0.5)).astype(np.float32)[:, None]
        least, most = first - 1.0, self._last_v[level] + 1.0
        if np.any(x[:, 0] < least) or np.any(x[:, -1] > most):  # it grows downwards
            np.maximum(x, least[:, None], out=x)
            np.minimum(x, most[:, None], out=x)
        return np.asarray(cv2.remap(self._atlas, x, y, cv2.INTER_LINEAR), np.float32)


class Ground:
    """Texture of a level surface, repeating every `size` m in x and y.

    Parameters
    ----------
    image : ndarray, shape (n, n), float32
        Grey 0..255; its first column lies at x = 0, its first row at y = 0, the origin in a corner.
    size : float
        Side of the square it covers, m.
    """

    def __init__(self, image: Image, size: float) -> None:
        levels = pyramid(image, wrap_rows=True)
        self.per_metre = levels[0].shape[0] / size
        self.size = size
        self.top_level = len(levels) - 1
        self._levels = [cv2.copyMakeBorder(level, 0, _SEAM, 0, _SEAM, cv2.BORDER_WRAP) for level in levels]

    def level(self, footprint: Levels) -> Levels:
        """The level whose texel is as large as a pixel's footprint, given in m."""
        texels = footprint * self.per_metre
        return np.asarray(np.minimum(np.log2(np.maximum(texels, 1.0)), self.top_level), np.float64)

    def sample(self, start: tuple[float, float], cos: Levels, sin: Levels, distance: Levels, level: Levels) -> Array:
        """Grey of a block of pixels, shape (columns, rows).

        Parameters
        ----------
        start : tuple of float
            Where all rays start, x and y, m.
        cos, sin : ndarray, shape (columns,)
            Of the rays' azimuths.
        distance, level : ndarray, shape (rows,)
            How far the rays go, m, and their levels. A row keeps its level as long as the camera keeps its height, so
            the nearest level serves: no jumps in time.
        """
        nearest = np.rint(level).astype(np.intp)
        texels = (self.size * self.per_metre * 0.5**nearest).astype(np.float32)
        per_turn = (distance / self.size).astype(np.float32)
        u, v = (
            _texels(ray.astype(np.float32)[:, None] * per_turn, at / self.size - 0.5 / texels, texels)
            for ray, at in zip((cos, sin), start, strict=True)
        )
        grey = np.empty_like(u)
        changes = [0, *(np.flatnonzero(nearest[1:] != nearest[:-1]) + 1).tolist(), nearest.size]
        for first, end in pairwise(changes):
            part = (slice(None), slice(first, end))
            grey[part] = cv2.remap(self._levels[nearest[first]], u[part], v[part], cv2.INTER_LINEAR)
        return grey


def _texels(turns: Array, offset: Levels, texels: Array) -> Array:
    """From turns round a texture, and an `offset`, to its texels, 0..`texels`; in place.

    Ten times as fast as to leave the wrapping to OpenCV.
    """
    turns += offset.astype(np.float32)
    turns -= np.floor(turns)
    turns *= texels
    return turns


class Sky:
    """What is too far away to move with the robot: a panorama over all azimuths, from the zenith to below the horizon.

    Parameters
    ----------
    image : ndarray, shape (rows, columns), float32
        Columns go round counter-clockwise from azimuth 0, rows go down from elevation 90 deg to `lowest`.
    lowest : float
        Elevation of the lower edge, rad.
    """

    def __init__(self, image: Image, lowest: float) -> None:
        self._image = np.ascontiguousarray(cv2.copyMakeBorder(image.T, _PAD, _PAD, 0, 0, cv2.BORDER_WRAP))
        self._columns = image.shape[1]
        self._per_rad = image.shape[0] / (np.pi / 2.0 - lowest)

    def sample(self, azimuth: npt.NDArray[np.floating[Any]], elevation: Levels) -> Array:
        """Grey of a block, shape (azimuths, elevations); angles in rad."""
        turns = (azimuth / (2.0 * np.pi)) % 1.0
        y = np.repeat((turns * self._columns + _PAD - 0.5).astype(np.float32)[:, None], elevation.size, axis=1)
        row = ((np.pi / 2.0 - elevation) * self._per_rad - 0.5).astype(np.float32)
        x = np.repeat(row[None, :], azimuth.size, axis=0)
        return np.asarray(cv2.remap(self._image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
