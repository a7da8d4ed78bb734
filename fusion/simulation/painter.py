"""Paints a world onto a raster of rays from far to near, for a camera held level."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fusion.simulation.raster import STEEPEST, Raster
from fusion.simulation.rays import Shapes, hits, spans
from fusion.simulation.surfaces import Array, Ground
from fusion.simulation.world import Floats, Solid, World, far_to_near

_CHUNK = 256  # columns painted at a time: a block of them stays in the processor's cache
_FOG_GREY = 185.0  # an overcast day's


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where the camera is and how it is held: x, y, z in m; yaw, pitch, roll in rad (REP-103, applied roll first)."""

    x: float
    y: float
    z: float
    yaw: float
    pitch: float = 0.0
    roll: float = 0.0


class _Canvas:
    """What has been painted so far, stored by columns, and the rays through its pixels."""

    def __init__(self, raster: Raster, pose: CameraPose, fog: float) -> None:
        self.pose, self.fog = pose, fog
        self.elevation = raster.elevation
        edges = raster.edge_tangent
        self.upper, self.lower = edges[:-1].astype(np.float32), edges[1:].astype(np.float32)
        self.per_row = 1.0 / np.maximum(self.upper - self.lower, np.float32(1e-6))
        self.falling = -edges
        self.tangent = np.tan(np.clip(self.elevation, -STEEPEST, STEEPEST)).astype(np.float32)
        self.step, self.columns = raster.step, raster.columns
        self.azimuth = pose.yaw + np.pi - (np.arange(self.columns) + 0.5) * self.step
        self.cos, self.sin = np.cos(self.azimuth), np.sin(self.azimuth)
        self.grey = np.zeros((self.columns, self.tangent.size), np.float32)

    def rows_between(self, low: float, high: float) -> slice:
        """Rows that the tangents `low`..`high` touch."""
        first = int(np.searchsorted(self.falling, -high, side="right")) - 1
        last = int(np.searchsorted(self.falling, -low, side="left"))
        return slice(max(first, 0), min(max(last, 0), self.tangent.size))

    def lay(self, columns: slice, rows: slice, grey: Array, low: Floats, high: Floats, alpha: Floats) -> None:
        """Lay `grey` over a block of pixels: in each column between the tangents `low`..`high`, with weight `alpha`."""
        # what is covered whole in all columns needs no weights
        first = max(int(np.searchsorted(self.falling, -float(high.min()), side="left")), rows.start)
        last = min(int(np.searchsorted(self.falling, -float(low.max()), side="right")) - 1, rows.stop)
        if alpha.min() < 1.0 or last <= first:
            first = last = rows.stop
        self.grey[columns, first:last] = grey[:, first - rows.start : last - rows.start]
        for part in (slice(rows.start, first), slice(last, rows.stop)):
            if part.stop > part.start:
                self._blend(columns, part, grey[:, part.start - rows.start : part.stop - rows.start], low, high, alpha)

    def _blend(self, columns: slice, rows: slice, grey: Array, low: Floats, high: Floats, alpha: Floats) -> None:
        """`lay` where pixels are covered in part."""
        share = np.minimum(self.upper[rows], high.astype(np.float32)[:, None])
        share -= np.maximum(self.lower[rows], low.astype(np.float32)[:, None])
        share *= self.per_row[rows]
        np.maximum(share, 0.0, out=share)
        np.minimum(share, 1.0, out=share)
        if alpha.min() < 1.0:
            share *= alpha.astype(np.float32)[:, None]
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
        grey = ground.sample((self.pose.x, self.pose.y), self.cos[columns], self.sin[columns], distance, level)
        return self.dim(grey, distance[None, :])

    def dim(self, grey: Array, distance: Floats) -> Array:
        """What fog leaves of `grey` at a horizontal `distance`, m, that broadcasts to it; paints in place."""
        if self.fog:
            grey -= np.float32(_FOG_GREY)
            grey *= np.exp(-self.fog * distance).astype(np.float32)
            grey += np.float32(_FOG_GREY)
        return grey


@dataclass(frozen=True, slots=True)
class _Sight:
    """A solid as the camera sees it, one entry per column from `first` on (unwrapped, may pass the seam).

    Attributes
    ----------
    solid : Solid
        Which.
    first : int
        Its first column.
    alpha : ndarray
        Share of each column that it covers.
    near, far, u : ndarray
        See `Hits`.
    across, down : ndarray
        What a pixel covers of its side, m.
    """

    solid: Solid
    first: int
    alpha: Floats
    near: Floats
    far: Floats
    u: Floats
    across: Floats
    down: Floats

    def part(self, cut: slice) -> _Sight:
        """Its columns `cut`, counted from its first."""
        columns = (self.alpha, self.near, self.far, self.u, self.across, self.down)
        return _Sight(self.solid, self.first + cut.start, *(values[cut] for values in columns))


def paint(world: World, pose: CameraPose, t: float, raster: Raster) -> Array:
    """Paint the world at time `t` s as seen from `pose`, held level; float32 (columns, rows) of the raster."""
    canvas = _Canvas(raster, pose, world.fog)
    sights = _see(far_to_near(world.at(t), pose.x, pose.y, pose.z), canvas)
    _paint_background(world, canvas, sights)
    for sight in sights:
        if sight.solid.hull:
            _paint_ends(canvas, sight)
    for sight in sights:
        _paint_solid(canvas, sight)
    return canvas.grey


def _paint_ends(canvas: _Canvas, sight: _Sight) -> None:
    """Paint the outermost columns of an outer wall whole, so that nothing shines through where two walls meet."""
    for index in (0, sight.alpha.size - 1):
        _paint_solid(canvas, replace(sight.part(slice(index, index + 1)), alpha=np.ones(1)))


def _see(solids: list[Solid], canvas: _Canvas) -> list[_Sight]:
    """Find the columns that show each solid; the outermost get the share that it covers."""
    pose, step = canvas.pose, canvas.step
    shapes = Shapes.of(solids)
    start, end = spans(shapes, pose.x, pose.y)
    # Columns run clockwise: the larger azimuth comes first.
    left, right = (pose.yaw + np.pi - end) / step, (pose.yaw + np.pi - start) / step
    first = np.floor(left).astype(np.intp)
    count = np.maximum(np.ceil(right).astype(np.intp) - first, 1)
    ends = np.cumsum(count)
    owner = np.repeat(np.arange(len(solids)), count)
    index = np.arange(owner.size) + (first - ends + count)[owner]
    alpha = np.minimum(index + 1.0, right[owner]) - np.maximum(index, left[owner])
    alpha = np.minimum(np.maximum(alpha, 0.0), 1.0)
    inset = np.minimum(1e-6, (end - start) / 4.0)
    azimuth = pose.yaw + np.pi - (index + 0.5) * step
    azimuth = np.minimum(np.maximum(azimuth, (start + inset)[owner]), (end - inset)[owner])
    met = hits(shapes.take(owner), pose.x, pose.y, azimuth)
    down = met.near * step
    across = down / np.maximum(met.facing, 1e-3)
    columns = (alpha, met.near, met.far, met.u, across, down)
    return [
        _Sight(solid, here, *(values[last - size : last] for values in columns))
        for solid, here, last, size in zip(solids, first.tolist(), ends.tolist(), count.tolist(), strict=True)
    ]


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
        near, far, alpha = sight.near[part], sight.far[part], sight.alpha[part] * solid.opacity
        above, below = solid.high[2] - pose.z, solid.low[2] - pose.z
        if solid.cap is not None and above < 0:
            _paint_cap(canvas, columns, near, far, alpha, solid.cap, above)
        elif solid.cap is not None and below > 0:
            _paint_cap(canvas, columns, near, far, alpha, solid.cap, below)
        low, high = below / near, above / near
        rows = canvas.rows_between(float(low.min()), float(high.max()))
        if rows.stop <= rows.start:
            continue
        level = solid.skin.level(sight.across[part], sight.down[part])
        grey = solid.skin.sample(sight.u[part], above, -near, canvas.tangent[rows], level)
        canvas.lay(columns, rows, canvas.dim(grey, near[:, None]), low, high, alpha)


def _paint_cap(
    canvas: _Canvas, columns: slice, near: Floats, far: Floats, alpha: Floats, cap: Ground, height: float
) -> None:
    """Paint the top of something lower than the camera, or the bottom of something higher: `height` m above it."""
    close, distant = height / near, height / far
    # One row more on the near side, under the edge of the side that is painted next.
    close += np.copysign(canvas.step * (1.0 + close**2), height)
    low, high = np.minimum(close, distant), np.maximum(close, distant)
    rows = canvas.rows_between(float(low.min()), float(high.max()))
    if rows.stop > rows.start:
        grey = canvas.level_surface(columns, rows, cap, height + canvas.pose.z)
        canvas.lay(columns, rows, grey, low, high, alpha)


def _paint_background(world: World, canvas: _Canvas, sights: list[_Sight]) -> None:
    """Paint sky or ceiling and floor, leaving out what walls that reach them hide."""
    floor, roof = np.zeros(canvas.columns), np.zeros(canvas.columns)
    for sight in sights:
        index = np.arange(sight.first, sight.first + sight.alpha.size) % canvas.columns
        near = np.where(sight.alpha * sight.solid.opacity < 1.0, np.inf, sight.near)
        if sight.solid.low[2] <= 0.0 and sight.solid.high[2] > canvas.pose.z:
            floor[index] = np.minimum(floor[index], -canvas.pose.z / near)
        if world.ceiling is not None and sight.solid.high[2] >= world.ceiling_height - 1e-6:
            roof[index] = np.maximum(roof[index], (world.ceiling_height - canvas.pose.z) / near)
    for columns, _ in _chunks(0, canvas.columns, canvas.columns):
        if world.sky is not None:
            rows = canvas.rows_between(-0.02, np.inf)
            sky = world.sky.sample(canvas.azimuth[columns], canvas.elevation[rows])
            canvas.grey[columns, rows] = _FOG_GREY if world.fog else sky
        if world.ceiling is not None:
            rows = canvas.rows_between(max(float(roof[columns].min()), 1e-3), np.inf)
            canvas.grey[columns, rows] = canvas.level_surface(columns, rows, world.ceiling, world.ceiling_height)
        rows = canvas.rows_between(-np.inf, min(float(floor[columns].max()), -1e-3))
        canvas.grey[columns, rows] = canvas.level_surface(columns, rows, world.floor, 0.0)
