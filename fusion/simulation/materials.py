"""What surfaces are made of: procedural grey textures with structure on every scale.

Each material is a function ``(rng, width, height, density) -> image`` where `width` and `height` are in metres,
`density` in texels per metre, and the image is float32 of shape (round(height * density), round(width * density)),
grey 0..255, row 0 at the top. Sizes of bricks, planks and panels are those of the real things.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
Material = Callable[[np.random.Generator, float, float, float], Image]


def canvas(width: float, height: float, density: float, grey: float) -> Image:
    """A plain surface of `width` x `height` m at `density` texels per metre."""
    shape = (max(4, round(height * density)), max(4, round(width * density)))
    return np.full(shape, grey, np.float32)


def fractal(rng: np.random.Generator, shape: tuple[int, int], coarse: float, persistence: float = 0.6) -> Image:
    """Noise of unit deviation with detail from `coarse` texels down to 2, each octave `persistence` of the last."""
    total = np.zeros(shape, np.float32)
    cell, weight, power = max(float(coarse), 2.0), 1.0, 0.0
    while cell >= 2.0:
        rows, columns = (int(np.ceil(n / cell)) + 1 for n in shape)
        grid = rng.standard_normal((rows, columns), dtype=np.float32)
        total += weight * cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_CUBIC)
        power += weight**2
        cell, weight = cell / 2.0, weight * persistence
    # A cubic blow-up of white noise keeps about half its variance.
    return total / np.float32(np.sqrt(0.5 * power))


def cells(rng: np.random.Generator, shape: tuple[int, int], size: tuple[float, float], bond: float = 0.0) -> Image:
    """One random number of unit deviation per (height, width) cell in texels; `bond` shifts every second course."""
    row = (np.arange(shape[0]) / size[0]).astype(int)
    column = np.arange(shape[1])[None, :] / size[1] + bond * (row[:, None] % 2)
    table = rng.standard_normal((row[-1] + 1, int(column.max()) + 1), dtype=np.float32)
    return np.asarray(table[row[:, None], column.astype(int)])


def joints(shape: tuple[int, int], size: tuple[float, float], gap: float, bond: float = 0.0) -> Image:
    """1 inside the joints of a grid of (height, width) cells in texels, 0 on the faces, soft over one texel."""
    row, column = np.arange(shape[0])[:, None] + 0.5, np.arange(shape[1])[None, :] + 0.5
    shifted = column + bond * size[1] * ((row // size[0]) % 2)
    to_joint = np.minimum(_distance(row, size[0]), _distance(shifted, size[1]))
    return np.asarray(np.clip(gap / 2.0 - to_joint + 0.5, 0.0, 1.0), np.float32)


def _distance(position: npt.NDArray[np.floating[Any]], period: float) -> npt.NDArray[np.floating[Any]]:
    """Distance to the nearest multiple of `period`."""
    return np.asarray(np.abs((position + period / 2.0) % period - period / 2.0))


def plaster(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Painted wall: clouds of tone, trowel grain, scuffs and dirt towards the floor."""
    image = canvas(width, height, density, rng.uniform(150, 185))
    image += 5.0 * fractal(rng, image.shape, 1.2 * density, 0.7) + 2.0 * fractal(rng, image.shape, 6)
    image += 4.0 * fractal(rng, (4, image.shape[1]), 0.4 * density)[1]  # streaks that run down
    above_floor = height - np.arange(image.shape[0])[:, None] / density
    image -= 30.0 * np.exp(-above_floor / 0.15) + 12.0 * np.exp(-above_floor / 0.8)
    for _ in range(int(3 * width)):
        start = rng.uniform(0, 1, 2) * image.shape[::-1]
        end = start + rng.normal(0, 0.15 * density, 2)
        grey = float(image.mean() - rng.uniform(10, 45))
        cv2.line(image, start.astype(int).tolist(), end.astype(int).tolist(), grey, 1, cv2.LINE_AA)
    return image


def brick(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Bricks of 25 x 7.5 cm in running bond, each of its own shade."""
    image = canvas(width, height, density, rng.uniform(95, 125))
    size = (0.075 * density, 0.25 * density)
    image += 13.0 * cells(rng, image.shape, size, 0.5) + 8.0 * fractal(rng, image.shape, 2.0 * density, 0.75)
    mortar = joints(image.shape, size, 0.012 * density, 0.5)
    return np.asarray(image * (1.0 - mortar) + mortar * rng.uniform(150, 175), np.float32)


def concrete(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Cast panels of 2.4 x 1.2 m with joints, tie holes and water stains."""
    image = canvas(width, height, density, rng.uniform(125, 155))
    size = (1.2 * density, 2.4 * density)
    image += 5.0 * cells(rng, image.shape, size) + 9.0 * fractal(rng, image.shape, 1.5 * density, 0.75)
    image -= 9.0 * np.clip(fractal(rng, (4, image.shape[1]), 0.5 * density)[1], 0, None)
    image -= 50.0 * joints(image.shape, size, 0.015 * density)
    for v in np.arange(0.3, height, 0.6):
        for u in np.arange(0.3, width, 0.6):
            centre = (int(u * density), int(v * density))
            cv2.circle(image, centre, max(1, round(0.012 * density)), 70.0, -1, cv2.LINE_AA)
    return image


def planks(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Upright boards of 14 cm with grain."""
    image = canvas(width, height, density, rng.uniform(100, 150))
    size = (2.0 * height * density, 0.14 * density)
    image += 10.0 * cells(rng, image.shape, size)
    grain = fractal(rng, (max(4, image.shape[0] // 12), image.shape[1]), 0.05 * density, 0.8)
    image += 7.0 * cv2.resize(grain, image.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return image - 55.0 * joints(image.shape, size, 0.01 * density)


def metal(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """A steel cupboard: doors of 45 cm with handles, louvres and a label each."""
    grey = rng.uniform(70, 190)
    image = canvas(width, height, density, grey) + 2.5 * fractal(
        rng, (round(height * density), round(width * density)), 30
    )
    image -= 45.0 * joints(image.shape, (height * density, 0.45 * density), 0.01 * density)
    for u in np.arange(0.0, width - 0.3, 0.45):
        fill(image, density, u + 0.36, 0.45 * height, 0.03, 0.14, 0.4 * grey)
        fill(image, density, u + 0.12, 0.62 * height, 0.2, 0.08, 225.0)
        for v in np.arange(0.86, 0.93, 0.02) * height:
            fill(image, density, u + 0.1, v, 0.25, 0.008, 0.6 * grey)
    return image


def cardboard(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """A parcel: tape, a shipping label, an arrow and dents."""
    image = canvas(width, height, density, rng.uniform(110, 145))
    image += 4.0 * fractal(rng, image.shape, 0.3 * density, 0.7)
    for u in np.arange(0.25, width, 0.5):
        fill(image, density, u - 0.03, 0.0, 0.06, height, 165.0)
        fill(image, density, u + 0.06, rng.uniform(0.3, 0.6) * height, 0.12, 0.09, 235.0)
        for line in range(4):
            fill(image, density, u + 0.07, (0.35 * height) + 0.02 * line, rng.uniform(0.03, 0.1), 0.006, 60.0)
    return image - 30.0 * joints(image.shape, (height * density, width * density / 4.0), 0.02 * density)


def books(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """A shelf: boards every 35 cm, between them backs of all widths and greys."""
    image = canvas(width, height, density, 45.0)
    for shelf in np.arange(0.02, height - 0.2, 0.35):
        u = 0.02
        while u < width - 0.03:
            thick, tall, grey = rng.uniform(0.015, 0.06), rng.uniform(0.2, 0.31), rng.uniform(30, 230)
            if rng.random() > 0.12:
                fill(image, density, u, shelf + 0.01, thick, tall, grey)
                fill(image, density, u, shelf + 0.7 * tall, thick, 0.02, 255.0 - grey)
            u += thick + 0.003
        fill(image, density, 0.0, shelf - 0.02, width, 0.025, 120.0)
    return image + 2.0 * fractal(rng, image.shape, 8)


def coachwork(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """A car's sides: paint, gaps of the doors, a trim, lamps and plates at the ends."""
    image = canvas(width, height, density, rng.uniform(60, 200))
    image += np.linspace(12.0, -30.0, image.shape[0], dtype=np.float32)[:, None]
    for u in np.arange(0.4, width, 0.95):
        fill(image, density, u, 0.05, 0.012, height, 30.0)
        fill(image, density, u + 0.1, 0.75 * height, 0.15, 0.03, 35.0)
    for u in (0.39, 0.55, 0.89, 0.97):
        fill(image, density, u * width, 0.55 * height, 0.25, 0.12, 235.0)
    fill(image, density, 0.0, 0.3 * height, width, 0.03, 40.0)
    return image


def car_windows(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """A car's cabin: dark glass between the posts."""
    image = canvas(width, height, density, 60.0)
    image += 14.0 * fractal(rng, image.shape, 0.6 * density, 0.5)
    for u in np.arange(0.0, width, 0.8):
        fill(image, density, u, 0.0, 0.07, height, 130.0)
    fill(image, density, 0.0, height - 0.08, width, 0.08, 130.0)
    return image


def rubber(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Tyres."""
    return canvas(width, height, density, 35.0)


def foliage(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Leaves: dark depths, lit edges, on scales from branches to leaves."""
    shape = canvas(width, height, density, 0.0).shape
    image = np.abs(fractal(rng, shape, 0.1 * density, 0.8))
    return np.asarray(75.0 + 10.0 * image + 16.0 * fractal(rng, shape, 0.8 * density, 0.85), np.float32)


def bark(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Bark with furrows along the trunk."""
    image = canvas(width, height, density, 85.0)
    furrows = fractal(rng, (max(4, image.shape[0] // 6), image.shape[1]), 0.06 * density, 0.8)
    return image + 16.0 * cv2.resize(furrows, image.shape[::-1], interpolation=cv2.INTER_CUBIC)


def cloth(rng: np.random.Generator, width: float, height: float, density: float) -> Image:
    """Clothing: folds over one tone."""
    image = canvas(width, height, density, rng.uniform(35, 210))
    return image + 11.0 * fractal(rng, image.shape, 0.12 * density, 0.5)


def fill(image: Image, density: float, left: float, bottom: float, width: float, height: float, grey: float) -> None:
    """Paint a rectangle given in metres, its lower edge `bottom` above the foot of the image."""
    u0, u1 = round(left * density), round((left + width) * density)
    v1 = image.shape[0] - round(bottom * density)
    v0 = v1 - max(1, round(height * density))
    image[max(v0, 0) : max(v1, 0), max(u0, 0) : max(u1, u0 + 1, 0)] = grey
