"""The robot's own body in the picture: it stands still in the panorama however the robot turns."""

from __future__ import annotations

import cv2
import numpy as np

from fusion.simulation import materials
from fusion.simulation.surfaces import Array

_DENSITY = 200.0  # texels per metre of the deck's picture
_DECK = (0.70, 0.60)  # m, length and width over the tracks
_HEIGHT = 0.38  # m, camera above the deck

BODIES = ("none", "deck", "mast")


def robot_body(kind: str, width: int, height: int) -> tuple[Array, Array]:
    """Picture of the body and how much of each pixel it covers, both float32 (height, width).

    Parameters
    ----------
    kind : str
        ``"none"``; ``"deck"``: the deck and tracks below the camera; ``"mast"``: also an antenna and an arm that
        stand up into the region of interest.
    width, height : int
        Size of the panorama, px.
    """
    grey, cover = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    if kind == "none":
        return grey, cover
    azimuth = (np.pi - 2.0 * np.pi * (np.arange(width) + 0.5) / width).astype(np.float32)
    down = np.pi * ((np.arange(height) + 0.5) / height - 0.5)
    distance = _HEIGHT / np.tan(np.clip(down, 1e-3, np.pi / 2 - 1e-3))
    x, y = distance[:, None] * np.cos(azimuth), distance[:, None] * np.sin(azimuth)
    deck = _deck()
    u, v = (y / _DECK[1] + 0.5) * deck.shape[1] - 0.5, (0.5 - x / _DECK[0]) * deck.shape[0] - 0.5
    grey[:] = cv2.remap(
        deck, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    edge = np.arctan2(
        _HEIGHT, np.minimum(_DECK[0] / 2 / np.abs(np.cos(azimuth)), _DECK[1] / 2 / np.abs(np.sin(azimuth)))
    )
    cover[:] = np.clip((down[:, None] - edge) / (np.pi / height) + 0.5, 0.0, 1.0)
    if kind == "mast":
        for centre, half, top, tone in ((2.4, 0.012, 0.24, 60.0), (-1.9, 0.045, 0.42, 170.0)):
            _upright(grey, cover, azimuth, centre, half, top, tone)
    return grey, cover


def _deck() -> Array:
    """The robot from above: tracks, covers, boxes, cables."""
    rng = np.random.default_rng(7)
    length, width = _DECK
    image = materials.canvas(width, length, _DENSITY, 70.0)
    image += 3.0 * materials.fractal(rng, (image.shape[0], image.shape[1]), 40)
    for left in (0.0, width - 0.13):
        for foot in np.arange(0.0, length, 0.05):
            materials.fill(image, _DENSITY, left, foot, 0.13, 0.03, 35.0)
    for left, foot, a, b, tone in (
        (0.2, 0.5, 0.2, 0.12, 150),
        (0.18, 0.1, 0.1, 0.2, 110),
        (0.32, 0.15, 0.12, 0.14, 190),
    ):
        materials.fill(image, _DENSITY, left, foot, a, b, tone)
    return image


def _upright(grey: Array, cover: Array, azimuth: Array, centre: float, half: float, top: float, tone: float) -> None:
    """Add a pole that spans azimuths `centre` +- `half` rad from the fraction `top` of the height down; in place."""
    step = 2.0 * np.pi / azimuth.size
    across = np.clip((half - np.abs(azimuth - centre)) / step + 0.5, 0.0, 1.0).astype(np.float32)
    rows = slice(int(top * grey.shape[0]), None)
    shaded = tone * (0.75 + 0.25 * np.cos((azimuth - centre) / half)).astype(np.float32)
    grey[rows] = np.where(across > 0, shaded, grey[rows])
    cover[rows] = np.maximum(cover[rows], across)
