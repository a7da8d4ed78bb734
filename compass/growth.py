"""How much each part of the panorama grew, and how the camera tilted: what moved up and down.

A point at elevation e that comes nearer rises by ``rho cos(a - phi) sin(e) cos(e)`` while it is pushed aside by
``-rho sin(a - phi)``, where ``rho = step / distance`` and ``phi`` is the direction of travel. The growth of a sector,
``rho cos(a - phi)``, is therefore a second look at the parallax that `parallax` has to take out, and turning has no
part in it. A tilt moves everything up on one side and down on the other, near and far alike, at the horizon too, where
nothing grows: there it is read off first.

Both by least squares on the image gradient (Lucas and Kanade 1981), once the columns have been brought over each other.
A gradient tells small motions only: what rises by more than a row seems to rise by less. So the rows are brought back
by what was found (see `risen`), and what is left is measured anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from compass.correlation import Floats
from compass.local import SectorShifts, sector_sums, sector_windows
from compass.risen import Risen
from compass.strip import Pixels, Strip

HORIZON = np.deg2rad(6.0)  # elevations between which a tilt is read off
FEWEST_ROWS = 6  # in that band, and thrice as many in all
CORRELATED_PIXELS = 4.0  # that share their error
TILT_FLOOR_PX = 0.05  # what a sector's reading of the tilt cannot be better than, columns
TILT_OUTLIER = 2.0  # deviations from where on a sector has less to say about the tilt
TILT_ROUNDS = 3
RIDGE = 1e-3
STEEP = 0.14  # of what a growth lifts a row by; rows that are lifted by more count for less

# how the grey values of a sector can change: rows and columns of its normal matrix
SHIFT, GAIN, GROWTH, RISE, SHEAR = range(5)


@dataclass(frozen=True, slots=True)
class Growth:
    """What moved up and down, per sector of a full circle.

    Attributes
    ----------
    growth_px : (sectors,) array
        Step over distance times the cosine between sector and direction of travel, columns (1 rad is columns / 2 pi).
    sigma_px : (sectors,) array
        Its standard deviation from image noise.
    aside_px : (sectors,) array
        How far growth and tilt made the sector seem to move to the right, columns.
    tilt : (2,) array
        Rotation of the scene about x and y of the camera, rad; the camera's own is the opposite.
    """

    growth_px: Floats
    sigma_px: Floats
    aside_px: Floats
    tilt: Floats

    def risen(self, sectors: SectorShifts, columns: int) -> Risen:
        """How far up each column of the current strip has moved: sectors lie where they were, plus their shift."""
        count = self.growth_px.size
        centre = columns / count * np.arange(count)
        now = centre + np.interp(centre, sectors.centre_px, sectors.shift_px, period=columns)
        rise, _ = _by_tilt(self.tilt, *_bearings(count, columns))
        growth, up = (np.interp(np.arange(columns), now, values, period=columns) for values in (self.growth_px, rise))
        return Risen(growth, up)


@dataclass(frozen=True, slots=True, eq=False)
class _Gradients:
    """What a keyframe is asked for with every image."""

    count: int
    per_circle: float
    area: float  # pixels of one row in a sector that err independently
    changes: Pixels  # (5, rows, columns): SHIFT..SHEAR, by which the grey values change per column of motion
    normal: Floats  # (sectors, 5, 5)
    inverse: Floats  # (sectors, 3, 3), of SHIFT..GROWTH
    weight: Pixels  # (rows, 1), by which these changes are multiplied, and others have to be
    slant: Floats  # (3, sectors), how far aside GROWTH..SHEAR seem to move a sector to which all rows count alike
    band: slice  # rows about the horizon
    band_inverse: Floats  # (sectors, 4, 4), of SHIFT..RISE there

    def in_common(self, change: Pixels, kinds: int, rows: slice) -> tuple[Floats, Floats]:
        """(sectors, kinds) products of a change of grey values with the known ones, and (sectors,) with itself."""
        change = change[rows]
        products = np.empty((kinds + 1, change.shape[1]), np.float32)
        np.einsum("irx,rx->ix", self.changes[:kinds, rows], change, out=products[:kinds])
        np.einsum("rx,rx->x", change, change, out=products[kinds])
        sums = sector_sums(products, self.count, self.per_circle).T.astype(np.float64)
        return sums[:, :kinds], sums[:, kinds]


def measure_growth(
    reference: Strip,
    current: Strip,
    sectors: SectorShifts,
    count: int,
    per_circle: float,
    before: Growth | None = None,
) -> Growth | None:
    """Growth of each sector and the tilt between two strips.

    Parameters
    ----------
    sectors : SectorShifts
        Where each sector lies now.
    count, per_circle : int, float
        Number and width of the sectors, as in `local_shifts`.
    before : Growth, optional
        What was found before, by which the rows of `current` have been brought back (`Strip.risen`).

    Returns
    -------
    Growth or None
        None where the strip does not show the horizon and enough above it.
    """
    keyframe = _gradients(reference, count, per_circle)
    if keyframe is None:
        return None
    columns, stride = reference.softened.shape[1], reference.column_stride
    change = keyframe.weight * (_brought_over(current.softened, sectors, stride) - reference.softened)
    sine, cosine = _bearings(count, columns)
    answered = np.zeros(count, bool)
    answered[np.round(sectors.centre_px / stride * count / columns).astype(np.intp) % count] = True
    tilt = _tilt(keyframe, change, answered, np.stack([sine, -cosine], axis=1))
    by_tilt = np.stack(_by_tilt(tilt, sine, cosine), axis=1)
    if before is not None:  # its rise is undone, its shear is not
        tilt = tilt + before.tilt
        by_tilt[:, 1] = _by_tilt(tilt, sine, cosine)[1]

    products, energy = keyframe.in_common(change, 5, slice(None))
    rest = products[:, :RISE] - np.einsum("kij,kj->ki", keyframe.normal[:, :RISE, RISE:], by_tilt)
    solution = np.einsum("kij,kj->ki", keyframe.inverse, rest)
    left = (
        energy
        - np.einsum("ki,ki->k", solution, products[:, :RISE])
        - np.einsum("ki,ki->k", by_tilt, products[:, RISE:])
    )
    variance = np.maximum(left, 1e-3) / (keyframe.area * len(change)) * keyframe.inverse[:, GROWTH, GROWTH]
    # where edges slant, what rises seems to move aside: the shifts were found as if nothing (more) rose
    moved = np.column_stack([solution[:, GROWTH], by_tilt])
    aside = -np.einsum("ik,ki->k", keyframe.slant, moved)
    growth = stride * solution[:, GROWTH] + (0.0 if before is None else before.growth_px)
    return Growth(growth, stride * np.sqrt(variance), stride * aside, tilt)


def _bearings(count: int, columns: int) -> tuple[Floats, Floats]:
    """Sine and cosine of the azimuth of each sector, times the columns that one radian is."""
    azimuth = -np.pi * (2.0 * np.arange(count) / count - 1.0)
    return columns / (2.0 * np.pi) * np.sin(azimuth), columns / (2.0 * np.pi) * np.cos(azimuth)


def _by_tilt(tilt: Floats, sine: Floats, cosine: Floats) -> tuple[Floats, Floats]:
    """(sectors,) how far a tilt moves each sector up, and aside at an elevation whose tangent is one, columns."""
    return sine * tilt[0] - cosine * tilt[1], -cosine * tilt[0] - sine * tilt[1]


def _tilt(keyframe: _Gradients, change: Pixels, answered: npt.NDArray[np.bool_], design: Floats) -> Floats:
    """Rotation of the scene about x and y, rad, from how much each sector rose at the horizon: by ``design @ tilt``."""
    products, energy = keyframe.in_common(change, 4, keyframe.band)
    solution = np.einsum("kij,kj->ki", keyframe.band_inverse, products)
    left = energy - np.einsum("ki,ki->k", solution, products)
    pixels = keyframe.area * (keyframe.band.stop - keyframe.band.start)
    variance = np.maximum(left, 1e-3) / pixels * keyframe.band_inverse[:, RISE, RISE] + TILT_FLOOR_PX**2
    rise, (x, y), tilt = solution[:, RISE], design.T, np.zeros(2)
    squares = np.stack([x * x, x * y, y * y, x * rise, y * rise])
    for _ in range(TILT_ROUNDS):
        apart = (rise - design @ tilt) ** 2 / variance
        xx, xy, yy, xr, yr = squares @ (answered / variance / (1.0 + apart / TILT_OUTLIER**2))
        xx, yy = xx + 1e-3, yy + 1e-3
        tilt = np.array([yy * xr - xy * yr, xx * yr - xy * xr]) / (xx * yy - xy * xy)
    return tilt


@lru_cache(maxsize=4)
def _gradients(strip: Strip, count: int, per_circle: float) -> _Gradients | None:
    """Gradients of a strip, weighted by all that can move it; None without a horizon."""
    soft, elevation = strip.softened, strip.elevations
    band = np.flatnonzero(np.abs(elevation) < HORIZON)
    if band.size < FEWEST_ROWS or elevation.size < 3 * FEWEST_ROWS:
        return None
    columns = soft.shape[1]
    per_row = float(elevation[0] - elevation[-1]) / (elevation.size - 1) * columns / (2.0 * np.pi)
    padded = np.asarray(cv2.copyMakeBorder(soft, 2, 2, 0, 0, cv2.BORDER_REPLICATE), np.float32)
    rise = (8.0 * (padded[3:-1] - padded[1:-3]) - padded[4:] + padded[:-4]) / np.float32(12.0 * per_row)  # five points
    right = 0.5 * (np.roll(soft, -1, axis=1) - np.roll(soft, 1, axis=1))
    e = elevation.astype(np.float32)[:, None]
    lifted = np.sin(e) * np.cos(e)
    # floor and ceiling move by more than what stands on them: by squares of `lifted` they would count for most, but not
    # in the shift of their sector
    weight = 1.0 / np.sqrt(np.abs(lifted) + np.float32(STEEP))
    weight /= np.sqrt(np.mean(weight**2))
    weight[[0, -1]] = 0.0
    changes = np.stack([right, soft, rise * lifted, rise, right * np.tan(e)])
    moved = changes[[SHIFT, GROWTH, RISE, SHEAR], 1:-1]
    along = sector_sums(np.einsum("rx,irx->ix", moved[0], moved), count, per_circle)
    changes *= weight
    rows = slice(int(band[0]), int(band[-1]) + 1)
    normal = _normal(changes, count, per_circle)
    return _Gradients(
        count,
        per_circle,
        float(sector_windows(columns, 1, per_circle).sum()) * strip.column_stride / CORRELATED_PIXELS,
        changes,
        normal,
        np.linalg.inv(normal[:, :RISE, :RISE]),
        weight,
        along[1:] / np.maximum(along[0], np.float32(1e-9)),
        rows,
        np.linalg.inv(_normal(changes[:SHEAR, rows], count, per_circle)),
    )


def _normal(changes: Pixels, count: int, per_circle: float) -> Floats:
    """(sectors, n, n) normal matrices, with a ridge."""
    size = len(changes)
    upper = [(one, other) for one in range(size) for other in range(one, size)]
    products = np.stack([np.einsum("rx,rx->x", changes[one], changes[other]) for one, other in upper])
    normal = np.empty((count, size, size))
    for (one, other), sums in zip(upper, sector_sums(products, count, per_circle), strict=True):
        normal[:, one, other] = normal[:, other, one] = sums
    diagonal = np.einsum("kii->ki", normal)  # a view
    diagonal *= 1.0 + RIDGE
    diagonal += 1e-6
    return normal


def _brought_over(pixels: Pixels, sectors: SectorShifts, stride: int) -> Pixels:
    """Every `stride`-th column of the current strip over that of the reference it belongs to."""
    columns = pixels.shape[1]
    centre, shift = sectors.centre_px / stride, sectors.shift_px / stride
    around = np.concatenate([centre[-1:] - columns, centre, centre[:1] + columns])
    position = np.arange(columns)
    position = (position + np.interp(position, around, np.concatenate([shift[-1:], shift, shift[:1]]))) % columns
    whole = position.astype(np.intp)
    part = (position - whole).astype(np.float32)
    left: Pixels = np.take(pixels, whole % columns, axis=1)
    right: Pixels = np.take(pixels, (whole + 1) % columns, axis=1)
    right -= left
    right *= part
    right += left
    return right
