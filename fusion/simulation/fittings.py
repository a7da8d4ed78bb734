"""What hangs on walls: doors, windows, posters, radiators, boards; and the grounds that people walk on.

Things are painted into a wall's texture in place; positions and sizes are in metres, `bottom` above the floor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from fusion.simulation.materials import Image, canvas, cells, fill, fractal, joints

Fitting = Callable[[Image, np.random.Generator, float, float], float]


def door(image: Image, rng: np.random.Generator, density: float, left: float) -> float:
    """A door in its frame, panels and handle; returns the width used, m."""
    grey = rng.uniform(60, 130)
    fill(image, density, left, 0.0, 1.06, 2.08, grey * 0.6)
    fill(image, density, left + 0.07, 0.0, 0.92, 2.0, grey)
    for bottom, tall in ((0.15, 0.6), (0.9, 0.45), (1.45, 0.45)):
        fill(image, density, left + 0.19, bottom, 0.68, tall, grey * 0.8)
        fill(image, density, left + 0.22, bottom + 0.03, 0.62, tall - 0.06, grey * 1.08)
    fill(image, density, left + 0.86, 1.0, 0.1, 0.03, 225.0)
    fill(image, density, left + 0.35, 1.62, 0.3, 0.1, 215.0)
    return 1.06


def window(image: Image, rng: np.random.Generator, density: float, left: float) -> float:
    """A window of two panes with daylight, a skyline and a sill."""
    fill(image, density, left, 0.85, 1.5, 1.35, 205.0)
    view = canvas(0.66, 1.2, density, 238.0)
    skyline = (0.35 + 0.12 * fractal(rng, (4, 2 * view.shape[1]), 0.3 * density)[0]) * view.shape[0]
    below = np.arange(view.shape[0])[:, None] > view.shape[0] - skyline[None, :]
    for pane in range(2):
        part = np.where(below[:, pane * view.shape[1] : (pane + 1) * view.shape[1]], 135.0, view)
        paste(image, np.asarray(part, np.float32), density, left + 0.07 + 0.71 * pane, 0.92)
    fill(image, density, left - 0.05, 0.8, 1.6, 0.05, 220.0)
    return 1.55


def poster(image: Image, rng: np.random.Generator, density: float, left: float) -> float:
    """A poster: heading, picture, lines of text."""
    width, height = rng.uniform(0.4, 0.9), rng.uniform(0.5, 1.0)
    bottom = rng.uniform(0.95, 1.2)
    fill(image, density, left - 0.01, bottom - 0.01, width + 0.02, height + 0.02, 60.0)
    paper = canvas(width, height, density, rng.uniform(185, 240))
    rows, columns = paper.shape
    picture = paper[int(0.2 * rows) : int(0.62 * rows), int(0.1 * columns) : int(0.9 * columns)]
    picture[:] = 110.0 + 55.0 * fractal(rng, (picture.shape[0], picture.shape[1]), 0.2 * density)
    cv2.circle(
        paper, (int(rng.uniform(0.3, 0.7) * columns), int(0.4 * rows)), int(0.12 * columns), 30.0, -1, cv2.LINE_AA
    )
    fill(paper, density, 0.1 * width, 0.85 * height, rng.uniform(0.5, 0.8) * width, 0.07 * height, 25.0)
    for line in np.arange(0.06, 0.34, 0.05):
        fill(paper, density, 0.1 * width, line * height, rng.uniform(0.4, 0.8) * width, 0.018 * height, 70.0)
    paste(image, paper, density, left, bottom)
    return float(width)


def board(image: Image, rng: np.random.Generator, density: float, left: float) -> float:
    """A notice board with sheets pinned to it."""
    fill(image, density, left, 0.9, 1.6, 1.0, 75.0)
    fill(image, density, left + 0.04, 0.94, 1.52, 0.92, 125.0)
    for _ in range(9):
        u, v, grey = rng.uniform(0.08, 1.25), rng.uniform(1.0, 1.5), rng.uniform(170, 250)
        fill(image, density, left + u, v, 0.21, 0.297, grey)
        for line in range(6):
            fill(image, density, left + u + 0.02, v + 0.04 + 0.035 * line, rng.uniform(0.05, 0.16), 0.01, 80.0)
    return 1.6


def radiator(image: Image, rng: np.random.Generator, density: float, left: float) -> float:
    """A radiator: ribs with shadow between them."""
    for rib in np.arange(0.0, 1.2, 0.06):
        fill(image, density, left + rib, 0.12, 0.045, 0.6, 205.0)
        fill(image, density, left + rib + 0.045, 0.14, 0.015, 0.56, 80.0)
    return 1.2


def panel(image: Image, rng: np.random.Generator, density: float, left: float) -> float:
    """Small things: a switch, an extinguisher, a sign, a cable duct up the wall."""
    fill(image, density, left, 1.05, 0.08, 0.08, 240.0)
    fill(image, density, left + 0.02, 1.1, 0.03, 2.0, 195.0)
    fill(image, density, left + 0.25, 0.5, 0.15, 0.45, rng.uniform(50, 80))
    fill(image, density, left + 0.2, 1.5, 0.25, 0.25, 90.0)
    fill(image, density, left + 0.23, 1.53, 0.19, 0.19, 235.0)
    return 0.5


INDOOR: Sequence[Fitting] = (door, poster, board, radiator, panel, poster, window)
PASSAGE: Sequence[Fitting] = (door, poster, panel, board, poster)
STORE: Sequence[Fitting] = (door, panel, poster, panel)


def furnish(
    image: Image, rng: np.random.Generator, density: float, fittings: Sequence[Fitting] = INDOOR, gap: float = 0.7
) -> Image:
    """Hang `fittings` along a wall with about `gap` m between them, and a skirting board; paints in place."""
    length = image.shape[1] / density
    left = rng.uniform(0.1, gap)
    while left < length - 1.7:
        hang = fittings[int(rng.integers(len(fittings)))]
        left += hang(image, rng, density, left) + gap * rng.uniform(0.4, 1.8)
    fill(image, density, 0.0, 0.0, length, 0.08, 75.0)
    return image


def facade(rng: np.random.Generator, wall: Image, density: float, storey: float = 3.2) -> Image:
    """Cut rows of windows into an outer wall, a plinth and a cornice; paints in place."""
    height, length = wall.shape[0] / density, wall.shape[1] / density
    for floor in np.arange(1.1, height - 1.9, storey):
        for left in np.arange(0.7, length - 1.4, 2.3):
            glass = rng.uniform(35, 90) if rng.random() < 0.8 else rng.uniform(150, 230)
            fill(wall, density, left - 0.08, floor - 0.08, 1.36, 1.66, 205.0)
            fill(wall, density, left, floor, 1.2, 1.5, glass)
            fill(wall, density, left, floor + rng.uniform(0.7, 1.2), 1.2, 0.3, glass * 0.75 + 50.0)
            fill(wall, density, left + 0.56, floor, 0.07, 1.5, 190.0)
    wall[-round(0.5 * density) :] *= 0.65
    fill(wall, density, 0.0, height - 0.35, length, 0.12, 215.0)
    return wall


def paste(image: Image, part: Image, density: float, left: float, bottom: float) -> None:
    """Put `part` into `image`, its lower left corner at (`left`, `bottom`) m; what sticks out is cut."""
    u0 = round(left * density)
    v1 = image.shape[0] - round(bottom * density)
    v0 = max(v1 - part.shape[0], 0)
    target = image[v0:v1, max(u0, 0) : u0 + part.shape[1]]
    target[:] = part[part.shape[0] - target.shape[0] :, : target.shape[1]]


def tiles(rng: np.random.Generator, size: float, density: float, tile: float, grey: float) -> Image:
    """Square ground of `size` m paved with tiles of `tile` m."""
    image = canvas(size, size, density, grey)
    shape = (tile * density, tile * density)
    image += 7.0 * cells(rng, image.shape, shape) + 6.0 * fractal(rng, image.shape, 2.0 * density, 0.75)
    return image - 40.0 * joints(image.shape, shape, max(1.0, 0.012 * density))


def dirt(rng: np.random.Generator, size: float, density: float, grey: float) -> Image:
    """Square ground of `size` m: earth, gravel and patches of grass."""
    image = canvas(size, size, density, grey)
    image += 15.0 * fractal(rng, image.shape, 4.0 * density, 0.75)
    patches = np.clip(fractal(rng, image.shape, 2.5 * density, 0.6), 0, 1.5)
    return image - 18.0 * patches * (1.0 + 0.4 * fractal(rng, image.shape, 4))
