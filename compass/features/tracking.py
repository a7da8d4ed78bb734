"""Corners of a keyframe found again in another image: pyramidal Lucas-Kanade, then a finer alignment.

`cv2.calcOpticalFlowPyrLK` finds them to a twentieth of a pixel; its bilinear interpolation pulls to whole columns. The
rest is the inverse compositional algorithm (Baker & Matthews 2004, doi:10.1023/B:VISI.0000011205.11775.fd) with cubic
interpolation, each patch's brightness and contrast left free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from compass.agreement import ALIKE
from compass.features.padded_strip import MARGIN, WINDOW, Picture
from compass.features.points import Patches, levelled, sample
from compass.flow.correlation import FLOOR_PX
from compass.images.strip import Pixels

Index = npt.NDArray[np.intp]

# Pixels by which it may move a track in all; 0.5 and 2 are as good in the median
# (docs/lab-notes/halves-and-doubles-2026-11-30.md).
LONGEST_CORRECTION_PX = 1.0
# Of the corners, or they are sought with more levels of the pyramid: with a half a walk at 2 Hz ends 1.9 deg off
# instead of 1.1 (docs/lab-notes/constants-2026-11-29.md); with 0.9 held-out drives err as much, and
# an update takes a twentieth more (docs/lab-notes/constants-2026-11-30.md).
ENOUGH = 0.7
# OpenCV's default is 30 rounds to 0.01 pixels; with that increments err by 1.13 times as much, with 30 to 0.03 by 1.05,
# to 0.15 by 1.07 (docs/lab-notes/constants-2026-11-29.md, constants-2026-11-30.md).
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.03)


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Where n corners of the keyframe are in another image.

    Attributes
    ----------
    index : (n,) array
        Which of the keyframe's.
    at : (n, 2) float32 array
        Columns and rows.
    noise : (n,) array
        Variance of a patch's weighted mean from what is left of the difference, grey values^2.
    likeness : (n,) array
        Normalised correlation of the patches, -1..1.
    columns : int
        Of the full circle.
    """

    index: Index
    at: Pixels
    noise: Pixels
    likeness: Pixels
    columns: int

    def some(self, which: npt.NDArray[np.bool_]) -> Tracks:
        """Those that are wanted."""
        return Tracks(self.index[which], self.at[which], self.noise[which], self.likeness[which], self.columns)


def track(before: Picture, patches: Patches, now: Picture, guess: Pixels, levels: int = 1) -> Tracks:
    """Find corners again.

    Parameters
    ----------
    before, now : Picture
        Keyframe and current image.
    patches : Patches
        Of all the keyframe's corners.
    guess : (n, 2) float32 array
        Columns and rows where they are expected, to some pixels.
    levels : int
        Of the pyramid above the picture itself: 0 where they are expected to a pixel or two.
    """
    tracks = _tracked(before, patches, now, guess, levels)
    if tracks.index.size < ENOUGH * len(patches):
        farther = _tracked(before, patches, now, guess)
        tracks = farther if farther.index.size > tracks.index.size else tracks
    return tracks


def _tracked(before: Picture, patches: Patches, now: Picture, guess: Pixels, levels: int | None = None) -> Tracks:
    """With OpenCV's own number of levels, if none is given."""
    start = guess + np.array([MARGIN, 0.0], np.float32)
    start[:, 0] = (guess[:, 0] % now.columns) + MARGIN
    depth: Any = {} if levels is None else {"maxLevel": levels}
    rough, found, _ = cv2.calcOpticalFlowPyrLK(
        before.bytes,
        now.bytes,
        patches.at + np.array([MARGIN, 0.0], np.float32),
        start.copy(),
        winSize=(WINDOW.side, WINDOW.side),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=STOP,
        **depth,
    )
    # a patch, what its interpolation needs round it, and what the finer alignment adds lie within the picture
    edge = np.array([WINDOW.side + LONGEST_CORRECTION_PX, WINDOW.half], np.float32)
    across, down = ((rough >= edge) & (rough < np.array(now.soft.shape[::-1], np.float32) - edge)).T
    index = np.flatnonzero(found[:, 0].astype(bool) & across & down)
    rough = np.asarray(rough[index], np.float32) - np.array([MARGIN, 0.0], np.float32)
    at, left = _aligned(patches, index if index.size < len(patches) else slice(None), now, rough)  # all: no copies
    # it errs by a tenth of its way; never again and always: docs/lab-notes/constants-2026-11-29.md
    again = np.flatnonzero(np.maximum(*np.abs(at - rough).T) > 10.0 * FLOOR_PX)
    if again.size:
        finer, left[again] = _aligned(patches, index[again], now, at[again])
        at[again] = np.clip(finer, rough[again] - LONGEST_CORRECTION_PX, rough[again] + LONGEST_CORRECTION_PX)
    likeness = np.sqrt(np.maximum(1.0 - left / patches.contrast[index] ** 2, 0.0))
    of_mean = np.float32(WINDOW.weights @ WINDOW.weights)  # variance of a weighted mean of pixels, of that of one
    return Tracks(index, at, left * of_mean, likeness, now.columns).some(likeness > ALIKE)


def _aligned(patches: Patches, index: Index | slice, now: Picture, at: Pixels) -> tuple[Pixels, Pixels]:
    """Where some patches are, seen to be about `at`; and the mean square that is then left of their difference."""
    seen, bright = levelled(sample(now.soft, at))
    contrast, values = patches.contrast[index], patches.values[index]
    likeness = (seen * values) @ WINDOW.weights / (contrast * bright)
    seen *= (contrast / bright)[:, None]
    seen -= values
    step = (patches.answer[index] @ seen[..., None])[..., 0]
    x, y = moved = np.minimum(np.maximum(step, -LONGEST_CORRECTION_PX), LONGEST_CORRECTION_PX).T
    right, mixed, down = patches.covariance[index].T
    explained = (down * x * x - 2.0 * mixed * x * y + right * y * y) / (right * down - mixed * mixed)
    left = np.maximum(contrast**2 * (1.0 - likeness * np.abs(likeness)) - explained, 1e-5 * contrast**2)
    return at - moved.T, left
