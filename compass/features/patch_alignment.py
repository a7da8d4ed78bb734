"""Where small patches of one picture are in another, to hundredths of a pixel.

Each patch may have moved, been stretched, sheared and lit otherwise: the inverse compositional algorithm of Lucas and
Kanade, all patches at once (Baker & Matthews 2004, doi:10.1023/B:VISI.0000011205.11775.fd).
"""

from __future__ import annotations

import cv2
import numpy as np

from compass.features.padded_strip import Window
from compass.features.tracking import LONGEST_CORRECTION_PX
from compass.flow.correlation import TINY, Floats
from compass.images.strip import Pixels

# With 5 pixels from the middle to the edge, long baselines err by a fifth more, with 8 and 9 better here and worse
# there (docs/lab-notes/long-baseline-2026-11-28.md, compass-2026-11-27.md).
WIDE = Window.of(7)
# Of Gauss-Newton; 4, 8 and 16 are as good (docs/lab-notes/constants-2026-11-29.md, one-bag-2026-11-29.md).
ROUNDS = 5


def align(before: Pixels, after: Pixels, at: Floats, start: Floats) -> tuple[Floats, Floats, Floats]:
    """Find patches again.

    Parameters
    ----------
    before, after : (rows, columns) float32 arrays
        Pictures.
    at, start : (n, 2) arrays
        Column and row of the patches' middles before, and, to a pixel or two, after.

    Returns
    -------
    found : (n, 2) array
        Columns and rows after.
    likeness : (n,) array
        Normalised correlation of the patches, -1..1.
    covariance : (n, 2, 2) array
        Of `found`, pixels^2, were what is left of each patch's difference white noise: large along an edge.
    """
    stretch = np.tile(np.eye(2, dtype=np.float32), (len(at), 1, 1))
    right, down = (_patches(_slope(before, *along), at, stretch) for along in ((1, 0), (0, 1)))
    wanted = _levelled(_patches(before, at, stretch))
    contrast = _contrast(wanted)
    steepest = np.stack(
        [right, down, right * WIDE.across, right * WIDE.down, down * WIDE.across, down * WIDE.down], axis=1
    )
    steepest -= (steepest @ WIDE.weights)[..., None]
    weighed = steepest * WIDE.weights
    known = np.linalg.inv(weighed @ steepest.transpose(0, 2, 1) + TINY * np.eye(6, dtype=np.float32))
    answer = known @ weighed
    found = start.astype(np.float32)
    for _ in range(ROUNDS):
        patch = _levelled(_patches(after, found, stretch))
        patch *= contrast / _contrast(patch)
        change = (answer @ (patch - wanted)[..., None])[..., 0]
        bend = change[:, 2:].reshape(-1, 2, 2)
        stretch = stretch @ np.linalg.inv(np.eye(2, dtype=np.float32) + bend)
        found -= (stretch @ np.clip(change[:, :2, None], -LONGEST_CORRECTION_PX, LONGEST_CORRECTION_PX))[..., 0]
    patch = _levelled(_patches(after, found, stretch))
    likeness = (patch * wanted) @ WIDE.weights / (contrast * _contrast(patch))[:, 0]
    noise = contrast[:, 0] ** 2 * np.maximum(1.0 - likeness**2, 0.0)
    covariance = (noise * (WIDE.weights @ WIDE.weights))[:, None, None] * known[:, :2, :2]
    return found.astype(float), likeness, covariance.astype(float)


def _slope(picture: Pixels, across: int, down: int) -> Pixels:
    """Change per pixel."""
    return np.asarray(cv2.Sobel(picture, cv2.CV_32F, across, down, ksize=3, scale=0.125), np.float32)


def _patches(picture: Pixels, at: Floats, stretch: Pixels) -> Pixels:
    """(n, pixels) grey values about (n, 2) middles."""
    column = at[:, 0, None] + stretch[:, 0, 0, None] * WIDE.across + stretch[:, 0, 1, None] * WIDE.down
    row = at[:, 1, None] + stretch[:, 1, 0, None] * WIDE.across + stretch[:, 1, 1, None] * WIDE.down
    where = np.asarray(column, np.float32), np.asarray(row, np.float32)
    return np.asarray(cv2.remap(picture, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _levelled(patches: Pixels) -> Pixels:
    """The same without their means."""
    return np.asarray(patches - (patches @ WIDE.weights)[:, None], np.float32)


def _contrast(patches: Pixels) -> Pixels:
    """(n, 1) root mean squares."""
    return np.asarray(np.sqrt((patches * patches) @ WIDE.weights)[:, None] + TINY, np.float32)
