"""The places where experiments happen; a place is a function that builds its world with a given source of chance."""

from __future__ import annotations

import numpy as np

from fusion.simulation import fittings, materials
from fusion.simulation.builder import Builder
from fusion.simulation.world import World


def laboratory(rng: np.random.Generator) -> World:
    """A room of 11 x 8 m, furnished along its walls, with a pillar and boxes standing about."""
    b = Builder(rng)
    b.room((-4.0, -3.0), (7.0, 5.0), 2.9, materials.plaster)
    b.box((2.5, 4.6), (1.8, 0.6, 1.9), materials.metal)
    b.box((-3.7, 1.5), (0.4, 2.4, 2.1), materials.books)
    b.box((6.6, -0.5), (0.5, 1.8, 2.0), materials.books)
    b.box((1.0, -2.6), (1.6, 0.7, 0.75), materials.planks)
    b.box((0.8, -2.6), (0.4, 0.3, 0.35), materials.cardboard, foot=0.75)
    b.box((4.6, -2.6), (0.6, 0.5, 0.5), materials.cardboard)
    b.box((-0.6, 4.5), (0.8, 0.6, 0.7), materials.cardboard)
    b.pole((4.4, 2.2), 0.16, 2.9, materials.concrete)
    return b.indoors(fittings.tiles(rng, 9.0, 100.0, 0.3, 115.0), 9.0, 2.9)
