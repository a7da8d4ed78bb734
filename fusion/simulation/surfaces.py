"""Textures that can be looked up at any size without aliasing: pyramids, blended between their levels.

A sub-pixel measurement on a simulated frame means something only if the frame is band limited. So every texture is kept
at halved and halved again resolutions (Williams 1983, doi:10.1145/964967.801126), and what a camera pixel gets is
interpolated in the two levels next to its footprint on the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulation.materials import Image

Array = npt.NDArray[np.float32]
Levels = npt.NDArray[np.float64]

_PAD = 3  # texels of border around each level, for the interpolation
_MOST_LEVELS = 8  # of a pyramid
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
    halvings = int(np.clip(np.log2(min(image.shape) / 3.0), 0, _MOST_LEVELS - 1))
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
        per_metre_u, per_metre_v, top_level = columns / width, rows / height, len(levels) - 1
        # All levels in one image, so that one call serves pixels of different levels: the finest on the left, the
        # others below one another on the right. Transposed, because the camera works column by column.
        first_v = np.array([_PAD] + [rows + 3 * _PAD] * top_level, np.float32)
        lengths = np.array([level.shape[1] + 2 * _PAD for level in levels[1:]])
        first_u = np.append(_PAD, _PAD + np.cumsum(lengths) - lengths).astype(np.float32)
        last_v = first_v + np.array([level.shape[0] for level in levels], np.float32) - 1.0
        width_v = rows + 2 * _PAD + (levels[1].shape[0] + 2 * _PAD if top_level else 0)
        self._atlas = np.zeros((max(columns + 2 * _PAD, int(lengths.sum())), width_v), np.float32)
        for level, u, v in zip(levels, first_u.astype(int), first_v.astype(int), strict=True):
            padded = cv2.copyMakeBorder(level.T, 0, 0, _PAD, _PAD, cv2.BORDER_REPLICATE)
            padded = cv2.copyMakeBorder(padded, _PAD, _PAD, 0, 0, cv2.BORDER_WRAP)
            self._atlas[u - _PAD : u - _PAD + padded.shape[0], v - _PAD : v - _PAD + padded.shape[1]] = padded
        # What `lookups` asks of it: a row of numbers, so that those of many skins are one array.
        self.numbers = np.zeros(4 + 3 * _MOST_LEVELS)
        self.numbers[:4] = per_metre_u, per_metre_v, width, top_level
        for place, values in enumerate((first_u, first_v, last_v)):
            self.numbers[4 + place * _MOST_LEVELS :][: values.size] = values

    def sample(self, lookup: Array, mix: Array, tangent: Array) -> Array:
        """Grey of a block of pixels, shape (columns, rows).

        Parameters
        ----------
        lookup : ndarray, shape (2, 5, columns)
            See `lookups`.
        mix : ndarray, shape (columns,)
            Weight of the second level.
        tangent : ndarray, shape (rows,)
            Tangent of each row's elevation, falling.
        """
        grey = self._fetch(lookup[0], tangent)
        if mix.any():
            coarser = self._fetch(lookup[1], tangent)
            coarser -= grey
            coarser *= mix[:, None]
            grey += coarser
        return grey

    def _fetch(self, lookup: Array, tangent: Array) -> Array:
        """Bilinear look-up in one level per column."""
        across, slope, offset, least, most = lookup
        y = np.repeat(across[:, None], tangent.size, axis=1)
        x = slope[:, None] * tangent
        x += offset[:, None]
        if np.any(x[:, 0] < least) or np.any(x[:, -1] > most):  # it grows downwards
            np.maximum(x, least[:, None], out=x)
            np.minimum(x, most[:, None], out=x)
        return np.asarray(cv2.remap(self._atlas, x, y, cv2.INTER_LINEAR), np.float32)


def lookups(
    skins: Sequence[Skin],
    owner: npt.NDArray[np.intp],
    u: Levels,
    depth: Levels,
    near: Levels,
    footprint: tuple[Levels, Levels],
) -> tuple[Array, Array]:
    """Where in their atlases columns of many skins are looked up: all at once, as most skins are a few columns wide.

    Parameters
    ----------
    skins : sequence of Skin
        All that are seen.
    owner : ndarray, shape (columns,)
        Number of each column's skin.
    u, depth, near : ndarray, shape (columns,)
        Position along the surface, depth below its top at elevation 0, and horizontal distance, m.
    footprint : tuple of ndarray
        What a pixel covers of the surface along it and down, m.

    Returns
    -------
    lookup : ndarray of float32, shape (2, 5, columns)
        In the two levels next to the footprint: place across, change of the place down with the tangent of the
        elevation, place down at elevation 0, and its least and greatest; texels.
    mix : ndarray of float32, shape (columns,)
        Weight of the second level, 0..1.
    """
    numbers = np.stack([skin.numbers for skin in skins])
    per_metre_u, per_metre_v, width, top = numbers[owner, :4].T
    texels = np.maximum(footprint[0] * per_metre_u, footprint[1] * per_metre_v)
    level = np.minimum(np.log2(np.maximum(texels, 1.0)), top)
    low = level.astype(np.intp)
    lookup = np.empty((2, 5, owner.size), np.float32)
    for which, one in enumerate((low, np.minimum(low + 1, top.astype(np.intp)))):
        first_u, first_v, last_v = (numbers[owner, 4 + place * _MOST_LEVELS + one] for place in range(3))
        scale = 0.5**one
        down = per_metre_v * scale
        lookup[which] = (
            (u % width) * per_metre_u * scale + (first_u - 0.5),
            -near * down,
            depth * down + (first_v - 0.5),
            first_v - 1.0,
            last_v + 1.0,
        )
    return lookup, (level - low).astype(np.float32)


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
