"""The place found again after a gap: by corners that the last good view and this one both show.

While the light failed, or the camera, the robot has turned by any angle and gone some metres. What `parallax` follows
from image to image is lost then, but corners can be told apart from afar. A turn is believed if the motion found obeys
far more of them than the same corners with their partners shuffled, and if no other turn is obeyed by corners that look
alike: a corridor may look the same ahead and behind.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from compass.alignment import align
from compass.correlation import Floats
from compass.increment import CompassStatus
from compass.match import Match, Search
from compass.strip import Pixels, Strip
from compass.two_views import NEAR, Motion, evidence, find_motion, follow_motion, misses, sharpen_motion

Indices = npt.NDArray[np.intp]

DETECTOR = (1000, 1.2, 5, 15, 0, 2, cv2.ORB_HARRIS_SCORE, 31, 8)  # so many corners of five sizes; larger ones err
SMALLEST = 32  # rows and columns: a corner's surroundings
PAD = 40  # columns repeated beyond the seam: half a corner's surroundings at the largest size
RATIO = 0.8  # of the distance to the second nearest descriptor; nearer ones are no match
FEWEST = 16  # matches; fewer are no evidence
EVIDENCE = 80.0  # nats by which the matches must surpass chance; unrelated pairs, 1,000 of them, reach 40
RIVALS = 600  # pairs that look alike, but do not move as found, among which another answer is looked for
RIVALRY = 100.0  # nats for that which are too many; so is
RELATIVE = 0.5  # so much of the first answer's
VAGUE = np.deg2rad(3.0)  # a deviation beyond it is no answer
SOFTNESS = 0.5  # pixels, of pictures in which corners are aligned
ALIGNED = 400  # corners, at most
LIKE = 0.85  # correlation of a corner with itself, at least
NOTHING = Match(0.0, np.inf, 0.0, CompassStatus.LOW_CONFIDENCE)
ASTRAY = 4.0  # pixels from where it was; no corner is aligned over more


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Corners of a panorama.

    Attributes
    ----------
    strip : Strip
        The panorama.
    forward_px : float
        Its column that looks along +x.
    corners : (n, 2) array
        Columns and rows.
    descriptors : (n, 32) array of uint8
        What they look like.
    """

    strip: Strip
    forward_px: float
    corners: Floats
    descriptors: npt.NDArray[np.uint8]

    @cached_property
    def picture(self) -> Pixels:
        """(rows, columns + 2 * PAD) grey values, a little softened."""
        grey = np.asarray(self.strip.pixels + self.strip.means, np.float32)
        return np.asarray(cv2.GaussianBlur(_padded(grey), (0, 0), SOFTNESS), np.float32)

    @cached_property
    def bearings(self) -> Floats:
        """(n, 3) unit vectors towards the corners."""
        return self.towards(self.corners)

    def towards(self, corners: Floats) -> Floats:
        """(n, 3) unit vectors towards (n, 2) columns and rows, x ahead, y left, z up."""
        strip = self.strip
        azimuth = -2.0 * np.pi * (corners[:, 0] + 0.5 - self.forward_px) / strip.columns
        elevation = strip.top - (corners[:, 1] + 0.5) * strip.row_height
        level = np.cos(elevation)
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)


def match_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views of one place that are up to some metres apart; LOW_CONFIDENCE where it cannot be known.

    The variance is that of the turn about the camera's own axis; the confidence is the share of matching corners that
    obey the motion found.
    """
    before, after = (landmarks_of(strip, search.forward_px) for strip in (reference, current))
    matched, alike = _matched(before, after)
    if len(matched) < FEWEST:
        return NOTHING
    seen, again = before.bearings[matched[:, 0]], after.bearings[matched[:, 1]]
    motion = find_motion(seen, again)
    nats = evidence(motion, seen, again)[1]
    if nats < EVIDENCE or motion.variance > VAGUE**2 or _rivalled(motion, nats, before, after, alike):
        return NOTHING
    obey = misses(motion.states, seen, again)[0] < NEAR**2
    return _match_of(_sharpened(motion, before, after, matched[obey]) or motion, obey, reference)


def follow_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views up to some metres apart where it is known to a degree or two; else LOW_CONFIDENCE.

    Corners are found again to hundredths of a pixel, so that the turn is right to thousandths of a degree. The variance
    is that of the turn about the camera's own axis; the confidence is the share of matching corners that obey the
    motion found.
    """
    before, after = (landmarks_of(strip, search.forward_px) for strip in (reference, current))
    matched = _matched(before, after)[0]
    if len(matched) < FEWEST:
        return NOTHING
    seen, again = before.bearings[matched[:, 0]], after.bearings[matched[:, 1]]
    motion = follow_motion(seen, again, search.expected_px * 2.0 * np.pi / reference.columns)
    obey = misses(motion.states, seen, again)[0] < NEAR**2
    sharp = _sharpened(motion, before, after, matched[obey])
    return _match_of(sharp, obey, reference) if sharp else NOTHING


def _sharpened(motion: Motion, before: Landmarks, after: Landmarks, matched: Indices) -> Motion | None:
    """The motion by the corners that obey it, `matched`, found again finely; None where too few are alike."""
    seen, again, blur = _aligned(before, after, matched[:ALIGNED])
    return sharpen_motion(motion, seen, again, blur) if len(seen) >= FEWEST else None


def _match_of(motion: Motion, obey: npt.NDArray[np.bool_], reference: Strip) -> Match:
    """What a motion, which these corners obey, says of a turn, in columns."""
    per_rad = reference.columns / (2.0 * np.pi)
    tilt = motion.tilt_x, motion.tilt_y
    return Match(motion.turn * per_rad, motion.variance * per_rad**2, float(obey.mean()), tilt=tilt)


def _aligned(before: Landmarks, after: Landmarks, matched: Indices) -> tuple[Floats, Floats, Floats]:
    """Unit vectors towards (n, 2) pairs of corners, finely, as far as they look alike.

    And (n, 2, 2) covariances of the latter to the left and upwards, rad^2.
    """
    one, other = before.corners[matched[:, 0]], after.corners[matched[:, 1]]
    padding = np.array([PAD, 0.0])
    found, likeness, covariance = align(before.picture, after.picture, one + padding, other + padding)
    found -= padding
    kept = (likeness > LIKE) & (np.hypot(*(found - other).T) < ASTRAY)
    again = after.towards(found[kept])
    left = 2.0 * np.pi / after.strip.columns * np.hypot(again[:, 0], again[:, 1])  # per pixel
    scale = np.stack([left, np.full(len(left), after.strip.row_height)], axis=1)
    return before.towards(one[kept]), again, covariance[kept] * scale[:, :, None] * scale[:, None, :]


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
    nothing = Landmarks(strip, forward_px, np.empty((0, 2)), np.empty((0, 32), np.uint8))
    if min(strip.pixels.shape) < SMALLEST:
        return nothing
    grey = np.clip(np.rint(strip.pixels + strip.means), 0, 255).astype(np.uint8)
    corners, descriptors = cv2.ORB.create(*DETECTOR).detectAndCompute(_padded(grey), None)
    if descriptors is None:
        return nothing
    column, row = np.array([corner.pt for corner in corners]).T - [[PAD], [0.0]]
    inside = (column >= -0.5) & (column < strip.columns - 0.5)  # each once
    if strip.seen is not None:
        at = np.rint(row).astype(np.intp), np.rint(column).astype(np.intp) % strip.columns
        inside &= strip.seen.pixels[at] > 0.0
    corners_inside = np.stack([column[inside], row[inside]], axis=1)
    return Landmarks(strip, forward_px, corners_inside, np.asarray(descriptors, np.uint8)[inside])


def _padded(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A panorama with `PAD` columns repeated on either side."""
    return cv2.copyMakeBorder(picture, 0, 0, PAD, PAD, cv2.BORDER_WRAP)


def _matched(before: Landmarks, after: Landmarks) -> tuple[Indices, Indices]:
    """(n, 2) indices of corners that are each other's nearest and have no second, and of all that look alike.

    The latter are each one's two nearest, those most alike first. Few corners match nothing.
    """
    one, other = before.descriptors, after.descriptors
    if min(len(one), len(other)) < FEWEST:
        return np.empty((0, 2), np.intp), np.empty((0, 2), np.intp)
    distance, nearest = cv2.batchDistance(one, other, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    clear = np.flatnonzero(distance[:, 0] < RATIO * distance[:, 1])
    if clear.size:
        back = cv2.batchDistance(other[nearest[clear, 0]], one, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)[1][:, 0]
        clear = clear[back == clear]
    order = np.argsort(distance, axis=None, kind="stable")
    return np.stack([clear, nearest[clear, 0]], axis=1), np.stack([order // 2, nearest.ravel()[order]], axis=1)
