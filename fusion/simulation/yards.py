"""The outdoor places where experiments happen: school yards, walls along concrete panels, rough ground with trees."""

from __future__ import annotations

import numpy as np

from fusion.simulation import fittings, materials
from fusion.simulation.builder import OUTDOOR_DENSITY, Builder
from fusion.simulation.world import World


def _panels(rng: np.random.Generator) -> materials.Image:
    """24 x 24 m of concrete panels of 3 m."""
    return fittings.tiles(rng, 24.0, 48.0, 3.0, 140.0)


def _surroundings(b: Builder) -> None:
    """What stands round all the yards: houses at 20 to 50 m, trees, lamps, a fence."""
    b.house((44.0, -25.0), (56.0, 18.0), 10.0, materials.plaster, 30.0)
    b.house((-45.0, -10.0), (-32.0, 22.0), 13.0, materials.brick, 30.0)
    b.house((-20.0, 34.0), (12.0, 44.0), 9.0, materials.plaster, 30.0)
    for x, y, height in (
        (18.0, 24.0, 7.0),
        (-22.0, -24.0, 8.0),
        (6.0, -27.0, 9.0),
        (24.0, -30.0, 6.0),
        (-28.0, 28.0, 9.0),
    ):
        b.tree((x, y), height)
    for x, y in ((14.0, 18.0), (-14.0, -17.0), (20.0, -16.0)):
        b.pole((x, y), 0.08, 5.0, materials.metal)


def school_yard(rng: np.random.Generator) -> World:
    """A wide yard; the nearest things are 2 m away (paper, 4.2)."""
    b = Builder(rng, OUTDOOR_DENSITY)
    _surroundings(b)
    b.box((0.6, 2.5), (1.8, 0.5, 0.45), materials.planks)
    b.box((-2.8, -1.4), (0.9, 0.9, 0.6), materials.concrete)
    b.tree((5.5, -4.0), 5.0)
    b.box((-6.0, 7.0), (2.0, 0.6, 1.1), materials.metal)
    b.car((9.0, 6.0))
    b.pole((-4.0, -8.0), 0.1, 4.0, materials.metal)
    return b.outdoors(_panels(rng), 24.0)


def long_wall(rng: np.random.Generator) -> World:
    """A house's wall along y = 2.2 m from x = 0, 29 m long; across the panels cars, trees, a hedge and other houses."""
    b = Builder(rng, OUTDOOR_DENSITY)
    _surroundings(b)
    wall = materials.plaster(rng, 29.0, 6.0, 100.0)
    fittings.facade(rng, wall, 100.0)
    b.wall((0.0, 2.2), (29.0, 2.2), wall, 6.0, hull=False)
    b.car((9.0, -3.4))
    b.box((17.0, -2.0), (1.8, 0.5, 0.45), materials.planks)
    b.box((12.0, -11.0), (26.0, 1.0, 1.3), materials.foliage)
    b.house((2.0, -24.0), (24.0, -16.0), 7.0, materials.plaster, 40.0)
    b.tree((13.0, -6.0), 5.0)
    b.tree((27.0, -7.5), 6.0)
    b.tree((36.0, -3.0), 5.0)
    b.car((34.0, 5.0))
    b.tree((-3.0, -5.0), 6.0)
    b.box((-6.0, 4.0), (1.2, 0.9, 1.3), materials.metal)
    for k in range(6):
        b.pole((20.0 + 1.5 * k, -4.0), 0.04, 1.1, materials.metal)
    return b.outdoors(_panels(rng), 24.0)


def rough_field(rng: np.random.Generator) -> World:
    """Earth and grass between trees, stumps and crates."""
    b = Builder(rng, OUTDOOR_DENSITY)
    _surroundings(b)
    for x, y, height in (
        (3.4, 2.4, 4.5),
        (-0.8, 3.4, 4.0),
        (7.0, -1.8, 5.5),
        (3.0, -3.6, 4.5),
        (-4.5, -2.0, 6.0),
        (9.5, 4.5, 7.0),
    ):
        b.tree((x, y), height)
    b.box((5.2, 5.2), (0.8, 0.8, 0.7), materials.planks)
    b.pole((0.2, -2.2), 0.3, 0.5, materials.bark)
    b.box((-6.0, 5.5), (2.4, 1.2, 1.0), materials.planks)
    return b.outdoors(fittings.dirt(rng, 16.0, 64.0, 95.0), 16.0)
