"""The indoor places where experiments happen; a place is a function that builds a world with a source of chance."""

from __future__ import annotations

import numpy as np

from fusion.simulation import fittings, materials
from fusion.simulation.builder import Builder
from fusion.simulation.people import circling, crowd, pacing
from fusion.simulation.surfaces import Ground
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


def close_room(rng: np.random.Generator) -> World:
    """A full office round the robot: furniture within a metre, a door 5 m ahead (paper, 4.2)."""
    b = Builder(rng)
    b.room((-1.7, -1.8), (5.1, 2.3), 2.8, materials.plaster, gap=0.4)
    b.box((0.3, 1.3), (1.6, 0.7, 0.75), materials.planks)
    b.box((0.1, 1.4), (0.45, 0.2, 0.4), materials.metal, foot=0.75)
    b.box((-1.4, 0.0), (0.5, 1.4, 2.0), materials.books)
    b.box((0.6, -1.5), (1.2, 0.5, 1.9), materials.metal)
    b.box((-0.6, -1.4), (0.5, 0.5, 0.5), materials.cardboard)
    b.box((-0.6, -1.4), (0.4, 0.4, 0.4), materials.cardboard, foot=0.5)
    b.box((2.6, 2.0), (1.4, 0.5, 2.0), materials.books)
    b.box((3.4, -1.4), (1.6, 0.7, 0.75), materials.planks)
    return b.indoors(fittings.tiles(rng, 6.0, 120.0, 0.5, 105.0), 6.0, 2.8)


def passage(rng: np.random.Generator) -> World:
    """Two rooms joined by a passage 1.3 m wide and 7.4 m long; the paving's joints lead through it (paper, 4.3)."""
    b = Builder(rng)
    b.room((-5.0, -4.0), (13.0, 4.0), 2.8, materials.plaster)
    b.block((0.3, 0.65), (7.7, 4.0), 2.8, materials.brick, fittings.PASSAGE)
    b.block((0.3, -4.0), (7.7, -0.65), 2.8, materials.plaster, fittings.PASSAGE)
    b.box((-2.5, 3.4), (1.6, 0.7, 1.9), materials.metal)
    b.box((-3.8, -2.6), (0.8, 1.4, 0.8), materials.planks)
    b.box((11.0, 2.6), (1.0, 1.0, 0.9), materials.cardboard)
    b.box((12.6, -1.5), (0.5, 2.0, 2.1), materials.books)
    b.pole((9.6, -2.4), 0.18, 2.8, materials.concrete)
    return b.indoors(fittings.tiles(rng, 9.0, 100.0, 0.5, 110.0), 9.0, 2.8)


def hall(rng: np.random.Generator) -> World:
    """A store of 11 x 10 m with goods along its sides and in its middle, so that a square of 5 m leads past things."""
    b = Builder(rng)
    b.room((-1.6, -1.3), (9.4, 8.6), 3.6, materials.concrete, fittings.STORE, gap=1.2)
    b.box((2.5, 2.6), (1.2, 1.0, 0.9), materials.cardboard)
    b.box((2.4, 2.6), (0.6, 0.5, 0.5), materials.cardboard, foot=0.9)
    b.box((8.8, 2.5), (0.8, 2.4, 2.2), materials.books)
    b.box((7.8, 5.4), (0.9, 1.2, 1.0), materials.planks)
    b.box((1.2, 6.8), (2.6, 0.8, 1.8), materials.metal)
    b.box((4.4, 6.2), (0.9, 0.7, 0.6), materials.cardboard)
    b.pole((-0.9, 2.5), 0.15, 3.6, materials.concrete)
    b.pole((8.2, 7.4), 0.15, 3.6, materials.concrete)
    b.box((8.6, -0.6), (1.2, 1.2, 1.5), materials.planks)
    return b.indoors(fittings.tiles(rng, 12.0, 80.0, 1.0, 100.0), 12.0, 3.6)


def pillars(rng: np.random.Generator) -> World:
    """A hall of 15 x 8 m with a row of pillars to weave through."""
    b = Builder(rng)
    b.room((-2.5, -3.5), (12.5, 4.5), 3.2, materials.plaster)
    for k in range(5):
        b.pole((2.08 * k, 0.0), 0.14, 3.2, materials.brick if k % 2 else materials.concrete)
    b.box((3.0, 3.9), (2.4, 0.5, 2.0), materials.books)
    b.box((8.5, -3.0), (1.8, 0.7, 1.9), materials.metal)
    b.box((5.5, -2.9), (0.9, 0.7, 0.7), materials.cardboard)
    b.box((11.7, 2.5), (0.8, 1.2, 1.2), materials.planks)
    return b.indoors(fittings.tiles(rng, 8.0, 100.0, 0.4, 112.0), 8.0, 3.2)


def crowded_lobby(rng: np.random.Generator) -> World:
    """A lobby of 14 x 10 m where eight people walk about, two of them round the robot."""
    b = Builder(rng)
    b.room((-5.0, -5.0), (9.0, 5.0), 3.4, materials.plaster)
    b.box((5.5, 4.4), (3.0, 0.7, 1.1), materials.planks)
    b.box((-4.6, -2.0), (0.5, 2.5, 2.0), materials.books)
    b.pole((2.0, 3.0), 0.2, 3.4, materials.concrete)
    b.pole((2.0, -3.0), 0.2, 3.4, materials.concrete)
    paths = (
        circling((0.0, 0.0), 1.5, 0.9, 3.5),
        circling((0.0, 0.0), 2.2, -0.8),
        pacing((-3.5, 1.2), (8.0, 1.4), 1.3, 0.2),
        pacing((8.0, -1.3), (-3.5, -1.1), 1.1, 0.5),
        pacing((5.6, -4.2), (5.8, 3.6), 1.0, 0.8),
        pacing((4.5, 4.2), (4.3, -4.2), 1.2, 0.1),
        pacing((-3.8, 3.9), (8.0, 3.7), 1.4, 0.6),
        pacing((8.0, -3.8), (-3.4, -4.0), 1.2, 0.9),
    )
    return b.indoors(fittings.tiles(rng, 9.0, 100.0, 0.6, 125.0), 9.0, 3.4, crowd(rng, paths))


def symmetric_corridor(rng: np.random.Generator) -> World:
    """A corridor of 37.5 x 2.4 m that repeats every 2.5 m and looks the same after half a turn."""
    b = Builder(rng)
    period, height, half, length = 2.5, 2.6, 1.2, 37.5
    tile = materials.plaster(rng, period, height, b.density)
    fittings.door(tile, rng, b.density, 0.15)
    fittings.poster(tile, rng, b.density, 1.45)
    end = materials.plaster(rng, 2.0 * half, height, b.density)
    fittings.window(end, rng, b.density, 0.5)
    for side in (-1.0, 1.0):
        b.wall((-length / 2, side * half), (length / 2, side * half), tile, height, repeat=period)
        b.wall((side * length / 2, -half), (side * length / 2, half), end, height)
    floor = fittings.tiles(rng, period, 200.0, period / 10.0, 110.0)
    roof = fittings.tiles(rng, period, 128.0, period / 4.0, 150.0)
    materials.fill(roof, 128.0, 0.0, 0.0, 0.7, 0.15, 250.0)
    floor, roof = ((image + image[::-1, ::-1]) / 2.0 for image in (floor, roof))
    return World(tuple(b.solids), Ground(floor, period), Ground(roof, period), height)
