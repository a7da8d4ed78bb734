"""Any projection to the strip: one `cv2.remap` of the region of interest, by maps that are made once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from compass.errors import ConfigError
from compass.images.decode import Image
from compass.images.projection import Flags, Floats, Projection
from compass.images.seen import Seen, Weights

# Of the strip, along an edge of what is seen: it is blurred, lenses and seams are dark there. Masked drives err as much
# with 1, by 1.15 times as much with 4 (docs/lab-notes/halves-and-doubles-2026-11-30.md).
BORDER_PX = 2


@dataclass(frozen=True, eq=False)
class Unwrapping:
    """How to make a strip from upright images of one size.

    Attributes
    ----------
    rows, columns : int
        Of the strip.
    top, row_height : float
        Elevation of its upper edge and height of one row, rad.
    cut : (slice, slice)
        Rows and columns of the image in which everything is that the strip shows.
    size : (int, int)
        Width and height to which they are reduced before they are remapped.
    maps : (rows * finer, columns * finer) arrays
        As `cv2.convertMaps` gives them.
    shown : (rows, columns) float32 array or None
        1 where the image shows anything, else 0; None: everywhere.
    """

    rows: int
    columns: int
    top: float
    row_height: float
    cut: tuple[slice, slice]
    size: tuple[int, int]
    maps: tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]
    shown: Weights | None

    @cached_property
    def _seen(self) -> dict[int, Seen]:
        return {}

    def seen(self, merged: int) -> Seen | None:
        """Which pixels of the strip show the world, `merged` rows of it in one of a smoothed strip; None: all."""
        if self.shown is None:
            return None
        return self._seen.setdefault(merged, Seen(self.shown, merged))

    def strip(self, grey: Image) -> Weights:
        """(rows, columns) strip of the grey image's part `cut`, contiguous and upright."""
        if (grey.shape[1], grey.shape[0]) != self.size:
            grey = cv2.resize(grey, self.size, interpolation=cv2.INTER_AREA)
        fine = cv2.remap(grey, *self.maps, interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        small = np.asarray(fine, np.float32)
        if small.shape == (self.rows, self.columns):
            return small
        return np.asarray(cv2.resize(small, (self.columns, self.rows), interpolation=cv2.INTER_AREA), np.float32)


@lru_cache(maxsize=4)
def unwrapping(
    projection: Projection, size: tuple[int, int], region: tuple[float, float], most_columns: int, most_rows: int
) -> Unwrapping:
    """Maps for upright images of a size (height, width).

    The strip has square pixels, no more of them than the image has, and only rows in which anything is seen.

    Parameters
    ----------
    region : (float, float)
        `roi_top` and `roi_bottom`.
    most_columns, most_rows : int
        Of the strip.

    Raises
    ------
    ConfigError
        The image shows nothing of the region of interest.
    """
    height, width = size
    round_circle = math.tau * projection.density(height, width)
    columns = 2 * max(int(min(most_columns, round_circle)) // 2, 2)
    finer_image = max(int(round_circle // columns), 1)  # whole pixels merged into one before the remapping
    finer = 1 if round_circle / columns / finer_image < 1.05 else 2
    upper, lower = (projection.elevation(part, height, width) for part in region)
    upper, lower = min(upper, 0.5 * math.pi), max(lower, -0.5 * math.pi)
    azimuth = -math.tau * ((np.arange(columns * finer) + 0.5) / (columns * finer) - 0.5)
    upper, lower = _seen_between(projection, azimuth, upper, lower, size)
    rows = max(min(round((upper - lower) * columns / math.tau), most_rows), 1)
    row_height = (upper - lower) / rows
    elevation = np.asarray(upper - row_height / finer * (np.arange(rows * finer) + 0.5), np.float64)
    x, y, shown = projection.locate(azimuth[None, :], elevation[:, None], height, width)
    if not shown.any():
        raise ConfigError(_nothing(projection, azimuth, size, region))
    cut, reduced, maps = _maps(x, y, shown, size, finer_image)
    everywhere = np.asarray(
        cv2.resize(shown.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA), np.float32
    )
    clear = _shrunk(everywhere > 1.0 - 1e-6)
    weights = None if clear.all() else clear.astype(np.float32)
    return Unwrapping(rows, columns, upper, row_height, cut, reduced, maps, weights)


def _seen_between(
    projection: Projection, azimuth: Floats, upper: float, lower: float, size: tuple[int, int]
) -> tuple[float, float]:
    """The part of the region of interest, elevations in rad, in which anything is seen at all."""
    elevation = np.linspace(upper, lower, 513, dtype=np.float64)
    seen = projection.locate(azimuth[None, ::4], elevation[:, None], *size)[2].any(axis=1)
    rows = np.flatnonzero(seen)
    return (float(elevation[rows[0]]), float(elevation[rows[-1]])) if rows.size else (upper, lower)


def _nothing(projection: Projection, azimuth: Floats, size: tuple[int, int], region: tuple[float, float]) -> str:
    """What is wrong where the region of interest shows nothing, and what to do."""
    asked = " .. ".join(f"{math.degrees(projection.elevation(part, *size)):.0f}" for part in region)
    elevation = np.radians(np.linspace(90.0, -90.0, 361))
    seen = np.flatnonzero(projection.locate(azimuth[None, ::4], elevation[:, None], *size)[2].any(axis=1))
    shows = "nothing at all: see to the circle's centre and radius"
    if seen.size:
        shows = " .. ".join(f"{math.degrees(elevation[row]):.0f}" for row in (seen[0], seen[-1])) + " deg of elevation"
    return (
        f"roi_top, roi_bottom: {region[0]:g} .. {region[1]:g} are {asked} deg of elevation, but images of {size[1]} x "
        f"{size[0]} pixels show {shows} (compass.projection, docs/cameras.md)"
    )


def _maps(
    x: Floats,
    y: Floats,
    shown: Flags,
    size: tuple[int, int],
    finer_image: int,
) -> tuple[tuple[slice, slice], tuple[int, int], tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]]:
    """The image's part that is needed, its size once reduced, and the maps into that."""
    spans = []
    for places, length in ((y[shown], size[0]), (x[shown], size[1])):
        first = max(int(places.min()) - 2 * finer_image, 0) // finer_image * finer_image
        last = min(int(places.max()) + 3 * finer_image, length)
        spans.append(slice(first, last))
    rows, columns = spans
    reduced = tuple(max((span.stop - span.start) // finer_image, 1) for span in (columns, rows))
    scale = [r / (span.stop - span.start) for r, span in zip(reduced, (columns, rows), strict=True)]
    across, down = (
        np.asarray((np.where(shown, places, span.start) - span.start + 0.5) * one - 0.5, np.float32)
        for places, span, one in ((x, columns, scale[0]), (y, rows, scale[1]))
    )
    maps = cv2.convertMaps(across, down, cv2.CV_16SC2)
    return (rows, columns), (reduced[0], reduced[1]), (np.asarray(maps[0], np.int16), np.asarray(maps[1], np.uint16))


def _shrunk(clear: Flags) -> Flags:
    """`clear` without `BORDER_PX` along its edges, round the circle."""
    if clear.all():
        return clear
    by = BORDER_PX
    around = np.take(clear.astype(np.uint8), np.arange(-by, clear.shape[1] + by), axis=1, mode="wrap")
    kernel = np.ones((2 * by + 1, 2 * by + 1), np.uint8)
    return np.asarray(cv2.erode(np.ascontiguousarray(around), kernel)[:, by:-by] > 0)
