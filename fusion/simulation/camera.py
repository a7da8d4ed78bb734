"""A panoramic camera that sees a `World`: equirectangular, anti-aliased.

Column ``c`` of ``width`` looks along azimuth ``pi - 2 pi (c + 0.5) / width`` from the robot's +x (clockwise, the
centre looks ahead), row ``r`` of ``height`` along elevation ``pi/2 - pi (r + 0.5) / height``. Every column is rendered
twice as fine, every row in the `band` of elevations too; edges get their exact coverage, textures their footprint
(`surfaces`); then all is low-passed and shrunk. Rows outside the band are rendered coarsely: they are there so that
frames are whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulation.surfaces import Array, Ground
from fusion.simulation.world import Floats, Hits, Solid, World, far_to_near

_CHUNK = 128  # columns painted at a time: a block of them stays in the processor's cache
_STEEPEST = np.deg2rad(87.0)  # the poles, where the tangent has no end
_BLUR = np.array([1.0, 5.0, 10.0, 10.0, 5.0, 1.0], np.float32) / 32.0  # of the lens; leaves 0.7 % beyond 1.5 Nyquist


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where the camera is and how it is held: x, y, z in m; yaw, pitch, roll in rad (REP-103, applied roll first)."""

    x: float
    y: float
    z: float
    yaw: float
    pitch: float = 0.0
    roll: float = 0.0


@dataclass(frozen=True)
class PanoramaCamera:
    """Size of the panorama and the band of rows (fractions of height) rendered finely."""

    width: int = 1024
    height: int = 512
    band: tuple[float, float] = (0.2, 0.7)

    def render(self, world: World, pose: CameraPose, t: float = 0.0) -> Array:
        """The panorama at time `t` s: float32 (height, width), grey 0..255."""
        rows = _Rows.of(self.height, self.band)
        fine = _paint(world, pose, t, rows, 2 * self.width)
        image = rows.whole(fine)
        if pose.roll or pose.pitch:
            image = _tilted(image, pose.pitch, pose.roll)
        return _shrink(image)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows that are painted: fine ones inside the band, coarse ones above and below."""

    edges: Floats
    fine: slice
    height: int

    @classmethod
    def of(cls, height: int, band: tuple[float, float]) -> _Rows:
        top, bottom = (round(2 * height * edge) for edge in band)
        above = np.arange(0, top, 8.0)
        below = np.append(np.arange(2 * height, bottom, -8.0)[::-1], [])
        edges = np.concatenate([above, np.arange(top, bottom + 1.0), below])
        return cls(edges, slice(above.size, above.size + bottom - top), 2 * height)

    @property
    def elevation(self) -> Floats:
        """Elevation of the rows' centres, rad."""
        return np.asarray(np.pi / 2.0 - np.pi * (self.edges[1:] + self.edges[:-1]) / 2.0 / self.height, np.float64)

    @property
    def edge_tangent(self) -> Floats:
        """Tangent of the elevation at the rows' edges, falling."""
        return np.tan(np.clip(np.pi / 2.0 - np.pi * self.edges / self.height, -_STEEPEST, _STEEPEST))

    def whole(self, fine: Array) -> Array:
        """All rows at twice the final height from the painted ones; (columns, rows) becomes (rows, columns)."""
        centres = (self.edges[1:] + self.edges[:-1]) / 2.0
        source = np.interp(np.arange(self.height) + 0.5, centres, np.arange(centres.size)).astype(np.float32)
        painted = np.ascontiguousarray(fine.T)
        before, after = self.fine.start, self.height - int(self.edges[self.fine.stop])
        whole = np.empty((self.height, fine.shape[0]), np.float32)
        first, last = int(self.edges[before]), self.height - after
        whole[first:last] = painted[self.fine]
        columns = np.arange(fine.shape[0], dtype=np.float32)
        for part in (slice(0, first), slice(last, self.height)):
            y = np.repeat(source[part, None], columns.size, axis=1)
            x = np.repeat(columns[None, :], y.shape[0], axis=0)
            whole[part] = cv2.remap(painted, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return whole


class _Canvas:
    """What has been painted so far, stored by columns, and the rays through its pixels."""

    def __init__(self, rows: _Rows, columns: int, pose: CameraPose) -> None:
        self.pose = pose
        self.elevation = rows.elevation
        edges = rows.edge_tangent
        self.upper, self.lower = edges[:-1].astype(np.float32), edges[1:].astype(np.float32)
        self.per_row = 1.0 / np.maximum(self.upper - self.lower, np.float32(1e-6))
        self.falling = -edges
        self.tangent = np.tan(np.clip(self.elevation, -_STEEPEST, _STEEPEST)).astype(np.float32)
        self.step = 2.0 * np.pi / columns
        self.columns = columns
        self.azimuth = pose.yaw + np.pi - (np.arange(columns) + 0.5) * self.step
        self.grey = np.zeros((columns, self.tangent.size), np.float32)

    def rows_between(self, low: float, high: float) -> slice:
        """Rows that the tangents `low`..`high` touch."""
        first = int(np.searchsorted(self.falling, -high, side="right")) - 1
        last = int(np.searchsorted(self.falling, -low, side="left"))
        return slice(max(first, 0), min(max(last, 0), self.tangent.size))

    def cover(self, columns: slice, rows: slice, low: Floats, high: Floats, alpha: Floats) -> Array:
        """Covered share of each pixel of a block by what lies between the tangents `low`..`high` in each column."""
        share = np.minimum(self.upper[rows], high.astype(np.float32)[:, None])
        share -= np.maximum(self.lower[rows], low.astype(np.float32)[:, None])
        share *= self.per_row[rows]
        np.clip(share, 0.0, 1.0, out=share)
        if alpha.min() < 1.0:
            share *= alpha.astype(np.float32)[:, None]
        return share

    def blend(self, columns: slice, rows: slice, grey: Array, share: Array) -> None:
        """Lay `grey` over the block with weight `share`."""
        block = self.grey[columns, rows]
        grey -= block
        grey *= share
        block += grey

    def level_surface(self, columns: slice, rows: slice, ground: Ground, height: float) -> Array:
        """Grey of the horizontal plane at `height` m through the block's pixels."""
        tangent = self.tangent[rows]
        above = height - self.pose.z
        sign = 1.0 if above > 0 else -1.0
        distance = np.abs(above) / np.maximum(sign * tangent, 1e-4)
        across = distance * self.step
        along = np.abs(above) * np.abs(
            1.0 / np.maximum(sign * self.lower[rows], 1e-4) - 1.0 / np.maximum(sign * self.upper[rows], 1e-4)
        )
        # A plane seen at a grazing angle is a long narrow footprint; a third of its length keeps the detail across.
        level = ground.level(np.maximum(across, along / 3.0))
        cos, sin = np.cos(self.azimuth[columns]), np.sin(self.azimuth[columns])
        x = np.float32(self.pose.x) + cos.astype(np.float32)[:, None] * distance.astype(np.float32)
        y = np.float32(self.pose.y) + sin.astype(np.float32)[:, None] * distance.astype(np.float32)
        return ground.sample(x, y, level.astype(np.float64))


@dataclass(frozen=True, eq=False)
class _Sight:
    """A solid as the camera sees it: its columns (unwrapped, may pass the seam), their coverage and hits."""

    solid: Solid
    first: int
    alpha: Floats
    hits: Hits


def _paint(world: World, pose: CameraPose, t: float, rows: _Rows, columns: int) -> Array:
    """Paint the world from far to near onto a fine canvas, shape (columns, rows); the camera held level."""
    canvas = _Canvas(rows, columns, pose)
    sights = [_see(solid, canvas) for solid in far_to_near(world.at(t), pose.x, pose.y, pose.z)]
    _paint_background(world, canvas, sights)
    for sight in sights:
        if sight.solid.hull:  # so that nothing shines through the corners where two outer walls meet
            ends = np.where(sight.alpha < 1.0, 1.0, 0.0)
            for end in (slice(0, 1), slice(-1, None)):
                part = Hits(*(getattr(sight.hits, name)[end] for name in ("near", "far", "u", "facing")))
                first = sight.first + (0 if end.start == 0 else sight.alpha.size - 1)
                _paint_solid(canvas, _Sight(sight.solid, first, ends[end], part))
    for sight in sights:
        _paint_solid(canvas, sight)
    return canvas.grey


def _see(solid: Solid, canvas: _Canvas) -> _Sight:
    """Find the columns that show `solid`; the outermost get the share that it covers."""
    start, end = solid.span(canvas.pose.x, canvas.pose.y)
    # Columns run clockwise: the larger azimuth comes first.
    left = (canvas.pose.yaw + np.pi - end) / canvas.step
    right = (canvas.pose.yaw + np.pi - start) / canvas.step
    first = int(np.floor(left))
    index = np.arange(first, max(int(np.ceil(right)), first + 1))
    alpha = np.clip(np.minimum(index + 1.0, right) - np.maximum(index, left), 0.0, 1.0)
    azimuth = canvas.pose.yaw + np.pi - (index + 0.5) * canvas.step
    inset = min(1e-6, (end - start) / 4.0)
    hits = solid.hits(canvas.pose.x, canvas.pose.y, np.clip(azimuth, start + inset, end - inset))
    return _Sight(solid, first, alpha, hits)


def _chunks(first: int, count: int, columns: int) -> list[tuple[slice, slice]]:
    """Split unwrapped columns into (slice of the canvas, slice of the sight) pairs that never cross the seam."""
    parts = []
    done = 0
    while done < count:
        start = (first + done) % columns
        size = min(_CHUNK, count - done, columns - start)
        parts.append((slice(start, start + size), slice(done, done + size)))
        done += size
    return parts


def _paint_solid(canvas: _Canvas, sight: _Sight) -> None:
    """Paint top or bottom first, then the side over it."""
    solid, pose = sight.solid, canvas.pose
    for columns, part in _chunks(sight.first, sight.alpha.size, canvas.columns):
        near, far, alpha = sight.hits.near[part], sight.hits.far[part], sight.alpha[part]
        above, below = solid.high[2] - pose.z, solid.low[2] - pose.z
        if solid.cap is not None and (above < 0 or below > 0):
            height = above if above < 0 else below
            close, distant = height / near, height / far
            _paint_cap(
                canvas, columns, np.minimum(close, distant), np.maximum(close, distant), alpha, solid.cap, height
            )
        low, high = below / near, above / near
        rows = canvas.rows_between(float(low.min()), float(high.max()))
        if rows.stop <= rows.start:
            continue
        pixel = near * canvas.step
        level = solid.skin.level(pixel / np.maximum(sight.hits.facing[part], 1e-3), pixel)
        grey = solid.skin.sample(sight.hits.u[part], np.full(near.shape, above), -near, canvas.tangent[rows], level)
        canvas.blend(columns, rows, grey, canvas.cover(columns, rows, low, high, alpha))


def _paint_cap(
    canvas: _Canvas, columns: slice, low: Floats, high: Floats, alpha: Floats, cap: Ground, height: float
) -> None:
    """Paint the top of something lower than the camera, or the bottom of something higher."""
    rows = canvas.rows_between(float(low.min()), float(high.max()))
    if rows.stop > rows.start:
        grey = canvas.level_surface(columns, rows, cap, height + canvas.pose.z)
        # One row more on the near side, under the edge of the side that is painted next.
        spare = 1.0 / canvas.per_row[rows].min()
        low, high = (low - spare, high) if height < 0 else (low, high + spare)
        canvas.blend(columns, rows, grey, canvas.cover(columns, rows, low, high, alpha))


def _paint_background(world: World, canvas: _Canvas, sights: list[_Sight]) -> None:
    """Paint sky or ceiling and floor, leaving out what walls that reach them hide."""
    floor, roof = np.zeros(canvas.columns), np.zeros(canvas.columns)
    for sight in sights:
        index = np.arange(sight.first, sight.first + sight.alpha.size) % canvas.columns
        near = np.where(sight.alpha < 1.0, np.inf, sight.hits.near)
        if sight.solid.low[2] <= 0.0 and sight.solid.high[2] > canvas.pose.z:
            floor[index] = np.minimum(floor[index], -canvas.pose.z / near)
        if world.ceiling is not None and sight.solid.high[2] >= world.ceiling_height - 1e-6:
            roof[index] = np.maximum(roof[index], (world.ceiling_height - canvas.pose.z) / near)
    for columns, _ in _chunks(0, canvas.columns, canvas.columns):
        if world.sky is not None:
            rows = canvas.rows_between(-0.02, np.inf)
            canvas.grey[columns, rows] = world.sky.sample(canvas.azimuth[columns], canvas.elevation[rows])
        if world.ceiling is not None:
            rows = canvas.rows_between(max(float(roof[columns].min()), 1e-3), np.inf)
            canvas.grey[columns, rows] = canvas.level_surface(columns, rows, world.ceiling, world.ceiling_height)
        rows = canvas.rows_between(-np.inf, min(float(floor[columns].max()), -1e-3))
        canvas.grey[columns, rows] = canvas.level_surface(columns, rows, world.floor, 0.0)


def _tilted(image: Array, pitch: float, roll: float) -> Array:
    """Resample a fine level panorama as seen by a camera that is pitched (nose down positive) and rolled."""
    height, width = image.shape
    elevation = np.pi / 2.0 - np.pi * (np.arange(height) + 0.5)[:, None] / height
    azimuth = np.pi - 2.0 * np.pi * (np.arange(width) + 0.5)[None, :] / width
    ray = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth)
    x, y, z = tilt(ray, pitch, roll)
    column = (np.pi - np.arctan2(y, x)) / (2.0 * np.pi) * width - 0.5
    row = (np.pi / 2.0 - np.arcsin(np.clip(z, -1.0, 1.0))) / np.pi * height - 0.5
    pad = 4
    wide = cv2.copyMakeBorder(image, 0, 0, pad, pad, cv2.BORDER_WRAP)
    maps = (column + pad).astype(np.float32), row.astype(np.float32)
    return np.asarray(cv2.remap(wide, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.float32)


def tilt(
    ray: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]], pitch: float, roll: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Turn rays of the tilted camera into the level frame of the same heading: Ry(pitch) Rx(roll) ray."""
    x, y, z = ray
    y, z = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    return x * np.cos(pitch) + z * np.sin(pitch), y, -x * np.sin(pitch) + z * np.cos(pitch)


def _shrink(image: Array) -> Array:
    """Low-pass and halve: (2 height, 2 width) -> (height, width)."""
    padded = cv2.copyMakeBorder(image, 0, 0, 4, 4, cv2.BORDER_WRAP)
    smooth = cv2.sepFilter2D(padded, -1, _BLUR, _BLUR, anchor=(2, 2), borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(smooth[::2, 4:-4:2])
