"""Corners of a whole panorama with descriptors, and which of them look alike.

ORB: Rublee et al. 2011, doi:10.1109/ICCV.2011.6126544.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from compass.features.padded_strip import MARGIN, Picture
from compass.features.prior import FEWEST
from compass.flow.correlation import Floats
from compass.images.strip import Strip

Indices = npt.NDArray[np.intp]

CORNERS = 1000  # of ORB; 500 cost a third of the accuracy (docs/lab-notes/long-baseline-2026-11-28.md)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Corners of a panorama.

    Attributes
    ----------
    picture : Picture
        The panorama.
    corners : (n, 2) array
        Columns and rows.
    descriptors : (n, 32) array of uint8
        What they look like.
    patch_px : int
        Width of what a descriptor describes, pixels, at the size of the panorama.
    """

    picture: Picture
    corners: Floats
    descriptors: npt.NDArray[np.uint8]
    patch_px: int


@lru_cache(maxsize=2)
def landmarks_of(strip: Strip) -> Landmarks:
    """Corners of the world in a strip, with descriptors."""
    picture, orb = Picture(strip), cv2.ORB.create(CORNERS)
    patch_px = orb.getPatchSize()
    nothing = Landmarks(picture, np.empty((0, 2)), np.empty((0, 32), np.uint8), patch_px)
    if not shows_landmarks(strip):
        return nothing
    orb.setEdgeThreshold(patch_px // 2)  # suffices
    corners, descriptors = orb.detectAndCompute(picture.bytes, None)
    if descriptors is None:
        return nothing
    at = np.array([corner.pt for corner in corners]) - [MARGIN, 0.0]
    inside = (at[:, 0] >= -0.5) & (at[:, 0] < strip.columns - 0.5)  # each once
    if picture.clear is not None:
        column, row = np.rint(at).astype(np.intp).T
        inside &= picture.clear[row, column % strip.columns]
    return Landmarks(picture, at[inside], np.asarray(descriptors, np.uint8)[inside], patch_px)


def shows_landmarks(strip: Strip) -> bool:
    """Whether a strip is large enough for descriptors."""
    return bool(min(strip.pixels.shape) > cv2.ORB.create().getPatchSize())


def mutual_landmarks(before: Landmarks, after: Landmarks) -> Indices:
    """(n, 2) indices of corners that are each other's nearest.

    Descriptors of bits that are 1 and -1 have a product that falls by two for each bit that differs: small whole
    numbers, so that nothing is rounded, and half the time of a search for the nearest in either direction.
    """
    if min(len(before.descriptors), len(after.descriptors)) < FEWEST:  # few corners match nothing
        return np.empty((0, 2), np.intp)
    one, other = (2.0 * np.unpackbits(of.descriptors, axis=1).astype(np.float32) - 1.0 for of in (before, after))
    likeness = one @ other.T
    nearest, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    mutual = np.flatnonzero(back[nearest] == np.arange(len(one)))
    return np.stack([mutual, nearest[mutual]], axis=1)


def two_nearest(before: Landmarks, after: Landmarks) -> Indices:
    """(n, 2) indices of all corners that look alike: each one's two nearest."""
    nearest = cv2.batchDistance(before.descriptors, after.descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)[1]
    return np.stack([np.repeat(np.arange(len(nearest)), 2), nearest.ravel()], axis=1)


def look_alikes(seen: Landmarks) -> Indices:
    """(n, 2) indices of corners and of the nearest to each in the same view, further off than a patch is wide."""
    if len(seen.corners) < FEWEST:
        return np.empty((0, 2), np.intp)
    column, descriptors = seen.corners[:, 0], seen.descriptors
    apart = np.abs(column[:, None] - column)
    elsewhere = (apart > seen.patch_px) & (apart < seen.picture.columns - seen.patch_px)
    nearest = cv2.batchDistance(
        descriptors, descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1, mask=elsewhere.astype(np.uint8)
    )[1][:, 0]
    index = np.flatnonzero(nearest >= 0)
    return np.stack([index, nearest[index]], axis=1)
