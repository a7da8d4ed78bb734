"""Puts worlds together: walls, furniture, trees, houses, each with its own texture."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fusion.simulation import fittings, materials
from fusion.simulation.fittings import Fitting
from fusion.simulation.materials import Image, Material, canvas, fractal
from fusion.simulation.surfaces import Ground, Skin, Sky
from fusion.simulation.world import Crowd, Solid, World, nobody

INDOOR_DENSITY = 160.0  # texels per metre, 6 mm: a wall 1 m away fills a pixel of 1024 columns
OUTDOOR_DENSITY = 80.0


class Builder:
    """Collects solids; every call adds to the world and none looks back.

    Parameters
    ----------
    rng : numpy.random.Generator
        Chooses tones, patterns and what hangs where.
    density : float
        Texels per metre of walls and furniture.
    """

    def __init__(self, rng: np.random.Generator, density: float = INDOOR_DENSITY) -> None:
        self.rng = rng
        self.density = density
        self.solids: list[Solid] = []
        self._lid = Ground(120.0 + 14.0 * fractal(rng, (256, 256), 64), 4.0)
        self._leaves = Ground(materials.foliage(rng, 4.0, 4.0, 64.0) - 25.0, 4.0)

    def skin(self, material: Material, width: float, height: float, shade: float = 1.0) -> Skin:
        """A texture of `material`, `shade` times as bright."""
        return Skin(material(self.rng, width, height, self.density) * np.float32(shade), width, height)

    def box(
        self, centre: tuple[float, float], size: tuple[float, float, float], material: Material, foot: float = 0.0
    ) -> None:
        """A box of `size` (x, y, z) m round `centre`, `foot` m above the ground."""
        (x, y), (a, b, c) = centre, size
        image = material(self.rng, 2 * (a + b), c, self.density)
        _light_faces(image, a, b)
        low, high = (x - a / 2, y - b / 2, foot), (x + a / 2, y + b / 2, foot + c)
        self.solids.append(Solid(low, high, Skin(image, 2 * (a + b), c), self._lid))

    def pole(
        self, centre: tuple[float, float], radius: float, height: float, material: Material, foot: float = 0.0
    ) -> None:
        """An upright cylinder."""
        cap = self._leaves if material is materials.foliage else self._lid
        (x, y), around = centre, 2 * np.pi * radius
        image = material(self.rng, around, height, self.density)
        angle = 2.0 * np.pi * np.arange(image.shape[1]) / image.shape[1]
        image *= (0.8 + 0.25 * np.cos(angle - 2.0)).astype(np.float32)
        low, high = (x - radius, y - radius, foot), (x + radius, y + radius, foot + height)
        self.solids.append(Solid(low, high, Skin(image, around, height), cap, round=True))

    def tree(self, centre: tuple[float, float], height: float) -> None:
        """A trunk and a crown of rounds, widest below the middle."""
        self.pole(centre, 0.02 * height + 0.05, 0.36 * height, materials.bark)
        foot = 0.36
        for tall, radius in ((0.08, 0.14), (0.12, 0.21), (0.14, 0.25), (0.12, 0.22), (0.10, 0.16), (0.08, 0.09)):
            wide = radius * height * self.rng.uniform(0.85, 1.1)
            self.pole(centre, wide, tall * height, materials.foliage, foot * height)
            foot += tall

    def car(self, centre: tuple[float, float]) -> None:
        """A parked car along x."""
        self.box(centre, (4.2, 1.7, 0.62), materials.coachwork, foot=0.22)
        self.box((centre[0] - 0.2, centre[1]), (2.3, 1.5, 0.55), materials.car_windows, foot=0.84)
        for x in (-1.4, 1.4):
            for y in (-0.68, 0.68):
                self.box((centre[0] + x, centre[1] + y), (0.6, 0.18, 0.22), materials.rubber)

    def wall(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        image: Image,
        height: float,
        hull: bool = True,
        repeat: float | None = None,
    ) -> None:
        """A plate from `start` to `end` along x or y, `height` m tall, with one texture on both faces.

        The texture spans the length of the wall, or is repeated every `repeat` m.
        """
        (x0, x1), (y0, y1) = sorted((start[0], end[0])), sorted((start[1], end[1]))
        skin = Skin(image, x1 - x0 + y1 - y0 if repeat is None else repeat, height)
        self.solids.append(Solid((x0, y0, 0.0), (x1, y1, height), skin, None, hull=hull))

    def room(
        self,
        low: tuple[float, float],
        high: tuple[float, float],
        height: float,
        material: Material,
        things: Sequence[Fitting] = fittings.INDOOR,
        gap: float = 0.7,
    ) -> None:
        """Four outer walls with `things` on them, each in the light of its direction."""
        (x0, y0), (x1, y1) = low, high
        sides = (
            ((x0, y0), (x1, y0), 0.92),
            ((x1, y0), (x1, y1), 1.08),
            ((x1, y1), (x0, y1), 1.0),
            ((x0, y1), (x0, y0), 0.8),
        )
        for start, end, shade in sides:
            length = abs(end[0] - start[0]) + abs(end[1] - start[1])
            image = material(self.rng, length, height, self.density) * np.float32(shade)
            fittings.furnish(image, self.rng, self.density, things, gap)
            _darken_ends(image, self.density)
            self.wall(start, end, image, height)

    def block(
        self,
        low: tuple[float, float],
        high: tuple[float, float],
        height: float,
        material: Material,
        things: Sequence[Fitting] = fittings.INDOOR,
    ) -> None:
        """A part of the building inside the outer walls, with `things` on its walls."""
        a, b = high[0] - low[0], high[1] - low[1]
        image = material(self.rng, 2 * (a + b), height, self.density)
        fittings.furnish(image, self.rng, self.density, things)
        self._block(low, high, height, image)

    def house(
        self, low: tuple[float, float], high: tuple[float, float], height: float, material: Material, density: float
    ) -> None:
        """A building with windows on all sides, `density` texels per metre."""
        image = material(self.rng, 2 * (high[0] - low[0] + high[1] - low[1]), height, density)
        self._block(low, high, height, fittings.facade(self.rng, image, density))

    def _block(self, low: tuple[float, float], high: tuple[float, float], height: float, image: Image) -> None:
        a, b = high[0] - low[0], high[1] - low[1]
        _light_faces(image, a, b)
        self.solids.append(Solid((*low, 0.0), (*high, height), Skin(image, 2 * (a + b), height), self._lid))

    def indoors(self, floor: Image, floor_size: float, height: float, crowd: Crowd = nobody) -> World:
        """The finished world under a ceiling with lamps."""
        ceiling = Ground(_lamps(self.rng), 6.0)
        return World(tuple(self.solids), Ground(floor, floor_size), ceiling, height, None, crowd)

    def outdoors(self, floor: Image, floor_size: float, crowd: Crowd = nobody) -> World:
        """The finished world under the sky, with woods and hills far away."""
        return World(tuple(self.solids), Ground(floor, floor_size), None, 0.0, sky(self.rng), crowd)


def sky(rng: np.random.Generator) -> Sky:
    """Clouds over a gradient, the sun's glow, a far line of hills and trees."""
    rows, columns = 1152, 4096
    lowest = np.deg2rad(-11.25)
    elevation = np.linspace(90.0, -11.25, rows)[:, None]
    glow = np.exp(-(((np.arange(columns) / columns - 0.3) / 0.15) ** 2))[None, :]
    image = (195.0 - 0.45 * elevation + 25.0 * glow).astype(np.float32)
    clouds = cv2.resize(_round(rng, (rows // 4, columns // 4), 100.0), (columns, rows), interpolation=cv2.INTER_CUBIC)
    image += 13.0 * np.clip(clouds, -1.0, 1.6) * np.clip((elevation - 2.0) / 20.0, 0.0, 1.0).astype(np.float32)
    degrees = columns / 360.0
    low = slice(np.searchsorted(-elevation[:, 0], -9.0), rows)  # nothing on the horizon is higher
    for grey, height, rough, scale in ((150.0, 3.5, 1.5, 60.0), (110.0, 2.0, 1.0, 12.0), (75.0, 1.0, 0.8, 3.0)):
        line = height + rough * _round(rng, (4, columns), scale * degrees)[1]
        inside = np.clip((line[None, :] - elevation[low]) * degrees, 0.0, 1.0).astype(np.float32)
        wood = grey + 0.12 * grey * _round(rng, (inside.shape[0], columns), 2.0 * degrees)
        image[low] += inside * (wood - image[low])
    return Sky(np.clip(cv2.GaussianBlur(image, (0, 0), 1.0), 0, 255), lowest)


def _round(rng: np.random.Generator, shape: tuple[int, int], coarse: float) -> Image:
    """Noise whose columns close into a circle: the overlap of two ends is cross-faded."""
    overlap = shape[1] // 8
    wide = fractal(rng, (shape[0], shape[1] + overlap), coarse)
    fade = np.linspace(0.0, np.pi / 2.0, overlap, dtype=np.float32)
    image = wide[:, : shape[1]].copy()
    image[:, :overlap] = np.sin(fade) * image[:, :overlap] + np.cos(fade) * wide[:, shape[1] :]
    return np.asarray(image, np.float32)


def _light_faces(image: Image, length: float, depth: float) -> None:
    """Give the four faces of a box their share of the light; paints in place."""
    edges = np.cumsum([0.0, length, depth, length, depth]) / (2.0 * (length + depth)) * image.shape[1]
    for start, end, shade in zip(edges[:-1], edges[1:], (1.05, 0.8, 0.65, 0.95), strict=True):
        image[:, round(start) : round(end)] *= shade


def _darken_ends(image: Image, density: float) -> None:
    """Corners of rooms lie in shadow; paints in place."""
    from_end = (np.minimum(np.arange(image.shape[1]), np.arange(image.shape[1])[::-1]) / density).astype(np.float32)
    image *= 1.0 - 0.25 * np.exp(-from_end / 0.35)


def _lamps(rng: np.random.Generator) -> Image:
    """Ceiling panels of 60 cm with strip lights, 6 x 6 m."""
    image = fittings.tiles(rng, 6.0, 64.0, 0.6, 150.0)
    for x in (1.2, 4.2):
        for y in (0.6, 3.6):
            materials.fill(image, 64.0, x, y, 0.24, 1.5, 250.0)
    return image


def plain(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """A smooth painted surface with hardly anything to see."""
    image = canvas(width, height, density, 150.0)
    return image + 1.5 * fractal(rng, image.shape, 1.5 * density, 0.5)
