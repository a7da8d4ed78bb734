"""The place found again after a gap: by corners that the last good view and this one both show.

While the light failed, or the camera, the robot has turned by any angle and gone some metres. What `parallax` follows
from image to image is lost then, but corners can be told apart from afar. A turn is believed if the motion found obeys
far more of them than the same corners with their partners shuffled, and if no other turn is obeyed by corners that look
alike: a corridor may look the same ahead and behind.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from compass.correlation import Floats
from compass.increment import CompassStatus
from compass.match import Match, Search
from compass.strip import Strip
from compass.two_views import NEAR, Motion, evidence, find_motion, misses

Indices = npt.NDArray[np.intp]

DETECTOR = (1000, 1.2, 5, 15, 0, 2, cv2.ORB_HARRIS_SCORE, 31, 8)  # so many corners of five sizes; larger ones err
SMALLEST = 32  # rows and columns: a corner's surroundings
PAD = 40  # columns repeated beyond the seam: half a corner's surroundings at the largest size
RATIO = 0.8  # of the distance to the second nearest descriptor; nearer ones are no match
FEWEST = 16  # matches; fewer are no evidence
EVIDENCE = 80.0  # nats by which the matches must surpass chance; unrelated pairs, 1,000 of them, reach 40
RIVALS = 600  # pairs that look alike, but do not move as found, among which another answer is looked for
RIVALRY = 140.0  # nats for that which are too many; so is
RELATIVE = 0.5  # so much of the first answer's
VAGUE = np.deg2rad(3.0)  # a deviation beyond it is no answer


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Corners of a panorama.

    Attributes
    ----------
    bearings : (n, 3) array
        Unit vectors towards them, x ahead, y left, z up.
    descriptors : (n, 32) array of uint8
        What they look like.
    """

    bearings: Floats
    descriptors: npt.NDArray[np.uint8]


def match_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views of one place that are up to some metres apart; LOW_CONFIDENCE where it cannot be known.

    The variance is that of the turn about the camera's own axis; the confidence is the share of matching corners that
    obey the motion found.
    """
    nothing = Match(0.0, np.inf, 0.0, CompassStatus.LOW_CONFIDENCE)
    before, after = (landmarks_of(strip, search.forward_px) for strip in (reference, current))
    if min(len(before.descriptors), len(after.descriptors)) < FEWEST:
        return nothing
    matched, alike = _matched(before, after)
    if len(matched) < FEWEST:
        return nothing
    seen, again = before.bearings[matched[:, 0]], after.bearings[matched[:, 1]]
    motion = find_motion(seen, again)
    inliers, nats = evidence(motion, seen, again)
    if nats < EVIDENCE or motion.variance > VAGUE**2 or _rivalled(motion, nats, before, after, alike):
        return nothing
    per_rad = reference.columns / (2.0 * np.pi)
    return Match(
        motion.turn * per_rad, motion.variance * per_rad**2, inliers / len(matched), tilt=(motion.tilt_x, motion.tilt_y)
    )


def _rivalled(motion: Motion, nats: float, before: Landmarks, after: Landmarks, alike: Indices) -> bool:
    """Whether corners that look alike but do not obey the motion obey another one."""
    seen, again = before.bearings[alike[:, 0]], after.bearings[alike[:, 1]]
    left = np.flatnonzero(misses(motion.states, seen, again)[0] > NEAR**2)[:RIVALS]
    if left.size < FEWEST:
        return False
    rival = find_motion(seen[left], again[left], motion.turn)
    return evidence(rival, seen[left], again[left])[1] > min(RIVALRY, RELATIVE * nats)


@lru_cache(maxsize=2)
def landmarks_of(strip: Strip, forward_px: float) -> Landmarks:
    """Corners of the world in a strip that can be told apart."""
    nothing = Landmarks(np.empty((0, 3)), np.empty((0, 32), np.uint8))
    if min(strip.pixels.shape) < SMALLEST:
        return nothing
    grey = np.clip(np.rint(strip.pixels + strip.means), 0, 255).astype(np.uint8)
    around = cv2.copyMakeBorder(grey, 0, 0, PAD, PAD, cv2.BORDER_WRAP)
    corners, descriptors = cv2.ORB.create(*DETECTOR).detectAndCompute(around, None)
    if descriptors is None:
        return nothing
    column, row = np.array([corner.pt for corner in corners]).T - [[PAD], [0.0]]
    inside = (column >= -0.5) & (column < strip.columns - 0.5)  # each once
    if strip.seen is not None:
        at = np.rint(row).astype(np.intp), np.rint(column).astype(np.intp) % strip.columns
        inside &= strip.seen.pixels[at] > 0.0
    azimuth = -2.0 * np.pi * (column[inside] + 0.5 - forward_px) / strip.columns
    elevation = strip.top - (row[inside] + 0.5) * strip.row_height
    level = np.cos(elevation)
    bearings = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    return Landmarks(bearings, np.asarray(descriptors, np.uint8)[inside])


def _matched(before: Landmarks, after: Landmarks) -> tuple[Indices, Indices]:
    """(n, 2) indices of corners that are each other's nearest and have no second, and of all that look alike.

    The latter are each one's two nearest, those most alike first.
    """
    one, other = before.descriptors, after.descriptors
    distance, nearest = cv2.batchDistance(one, other, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    back = cv2.batchDistance(other, one, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)[1][:, 0]
    mutual = back[nearest[:, 0]] == np.arange(len(one))
    clear = np.flatnonzero(mutual & (distance[:, 0] < RATIO * distance[:, 1]))
    order = np.argsort(distance, axis=None, kind="stable")
    return np.stack([clear, nearest[clear, 0]], axis=1), np.stack([order // 2, nearest.ravel()[order]], axis=1)
