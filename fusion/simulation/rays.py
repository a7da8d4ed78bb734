"""Rays from the camera, and where they meet the sides of solids: of all at once, as most are a few columns wide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion.simulation.world import Floats, Solid


@dataclass(frozen=True, slots=True)
class Shapes:
    """Boxes and cylinders seen from above; arrays of one shape, one entry per solid or per ray.

    Attributes
    ----------
    x0, y0, x1, y1 : ndarray
        Corners, m.
    round : ndarray of bool
        Cylinders, their radius half the x extent.
    """

    x0: Floats
    y0: Floats
    x1: Floats
    y1: Floats
    round: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, solids: Sequence[Solid]) -> Shapes:
        """Shapes of `solids`, one entry each."""
        corners = np.array([(*solid.low[:2], *solid.high[:2]) for solid in solids], np.float64).reshape(-1, 4)
        x0, y0, x1, y1 = corners.T
        return cls(x0, y0, x1, y1, np.array([solid.round for solid in solids], np.bool_))

    def take(self, index: npt.NDArray[np.intp]) -> Shapes:
        """Those with the numbers `index`, in that order."""
        return Shapes(self.x0[index], self.y0[index], self.x1[index], self.y1[index], self.round[index])

    @property
    def radius(self) -> Floats:
        """Of the cylinders, m."""
        return (self.x1 - self.x0) / 2.0

    @property
    def middle(self) -> tuple[Floats, Floats]:
        """Centres x and y, m."""
        return (self.x0 + self.x1) / 2.0, (self.y0 + self.y1) / 2.0


@dataclass(frozen=True, slots=True)
class Hits:
    """Where rays meet the side of a solid; one entry per ray.

    Attributes
    ----------
    near, far : ndarray
        Horizontal distance at which the ray enters and leaves, m.
    u : ndarray
        Position along the solid's side, m.
    facing : ndarray
        Cosine of the angle between the ray and the side's normal, seen from above.
    """

    near: Floats
    far: Floats
    u: Floats
    facing: Floats


def spans(shapes: Shapes, x: float, y: float) -> tuple[Floats, Floats]:
    """Azimuths between which each shape is seen from (x, y), rad, the smaller first, not wrapped."""
    middle_x, middle_y = shapes.middle
    centre = np.arctan2(middle_y - y, middle_x - x)
    corners_x = np.stack([shapes.x0, shapes.x1, shapes.x0, shapes.x1]) - x
    corners_y = np.stack([shapes.y0, shapes.y0, shapes.y1, shapes.y1]) - y
    offset = (np.arctan2(corners_y, corners_x) - centre + np.pi) % (2.0 * np.pi) - np.pi
    half = np.arcsin(np.minimum(1.0, shapes.radius / np.maximum(np.hypot(middle_x - x, middle_y - y), 1e-12)))
    start = centre + np.where(shapes.round, -half, offset.min(axis=0))
    return start, centre + np.where(shapes.round, half, offset.max(axis=0))


def hits(shapes: Shapes, x: float, y: float, azimuth: Floats) -> Hits:
    """Where rays from (x, y) meet the sides, each ray its own shape, whose span its azimuth is inside of."""
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    near, far, u, facing = _of_boxes(shapes, x, y, cos, sin)
    rounds = np.flatnonzero(shapes.round)
    if rounds.size:
        near[rounds], far[rounds], u[rounds], facing[rounds] = _of_cylinders(
            shapes.take(rounds), x, y, cos[rounds], sin[rounds]
        )
    return Hits(near, far, u, facing)


def _of_boxes(shapes: Shapes, x: float, y: float, cos: Floats, sin: Floats) -> tuple[Floats, ...]:
    cos = np.where(np.abs(cos) < 1e-9, 1e-9, cos)
    sin = np.where(np.abs(sin) < 1e-9, 1e-9, sin)
    x0, y0, x1, y1 = shapes.x0, shapes.y0, shapes.x1, shapes.y1
    to_right, to_left = cos > 0, sin > 0  # towards +x and +y
    to_x = np.where(to_right, x0 - x, x1 - x) / cos
    to_y = np.where(to_left, y0 - y, y1 - y) / sin
    near = np.maximum(to_x, to_y)
    far = np.minimum(np.where(to_right, x1 - x, x0 - x) / cos, np.where(to_left, y1 - y, y0 - y) / sin)
    on_x = to_x > to_y
    length, depth = x1 - x0, y1 - y0
    along_x = np.minimum(np.maximum(x + near * cos - x0, 0.0), length)
    along_y = np.minimum(np.maximum(y + near * sin - y0, 0.0), depth)
    u_x_face = np.where(to_right, 2 * length + 2 * depth - along_y, length + along_y)
    u_y_face = np.where(to_left, along_x, 2 * length + depth - along_x)
    u = np.where(on_x, u_x_face, u_y_face)
    return near, np.maximum(far, near), u, np.where(on_x, np.abs(cos), np.abs(sin))


def _of_cylinders(shapes: Shapes, x: float, y: float, cos: Floats, sin: Floats) -> tuple[Floats, ...]:
    radius = shapes.radius
    to_x, to_y = (middle - at for middle, at in zip(shapes.middle, (x, y), strict=True))
    along, aside = to_x * cos + to_y * sin, to_x * sin - to_y * cos
    half = np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
    near = along - half
    angle = np.arctan2(near * sin - to_y, near * cos - to_x)
    return near, along + half, radius * (angle % (2.0 * np.pi)), np.maximum(half / radius, 1e-3)
