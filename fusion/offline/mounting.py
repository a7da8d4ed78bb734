"""What a camera's own recording tells of its mounting: which pixels are the robot, and where forward is."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from compass.methods.sector_median import SectorShifts
from fusion.offline.streams import Floats

Mask = npt.NDArray[np.bool_]
Panorama = npt.NDArray[np.float32]

WINDOW_PX = 15  # of the local correlation, at MASK_COLUMNS
MASK_COLUMNS = 512
ROLLS = (0.17, 0.37, 0.59)  # of the width, where nothing matches but what is alike all around
TEXTURE = 3.0  # grey values; what varies less in a window cannot be judged
STATIC = 0.5  # correlation in place above that elsewhere


def static_pixels(frames: Sequence[Panorama], yaws: Floats | None = None) -> Mask:
    """Find the pixels that stay while the robot turns: its own body, mast and cables.

    In a small window around a pixel, frames of different yaw correlate where they show the robot, and do not where
    they show the world. Things alike all around, as a horizon, correlate with a rolled frame as well and don't count;
    nor does what correlates as well where the turn should have moved it, as the edge of a roof or of a road.

    Parameters
    ----------
    frames : sequence of (H, W) array of float32
        Same size, neighbours well over a window's width apart in yaw.
    yaws : (N,) array, optional
        Yaw of each frame, rad, left positive, where the columns are azimuths.

    Returns
    -------
    (H, W) array of bool
    """
    width = frames[0].shape[1]
    in_place, texture = _alike(frames, [0] * len(frames))
    elsewhere = sum(_alike(frames, [round(roll * width)] * len(frames))[0] for roll in ROLLS) / len(ROLLS)
    judged = texture > TEXTURE**2 * (len(frames) - 1)
    score = np.divide(in_place - elsewhere, texture, out=np.zeros_like(texture), where=judged)
    static = score > STATIC
    if yaws is not None:
        moved, power = _alike(frames, [round(-width * turn / math.tau) for turn in np.diff(yaws)])
        static &= in_place * power > moved * texture  # of the two correlations the larger one
    return np.asarray(static, np.bool_)


def _alike(frames: Sequence[Panorama], rolls: Sequence[int]) -> tuple[Floats, Floats]:
    """Sums of `_covariance` over neighbours, the later one rolled by so many columns."""
    covariance, power = (np.zeros(frames[0].shape) for _ in range(2))
    for (one, other), roll in zip(itertools.pairwise(frames), rolls, strict=False):
        found = _covariance(one, np.roll(other, roll, axis=1))
        covariance += found[0]
        power += found[1]
    return covariance, power


def _covariance(one: Panorama, other: Panorama) -> tuple[Floats, Floats]:
    """Local covariance of two frames, and the product of their local deviations."""

    def mean(image: Panorama) -> Floats:
        around = cv2.copyMakeBorder(image, 0, 0, WINDOW_PX, WINDOW_PX, cv2.BORDER_WRAP)
        return np.asarray(cv2.blur(around, (WINDOW_PX, WINDOW_PX))[:, WINDOW_PX:-WINDOW_PX], np.float64)

    mean_one, mean_other = mean(one), mean(other)
    covariance = mean(one * other) - mean_one * mean_other
    variances = (np.maximum(mean(image * image) - m * m, 0.0) for image, m in ((one, mean_one), (other, mean_other)))
    first, second = variances
    return covariance, np.sqrt(first * second)


def body_top(static: Mask, highest: float = 0.4, share: float = 0.1) -> float | None:
    """Upper edge of the robot's body, a fraction of the height: the first row below `highest` with a `share` of it."""
    rows = np.flatnonzero(static.mean(axis=1) > share)
    below = rows[rows >= highest * static.shape[0]]
    return float(below[0] / static.shape[0]) if below.size else None


@dataclass(frozen=True, slots=True)
class Forward:
    """Where the robot drives to: `column`, a fraction of the width, and its standard deviation `sigma`."""

    column: float
    sigma: float


def forward_column(pairs: Sequence[SectorShifts], columns: int) -> Forward | None:
    """Direction of driving from how sectors moved between pairs of images on straight ways.

    Parallax pushes the sectors away from the column ahead: to the right on its right, to the left on its left,
    strongest at the side (``push = A sin(azimuth - ahead)``). None where the pushes do not agree.
    """
    angle = np.concatenate([math.tau * pair.centre_px / columns for pair in pairs])
    shift = np.concatenate([np.clip(pair.shift_px - np.median(pair.shift_px), -5.0, 5.0) for pair in pairs])
    weight = 1.0 / np.hypot(np.concatenate([pair.sigma_px for pair in pairs]), 0.3)
    basis = np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1)
    (_, sine, cosine), *_ = np.linalg.lstsq(basis * weight[:, None], shift * weight, rcond=None)
    size = math.hypot(sine, cosine)
    residual = (shift - basis @ np.array([0.0, sine, cosine])) * weight
    # Windows overlap by half and distances vary slowly: about one in eight residuals is independent.
    sigma = float(np.sqrt(8.0 * np.mean(residual**2) * 2.0 / np.sum(weight**2))) / max(size, 1e-9)
    if sigma > 0.2:
        return None
    return Forward((math.atan2(-cosine, sine) / math.tau) % 1.0, sigma / math.tau)
