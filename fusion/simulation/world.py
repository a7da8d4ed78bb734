"""A world of upright solids on level ground: what there is, and where a ray meets it.

Every solid is a prism with vertical sides, so a panorama's column meets its side at one distance and the rows follow
from the tangent of the elevation. That is what makes rendering fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fusion.simulation.surfaces import Ground, Skin, Sky

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solid:
    """An upright box along the axes, or an upright cylinder inscribed in it; of no thickness it is a plate.

    Attributes
    ----------
    low, high : tuple of float
        Corners (x, y, z), m.
    skin : Skin
        The sides, counter-clockwise from corner (low x, low y).
    cap : Ground or None
        Top and bottom.
    round : bool
        A cylinder, its radius half the x extent.
    hull : bool
        Part of the outermost wall, behind which there is nothing.
    opacity : float
        Weight of its sides over what is behind them, 0..1: glass, shadows and patches of light have less than 1.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    skin: Skin
    cap: Ground | None = None
    round: bool = False
    hull: bool = False
    opacity: float = 1.0


Crowd = Callable[[float], tuple[Solid, ...]]


def nobody(t: float) -> tuple[Solid, ...]:
    """A world where nothing moves."""
    return ()


@dataclass(frozen=True, eq=False)
class World:
    """All there is to see.

    Attributes
    ----------
    solids : tuple of Solid
        What stands still.
    floor : Ground
        The ground, z = 0.
    ceiling : Ground or None
        At `ceiling_height` m, or open sky.
    sky : Sky or None
        Seen where there is neither solid nor ceiling.
    crowd : callable
        The moving solids at time t, s.
    fog : float
        Extinction along the horizontal distance, 1/m; contrast falls to 2 % at 3.9 / fog (Koschmieder's visibility).
    """

    solids: tuple[Solid, ...]
    floor: Ground
    ceiling: Ground | None = None
    ceiling_height: float = 3.0
    sky: Sky | None = None
    crowd: Crowd = field(default=nobody)
    fog: float = 0.0

    def at(self, t: float) -> tuple[Solid, ...]:
        """Everything solid at time `t`, s."""
        return self.solids + self.crowd(t)

    def clearance(self, x: Floats, y: Floats, headroom: float = 1.2) -> float:
        """Distance from the nearest of the points (x, y), m, to the nearest resting solid lower than `headroom` m."""
        nearest = np.inf
        for solid in self.solids:
            if solid.low[2] > headroom:
                continue
            dx = np.maximum(np.maximum(solid.low[0] - x, x - solid.high[0]), 0.0)
            dy = np.maximum(np.maximum(solid.low[1] - y, y - solid.high[1]), 0.0)
            nearest = min(nearest, float(np.hypot(dx, dy).min()))
        return nearest


def far_to_near(solids: tuple[Solid, ...], x: float, y: float, z: float) -> list[Solid]:
    """Order `solids` so that each comes after all that it can hide from a camera at (x, y, z).

    Two boxes that are apart along an axis are told apart by a plane between them: what lies on the camera's side of it
    is never hidden by what lies beyond.
    """
    low = np.array([solid.low for solid in solids])
    high = np.array([solid.high for solid in solids])
    camera = np.array([x, y, z])
    # beyond[i, j]: a plane has i behind it and j before it, seen from the camera, so i cannot hide j.
    above = (low[:, None, :] >= high[None, :, :] - 1e-9) & (camera <= low[:, None, :])
    below = (high[:, None, :] <= low[None, :, :] + 1e-9) & (camera >= high[:, None, :])
    beyond: npt.NDArray[np.bool_] = np.any(above | below, axis=2)
    np.fill_diagonal(beyond, True)
    distance = np.hypot(*(np.clip(camera[:2], low[:, :2], high[:, :2]) - camera[:2]).T)
    order: list[Solid] = []
    may_hide = ~beyond
    hidden = may_hide.sum(axis=1)  # how many of those left each may hide
    left = np.ones(len(solids), bool)
    for _ in solids:
        free = left & (hidden == 0)
        candidates = np.flatnonzero(free if free.any() else left)
        pick = candidates[np.argmax(distance[candidates])]
        order.append(solids[pick])
        left[pick] = False
        hidden -= may_hide[:, pick]
    return order
