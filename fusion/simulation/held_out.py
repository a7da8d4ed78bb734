"""Places to judge by, different in kind from those that the estimator was developed in.

The rule: NO CONSTANT MAY BE CHOSEN ON THESE PLACES. They tell how good the estimator is where nobody has looked; a
parameter, threshold or method that is changed to do better here makes them worthless. What fails here is to be
reproduced elsewhere (`places`, `yards`, a place of your own) and mended there.

Each place is built round whatever way the robot takes, so that any drive can be driven in any of them. It is a kind of
place: where things stand, how far apart, how large and what they look like is drawn, so many seeds are many scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from fusion.simulation import fittings, materials
from fusion.simulation.builder import INDOOR_DENSITY, OUTDOOR_DENSITY, Builder, plain
from fusion.simulation.people import pacing
from fusion.simulation.surfaces import Ground, Skin
from fusion.simulation.world import Crowd, Solid, World

Floats = npt.NDArray[np.float64]
Corner = tuple[float, float]

CLEAR = 0.6  # m from the way to the nearest thing: as narrow as the passage of the paper, 1.3 m wide


class Site(Builder):
    """A builder that knows where the robot and the people go.

    Parameters
    ----------
    way : ndarray, shape (n, 2)
        Points, m, that stay free of things.

    Attributes
    ----------
    scale : float
        Of all distances between things and from the way: no two places of a kind are laid out alike.
    """

    def __init__(self, rng: np.random.Generator, way: Floats, density: float = INDOOR_DENSITY) -> None:
        super().__init__(rng, density)
        self.way = way
        self.scale = float(rng.uniform(0.9, 1.25))
        self._taken: list[tuple[Corner, Corner]] = []
        self.low: Corner = (float(way[:, 0].min()), float(way[:, 1].min()))
        self.high: Corner = (float(way[:, 0].max()), float(way[:, 1].max()))

    def around(self, margin: float) -> tuple[Corner, Corner]:
        """Corners of the rectangle that leaves `margin` m, times the scale, on all sides of the way."""
        (x0, y0), (x1, y1), margin = self.low, self.high, margin * self.scale
        return (x0 - margin, y0 - margin), (x1 + margin, y1 + margin)

    def distance(self, centre: Corner, size: Corner = (0.0, 0.0)) -> float:
        """From the way to a rectangle of `size` round `centre`, m."""
        aside = np.maximum(np.abs(self.way - np.asarray(centre)) - np.asarray(size) / 2.0, 0.0)
        return float(np.hypot(*aside.T).min())

    def claim(self, centre: Corner, size: Corner) -> bool:
        """Whether a thing of `size` can stand at `centre`; if so, nothing else can any more."""
        for other, extent in self._taken:
            if all(abs(centre[k] - other[k]) < (size[k] + extent[k]) / 2.0 for k in (0, 1)):
                return False
        if self.distance(centre, size) <= CLEAR:
            return False
        self._taken.append((centre, size))
        return True

    def grid(self, margin: float, pitch: Corner) -> list[Corner]:
        """Points `pitch` m apart, times the scale, that fill the rectangle round the way, from anywhere on."""
        (x0, y0), (x1, y1) = self.around(margin)
        dx, dy = pitch[0] * self.scale, pitch[1] * self.scale
        x0, y0 = x0 + self.rng.uniform(0.0, 0.5 * dx), y0 + self.rng.uniform(0.0, 0.5 * dy)
        return [(float(x), float(y)) for x in np.arange(x0, x1, dx) for y in np.arange(y0, y1, dy)]


def storage_racks(rng: np.random.Generator, way: Floats) -> World:
    """Open racks with parcels at all depths, between which far walls show."""
    s = Site(rng, way)
    s.room(*s.around(3.2), 3.4, materials.concrete, fittings.STORE, gap=2.5)
    for x, y in s.grid(2.2, (2.0, 2.1)):
        if s.distance((x, y)) < 3.5 and s.claim((x, y), (1.9, 0.8)):
            _rack(s, x, y)
    return s.indoors(fittings.tiles(rng, 10.0, 80.0, 0.8, 105.0), 10.0, 3.4)


def _rack(s: Site, x: float, y: float) -> None:
    """A bay of 1.8 x 0.7 m: four posts, three boards, parcels where they were put down."""
    for dx in (-0.9, 0.9):
        for dy in (-0.35, 0.35):
            s.box((x + dx, y + dy), (0.06, 0.06, 2.3), materials.metal)
    for foot in (0.12, 0.85, 1.6):
        s.box((x, y), (1.7, 0.6, 0.04), materials.planks, foot)
        for slot in (-0.55, 0.0, 0.55):
            if s.rng.random() < 0.55:
                a, b, c = s.rng.uniform((0.2, 0.15, 0.15), (0.48, 0.3, 0.6))
                s.box((x + slot, y + s.rng.uniform(-0.14, 0.14)), (a, b, c), materials.cardboard, foot + 0.04)


def car_park(rng: np.random.Generator, way: Floats) -> World:
    """Parked cars with gaps between them, and along one side a picket fence, before houses 15 to 40 m away."""
    s = Site(rng, way, OUTDOOR_DENSITY)
    (x0, y0), (x1, y1) = s.around(3.0)
    for x in np.arange(x0, x1, 0.24):
        if s.claim((float(x), y1 - 2.0), (0.07, 0.07)):
            s.pole((float(x), y1 - 2.0), 0.035, 1.3, materials.planks)
    for x, y in s.grid(6.5, (5.4, 2.7)):
        if rng.random() < 0.6 and s.claim((x, y), (4.2, 1.7)):
            s.car((x, y))
    for low, high, height, wall, density in (
        ((x0 - 5.0, y1 + 14.0), (x0 + 9.0, y1 + 24.0), 8.0, materials.brick, 40.0),
        ((x0 + 13.0, y1 + 24.0), (x0 + 32.0, y1 + 36.0), 14.0, materials.plaster, 30.0),
        ((x0 - 2.0, y0 - 32.0), (x0 + 22.0, y0 - 22.0), 11.0, materials.concrete, 30.0),
        ((x1 + 26.0, y0 - 12.0), (x1 + 38.0, y1 + 8.0), 9.0, materials.plaster, 30.0),
        ((x0 - 40.0, y0 - 6.0), (x0 - 24.0, y1 + 12.0), 7.0, materials.brick, 30.0),
    ):
        dx, dy = rng.uniform(-3.0, 3.0, 2).tolist()
        s.house((low[0] + dx, low[1] + dy), (high[0] + dx, high[1] + dy), height * s.scale, wall, density)
    return s.outdoors(fittings.tiles(rng, 24.0, 48.0, 12.0, 90.0), 24.0)


def colonnade(rng: np.random.Generator, way: Floats) -> World:
    """Identical pillars every 1.7 m in both directions, in a hall whose walls repeat with them."""
    s = Site(rng, way)
    pitch, height, radius = 1.7 * s.scale, 3.6, rng.uniform(0.12, 0.2)
    around = 2.0 * np.pi * radius
    shaft = s.skin(materials.concrete, around, height)
    for x, y in s.grid(1.7, (1.7, 1.7)):
        if s.claim((x, y), (2 * radius, 2 * radius)):
            low, high = (x - radius, y - radius, 0.0), (x + radius, y + radius, height)
            s.solids.append(Solid(low, high, shaft, None, round=True))
    (x0, y0), (x1, y1) = s.around(2.55)
    bay = materials.plaster(rng, pitch, height, s.density)
    fittings.window(bay, rng, s.density, 0.1)
    for start, end in (((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x0, y1), (x1, y1)), ((x0, y0), (x0, y1))):
        s.wall(start, end, bay, height, repeat=pitch)
    return s.indoors(fittings.tiles(rng, pitch, 160.0, pitch / 4.0, 120.0), pitch, height)


def white_gallery(rng: np.random.Generator, way: Floats) -> World:
    """Plain white walls with a picture every few metres, a few plain plinths, nothing on floor or ceiling."""
    s = Site(rng, way)
    low, high = s.around(2.4)
    s.room(low, high, 3.2, _white, (fittings.poster,), gap=4.5 * s.scale)
    for x, y in s.grid(1.6, (3.3, 3.7)):
        if s.claim((x, y), (0.5, 0.5)):
            s.box((x, y), (0.5, 0.5, 1.1), _white)
    floor, ceiling = (Ground(_white(rng, 6.0, 6.0, 40.0) - shade, 6.0) for shade in (70.0, 0.0))
    return World(tuple(s.solids), floor, ceiling, 3.2)


def _white(rng: np.random.Generator, width: float, height: float, density: float) -> materials.Image:
    return plain(rng, width, height, density) + np.float32(50.0)


def foggy_field(rng: np.random.Generator, way: Floats) -> World:
    """Grass with a few posts, stumps and trees; one sees 20 m far."""
    s = Site(rng, way, OUTDOOR_DENSITY)
    (x0, y0), (x1, y1) = s.around(10.0)
    count = round(0.04 / s.scale**2 * (x1 - x0) * (y1 - y0))
    for x, y in rng.uniform((x0, y0), (x1, y1), (count, 2)).tolist():
        kind = rng.random()
        if kind < 0.4 and s.claim((x, y), (0.1, 0.1)):
            s.pole((x, y), 0.05, rng.uniform(1.0, 2.2), materials.bark)
        elif kind < 0.6 and s.claim((x, y), (0.5, 0.5)):
            s.pole((x, y), 0.25, rng.uniform(0.3, 0.7), materials.bark)
        elif kind >= 0.6 and s.claim((x, y), (3.0, 3.0)):
            s.tree((x, y), rng.uniform(4.0, 6.0))
    return replace(s.outdoors(fittings.dirt(rng, 16.0, 64.0, 105.0), 16.0), fog=3.9 / 20.0)


def glass_front(rng: np.random.Generator, way: Floats) -> World:
    """A shop front on one side: dirty panes, the shop behind them, and the street's other side mirrored in them."""
    s = Site(rng, way, 100.0)
    x0, x1 = s.low[0] - 12.0 - rng.uniform(0.0, 1.9), s.high[0] + 12.0
    front = s.high[1] + 1.1 * s.scale
    for x in np.arange(x0, x1, 1.9):
        pane = Skin(_pane(rng, 1.8, 3.0, s.density), 1.8, 3.0)
        s.solids.append(Solid((x + 0.08, front, 0.0), (x + 1.88, front, 3.0), pane, opacity=0.35))
        s.box((float(x), front), (0.1, 0.1, 3.0), materials.metal)
        if rng.random() < 0.7:
            a, b, c = rng.uniform((0.4, 0.4, 0.5), (1.4, 0.9, 1.9))
            s.box((float(x) + 0.95, front + rng.uniform(0.8, 3.0)), (a, b, c), materials.books)
    inside = materials.plaster(rng, x1 - x0, 3.0, s.density)
    fittings.furnish(inside, rng, s.density, (fittings.poster, fittings.board), gap=1.0)
    back = Skin(inside, x1 - x0, 3.0)
    s.solids.append(Solid((x0, front + 4.0, 0.0), (x1, front + 4.0, 3.0), back, opacity=0.55))
    s.box(((x0 + x1) / 2.0, front + 4.0), (x1 - x0, 0.2, 5.0), materials.brick, foot=3.0)
    for x in np.arange(s.low[0] - 20.0, s.high[0] + 20.0, 9.0 * s.scale):
        place, width = float(x + rng.uniform(0.0, 3.0)), rng.uniform(4.0, 6.0)
        near, height = front - s.low[1] + rng.uniform(7.0, 14.0), rng.uniform(5.0, 9.0)
        wall = rng.choice(np.array([materials.brick, materials.plaster]))
        for y in (front - near - 6.0, front + near):  # the real one, and its image behind the glass
            s.house((place, y), (place + width, y + 6.0), height, wall, 40.0)
    for x in np.arange(s.low[0] - rng.uniform(4.0, 10.0), s.high[0] + 8.0, 6.3 * s.scale):
        s.car((float(x), s.low[1] - 3.2))
    return s.outdoors(fittings.tiles(rng, 12.0, 60.0, 0.4, 115.0), 12.0)


def _pane(rng: np.random.Generator, width: float, height: float, density: float) -> materials.Image:
    """Glass with streaks, a bar and a sticker."""
    image = materials.canvas(width, height, density, 120.0)
    image += 18.0 * materials.fractal(rng, image.shape, 0.8 * density, 0.7)
    materials.fill(image, density, 0.0, 0.95, width, 0.05, 60.0)
    u, v = rng.uniform((0.1, 0.6), (1.2, 1.6))
    materials.fill(image, density, u, v, 0.35, 0.25, rng.uniform(20.0, 250.0))
    return image


def moving_light(rng: np.random.Generator, way: Floats) -> World:
    """A furnished room over whose walls shadows and patches of light glide, all round, while nothing else moves."""
    s = Site(rng, way)
    low, high = s.around(2.2)
    s.room(low, high, 3.0, materials.plaster)
    for x, y in s.grid(1.6, (2.3, 2.9)):
        if rng.random() < 0.5 and s.claim((x, y), (0.8, 0.8)):
            a, b, c = rng.uniform((0.3, 0.3, 0.4), (0.8, 0.8, 1.6))
            material = (materials.cardboard, materials.metal, materials.books)[int(rng.integers(3))]
            s.box((x, y), (a, b, c), material)
    return s.indoors(fittings.tiles(rng, 9.0, 100.0, 0.5, 110.0), 9.0, 3.0, _patches(rng, low, high))


def _patches(rng: np.random.Generator, low: Corner, high: Corner) -> Crowd:
    """Two shadows and two patches of light to and fro along each wall of a room, 3 to 12 cm before it."""
    (x0, y0), (x1, y1) = low, high
    dark, bright = (Skin(materials.canvas(1.0, 1.0, 32.0, grey), 1.0, 1.0) for grey in (15.0, 255.0))
    moving = []
    for wall, (start, end) in enumerate(
        (((x0, y0), (x1, y0)), ((x0, y1), (x1, y1)), ((x0, y0), (x0, y1)), ((x1, y0), (x1, y1)))
    ):
        for layer, skin in enumerate((dark, bright, dark, bright)):
            inset = (0.03 + 0.03 * layer) * (1.0 if wall in (0, 2) else -1.0)
            path = pacing(start, end, rng.uniform(0.2, 1.2), rng.uniform(0.0, 2.0))
            moving.append((path, wall < 2, inset, skin, *rng.uniform((0.4, 0.0, 0.8), (1.6, 0.9, 1.9)).tolist()))

    def at(t: float) -> tuple[Solid, ...]:
        solids = []
        for path, along_x, inset, skin, half, foot, tall in moving:
            x, y = path(t)
            if along_x:
                a, b = (max(x - half, x0 + 0.2), y + inset), (min(x + half, x1 - 0.2), y + inset)
            else:
                a, b = (x + inset, max(y - half, y0 + 0.2)), (x + inset, min(y + half, y1 - 0.2))
            solids.append(Solid((*a, foot), (*b, foot + tall), skin, opacity=0.35))
        return tuple(solids)

    return at


def rubble(rng: np.random.Generator, way: Floats) -> World:
    """Ruins: debris of all sizes on bare earth inside walls that are broken off at all heights."""
    s = Site(rng, way, OUTDOOR_DENSITY)
    (x0, y0), (x1, y1) = s.around(3.5)
    kinds = (materials.brick, materials.concrete, materials.planks)
    for x, y in rng.uniform((x0, y0), (x1, y1), (round(1.6 * (x1 - x0) * (y1 - y0)), 2)).tolist():
        size = 0.12 * (1.0 - rng.random()) ** -0.7  # many small, few large
        a, b, c = np.minimum(size * rng.uniform(0.5, 1.5, 3), (1.5, 1.5, 1.8)).tolist()
        if s.claim((x, y), (a, b)):
            s.box((x, y), (a, b, c), kinds[int(rng.integers(3))])
    for y in (y0 - 0.9, y1 + 0.9):
        for x in np.arange(x0, x1, 0.6):
            s.box((float(x), y), (0.6, 0.4, rng.uniform(0.2, 2.8)), materials.brick)
    for x in (x0 - 0.9, x1 + 0.9):
        for y in np.arange(y0, y1, 0.6):
            s.box((x, float(y)), (0.4, 0.6, rng.uniform(0.2, 2.8)), materials.concrete)
    s.house((x0 - 30.0, y1 + 12.0), (x0 - 12.0, y1 + 22.0), 9.0, materials.concrete, 30.0)
    return s.outdoors(fittings.dirt(rng, 16.0, 64.0, 120.0), 16.0)


Place = Callable[[np.random.Generator, Floats], World]

_PLACES: tuple[Place, ...] = (
    *(storage_racks, car_park, colonnade, white_gallery),
    *(foggy_field, glass_front, moving_light, rubble),
)
HELD_OUT: Mapping[str, Place] = MappingProxyType({place.__name__: place for place in _PLACES})
