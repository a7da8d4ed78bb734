"""The grid of rays that is painted, and how a panorama is made from it.

Painted images are stored by columns, shape (columns, rows): a solid's side is one distance per column, so columns are
what is worked along. Columns are twice as fine as the panorama's. Rows are twice as fine inside the band, and coarse
above and below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from fusion.simulation.surfaces import Array
from fusion.simulation.world import Floats

COARSE = 4  # fine rows in a coarse one
STEEPEST = np.deg2rad(87.0)  # near the poles, where the tangent has no end
_GRID = 8  # pixels between which the tilt's shift is interpolated
# Of the lens: reaches 0.7 % at 1.5 times Nyquist's frequency, so that hardly anything folds back in the shrinking.
_LOW_PASS = np.array([1.0, 5.0, 10.0, 10.0, 5.0, 1.0]) / 32.0
_BEFORE, _AFTER = 2, 3  # lines that it needs beyond the first and the last of a pair


@dataclass(frozen=True)
class Raster:
    """The painted grid of a panorama of `width` x `height` px with a fine `band` (fractions of height)."""

    width: int
    height: int
    band: tuple[float, float]

    @property
    def columns(self) -> int:
        """Painted columns."""
        return 2 * self.width

    @property
    def step(self) -> float:
        """Angle between painted columns, and between fine rows of a full panorama of 2:1, rad."""
        return 2.0 * np.pi / self.columns

    @cached_property
    def _limits(self) -> tuple[int, int]:
        """First fine row and the one after the last, counted in fine rows from the zenith."""
        top, bottom = (COARSE * round(2.0 * self.height * edge / COARSE) for edge in self.band)
        return top, bottom

    @cached_property
    def edges(self) -> Floats:
        """Edges of the painted rows in fine rows from the zenith."""
        top, bottom = self._limits
        above = np.arange(0.0, top, COARSE)
        below = np.arange(bottom + COARSE, 2.0 * self.height, COARSE)
        return np.concatenate([above, np.arange(top, bottom + 1.0), below, [2.0 * self.height]])

    @cached_property
    def elevation(self) -> Floats:
        """Elevation of the rows' centres, rad, falling."""
        centres = (self.edges[1:] + self.edges[:-1]) / 2.0
        return np.asarray(np.pi / 2.0 - np.pi * centres / (2.0 * self.height), np.float64)

    @cached_property
    def edge_tangent(self) -> Floats:
        """Tangent of the elevation at the rows' edges, falling."""
        return np.tan(np.clip(np.pi / 2.0 - np.pi * self.edges / (2.0 * self.height), -STEEPEST, STEEPEST))

    def finish(self, painted: Array) -> Array:
        """Low-pass and shrink to the panorama, shape (height, width)."""
        top, bottom = self._limits
        above = top // COARSE
        below = above + bottom - top
        fine = painted[:, above:below]
        fine = np.concatenate([*_BEFORE * [fine[:, :1]], fine, *_AFTER * [fine[:, -1:]]], axis=1)
        image = np.empty((self.height, self.width), np.float32)
        image[top // 2 : bottom // 2] = _shrunk(_wrapped(fine)).T
        centres = (self.edges[1:] + self.edges[:-1]) / 2.0
        for part, rows in (
            (slice(0, top // 2), slice(0, above + 1)),
            (slice(bottom // 2, self.height), slice(below - 1, centres.size)),
        ):
            coarse = np.ascontiguousarray(_halved(_wrapped(painted[:, rows])).T)
            place = np.interp(2.0 * np.arange(part.start, part.stop) + 1.0, centres[rows], np.arange(len(coarse)))
            before = np.minimum(place.astype(np.intp), len(coarse) - 2)
            share = (place - before).astype(np.float32)[:, None]
            image[part] = coarse[before] + share * (coarse[before + 1] - coarse[before])
        return image

    def tilted(self, painted: Array, pitch: float, roll: float) -> Array:
        """What a camera pitched (nose down positive) and rolled sees, from what a level one sees; same layout."""
        columns = np.arange(-_GRID, self.columns + 2 * _GRID, _GRID, dtype=np.float64)[:, None]
        azimuth = np.pi - (columns + 0.5) * self.step
        rows = np.arange(-_GRID / 2.0, self.edges.size + _GRID, _GRID / 2.0)
        centres = np.arange(self.elevation.size) + 0.0
        elevation = np.interp(rows, centres, self.elevation)[None, :]
        x, y, z = _turn(elevation, azimuth, pitch, roll)
        turned = (np.arctan2(y, x) - azimuth + np.pi) % (2.0 * np.pi) - np.pi
        raised = np.arcsin(np.clip(z, -1.0, 1.0)) - elevation
        per_rad = 2.0 * self.height / np.pi
        column = self._spread(turned / -self.step)
        column += np.arange(self.columns, dtype=np.float32)[:, None]
        fine = self._spread(raised * -per_rad)
        fine += ((np.pi / 2.0 - self.elevation) * per_rad).astype(np.float32)
        top, bottom = (np.float32(limit) for limit in self._limits)
        row = np.maximum(fine - bottom, np.float32(0.0))
        row += np.minimum(fine, top)
        row *= np.float32(1.0 / COARSE)
        row -= np.float32(0.5)
        fine -= top
        np.maximum(fine, np.float32(0.0), out=fine)
        row += np.minimum(fine, bottom - top, out=fine)
        turns = column * np.float32(1.0 / self.columns)
        column -= np.floor(turns, out=turns) * np.float32(self.columns)
        pad = 4
        column += np.float32(pad)
        wide = cv2.copyMakeBorder(painted, pad, pad, 0, 0, cv2.BORDER_WRAP)
        return np.asarray(cv2.remap(wide, row, column, cv2.INTER_CUBIC), np.float32)

    @cached_property
    def _places(self) -> tuple[Array, Array]:
        """Where in the coarse grid of `_spread` each painted pixel lies: row and column, in its cells."""
        y = (np.arange(self.columns, dtype=np.float32) / _GRID + 1.0)[:, None]
        x = (np.arange(self.elevation.size, dtype=np.float32) * 2.0 / _GRID + 1.0)[None, :]
        y, x = np.broadcast_arrays(y, x)
        return np.ascontiguousarray(x), np.ascontiguousarray(y)

    def _spread(self, coarse: Floats) -> Array:
        """Interpolate a smooth quantity, given every `_GRID` columns and half as many rows, at every painted pixel."""
        return np.asarray(cv2.remap(coarse.astype(np.float32), *self._places, cv2.INTER_LINEAR), np.float32)


def _wrapped(painted: Array) -> Array:
    """Painted columns once round, and those before and after that the low-pass needs."""
    return np.concatenate([painted[-_BEFORE:], painted, painted[:_AFTER]])


def _halved(lines: Array) -> Array:
    """Low-pass along the first axis and take every second line; those before and after are for the filter alone."""
    smooth = cv2.sepFilter2D(lines, -1, np.ones(1), _LOW_PASS, anchor=(0, _BEFORE))
    return np.asarray(smooth[_BEFORE:-_AFTER:2], np.float32)


def _shrunk(painted: Array) -> Array:
    """`_halved` along both axes: the mean of two neighbours and then OpenCV's pyramid, five taps, are its six."""
    pairs = cv2.blur(painted, (2, 2), anchor=(0, 0))
    count = (painted.shape[0] - _BEFORE - _AFTER) // 2, (painted.shape[1] - _BEFORE - _AFTER) // 2
    return np.asarray(cv2.pyrDown(pairs)[1 : 1 + count[0], 1 : 1 + count[1]], np.float32)


def _turn(elevation: Floats, azimuth: Floats, pitch: float, roll: float) -> tuple[Floats, Floats, Floats]:
    """Directions of the tilted camera in the level frame of the same heading: Ry(pitch) Rx(roll) ray."""
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    z = np.sin(elevation) + 0.0 * azimuth
    y, z = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    return x * np.cos(pitch) + z * np.sin(pitch), y, z * np.cos(pitch) - x * np.sin(pitch)
