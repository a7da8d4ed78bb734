"""The turn between two views that are seconds and metres apart, by corners that both show.

ORB corners (Rublee et al. 2011, doi:10.1109/ICCV.2011.6126544) are matched; the motion that explains their ways is
found as between neighbours, then once more from where their surroundings are to hundredths of a pixel. Where the turn
is not known, a view is taken for the same place only if its inliers are far more than chance gives, and if those that
look alike support no other motion: a corridor may look the same ahead and behind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from compass.angles import wrap_angle
from compass.features.bearings import Projection, Tangents
from compass.features.motion import DIRECTIONS, FIRST_PX, NEXT_PX, ambiguity, yaw_variance
from compass.features.padded_strip import MARGIN, Picture
from compass.features.patch_alignment import align
from compass.features.points import sectors_of
from compass.features.prior import DISAGREE, FEWEST, LOCK_PX, ONE_SIDED, imu_tilt, precision_of, tilt_error
from compass.features.relative_pose import INLIER, Motion, evidence, find_motion, misses
from compass.features.solver import DIRECTION, ROTATION, YAW, Fit, Problem, Start, ascend, even_shares
from compass.features.tracking import MIN_LIKENESS
from compass.flow.correlation import Floats
from compass.images.strip import Strip
from compass.increment import CompassStatus
from compass.methods.match import Match, Search

Indices = npt.NDArray[np.intp]

# Of ORB; 500 cost a third of the accuracy, 3 levels gain 7 %
# and lose scale (docs/lab-notes/long-baseline-2026-11-28.md).
CORNERS, LEVELS = 1000, 5
PATCH = 31  # pixels, the side of what a descriptor describes: the library's default
RATIO = 0.8  # of the distance to the second nearest descriptor (Lowe 2004); nearer ones are no match
ORB_PX = 1.0  # deviation of a corner as ORB has it, a pixel of its level, but for a factor that is estimated
# Times as far as between neighbours do corners move in some seconds: parallaxes, outliers, first rounds. Seven tuned
# drives, views 1 to 4 s apart, err by 0.0139 deg with 8, 0.0150 with 16, 0.0158 with 32; with 4 some by 2 deg, wrong
# minima (docs/lab-notes/long-baseline-2026-11-28.md).
WIDER = 8.0
MIN_EVIDENCE = 80.0  # nats by which the matches must surpass chance; unrelated pairs, 1,000 of them, reach 40
RIVALRY = 100.0  # nats for that which are too many: up to 54 in six places, 127 on in a symmetric corridor; so is
RELATIVE = 0.5  # so much of the first answer's
# rad, a deviation beyond which it is no answer: without it 4 deg off at a claimed half in one of 15 pairs in fog
MAX_TURN_SIGMA = math.radians(3.0)
NO_MATCH = Match(0.0, math.inf, 0.0, CompassStatus.LOW_CONFIDENCE)


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
    """

    picture: Picture
    corners: Floats
    descriptors: npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Views:
    """Two views, and what is known of the motion between them."""

    before: Landmarks
    after: Landmarks
    projection: Projection

    @staticmethod
    def of(reference: Strip, current: Strip, search: Search) -> Views:
        """Of two strips."""
        return Views(landmarks_of(reference), landmarks_of(current), Projection.of(reference, search.forward_px))

    def expected(self, turn: float) -> Floats:
        """(5,) the motion that is expected with a turn, rad: tilted as an IMU measures it."""
        before, after = self.before.picture.strip, self.after.picture.strip
        return np.array([turn, *imu_tilt(before, after, turn), 0.0, 0.0])

    def matched(self, pairs: Indices) -> Corners:
        """Corners, (n, 2) pairs of indices, where ORB has them."""
        one, other = self.before.corners[pairs[:, 0]], self.after.corners[pairs[:, 1]]
        return self._corners(one, other, np.tile([ORB_PX**2, 0.0, ORB_PX**2], (len(pairs), 1)))

    def aligned(self, pairs: Indices) -> Corners:
        """The same found again to hundredths of a pixel, as far as they look alike."""
        one, other = self.before.corners[pairs[:, 0]], self.after.corners[pairs[:, 1]]
        margin = np.array([MARGIN, 0.0])
        found, likeness, covariance = align(
            self.before.picture.soft, self.after.picture.soft, one + margin, other + margin
        )
        found -= margin
        kept = likeness > MIN_LIKENESS
        return self._corners(one[kept], found[kept], covariance[kept][:, [0, 0, 1], [0, 1, 1]])

    def _corners(self, one: Floats, other: Floats, covariance: Floats) -> Corners:
        directions, tangents = self.projection.directions(other), Tangents.at(self.projection.directions(one))
        noise = self.projection.covariance(directions, *covariance.T)
        return Corners(tangents, directions, noise, other, self.projection.per_column)


@dataclass(frozen=True, eq=False)
class Corners:
    """n corners that two views show.

    Attributes
    ----------
    tangents : Tangents
        At the directions in which they were seen before.
    seen : (3, n) array
        Directions in which they are seen after.
    covariance : (2, n) complex array
        See `Problem`.
    at : (n, 2) array
        Columns and rows after.
    per_column : float
        rad.
    """

    tangents: Tangents
    seen: Floats
    covariance: npt.NDArray[np.complexfloating]
    at: Floats
    per_column: float

    def some(self, which: slice | Indices) -> Corners:
        """Those of a slice or an index."""
        index = np.arange(len(self.at))[which]
        covariance = self.covariance[:, index]
        return replace(
            self, tangents=self.tangents.some(index), seen=self.seen[:, index], covariance=covariance, at=self.at[index]
        )

    def problem(self, start: Floats, mean: Floats, yaw_sigma: float = math.inf) -> Problem:
        """How they have moved since `start`; what is known of the motion is `mean`, the yaw to `yaw_sigma` (rad)."""
        prior = mean, precision_of(yaw_sigma)
        return Problem.posed(self.tangents, self.seen, start, self.covariance, prior, WIDER * self.per_column)

    def motions(self, mean: Floats, yaw_sigma: float = math.inf) -> Fit:
        """Motions near `mean` that explain them, one of each of some directions of travel."""
        return ascend(self.problem(mean, mean, yaw_sigma), _all_round(mean), FIRST_PX * WIDER * self.per_column)


def _all_round(mean: Floats) -> Start:
    """Directions of travel all round, with nothing known of the mixture."""
    states = np.repeat(mean[None], DIRECTIONS, axis=0)
    states[:, DIRECTION] = np.arange(DIRECTIONS) * math.tau / DIRECTIONS
    return Start(states, np.repeat(even_shares(), DIRECTIONS, axis=0), np.ones(DIRECTIONS))


def follow_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views up to some metres apart where it is about known; else LOW_CONFIDENCE.

    Right to thousandths of a degree. What is known of the turn chooses among motions, and has no part in the answer.
    The variance is that of the turn about the camera's own axis; the confidence is the share of matching corners that
    are inliers.
    """
    if _sees_one_side(reference):
        return NO_MATCH
    views = Views.of(reference, current, search)
    pairs = _matched(views.before, views.after)[0]
    if len(pairs) < FEWEST:
        return NO_MATCH
    per_px = views.projection.per_column
    mean, sigma = views.expected(search.expected_px * per_px), search.reach_px * per_px / DISAGREE
    return _sharpened(views, pairs, views.matched(pairs).motions(mean, sigma), mean, sigma) or NO_MATCH


def match_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views of one place that are up to some metres apart; LOW_CONFIDENCE where it cannot be known.

    As `follow_landmarks`, but whatever the turn.
    """
    if _sees_one_side(reference):
        return NO_MATCH
    views = Views.of(reference, current, search)
    pairs, alike = _matched(views.before, views.after)
    if len(pairs) < FEWEST:
        return NO_MATCH
    corners = views.matched(pairs)
    seen, again = corners.tangents.ahead.T, corners.seen.T
    motion = find_motion(seen, again)
    nats = evidence(motion, seen, again)
    if nats < MIN_EVIDENCE or motion.variance > MAX_TURN_SIGMA**2 or _rivalled(views.matched(alike), motion, nats):
        return NO_MATCH
    mean, sigma = views.expected(motion.turn), math.sqrt(motion.variance)
    match = _sharpened(views, pairs, corners.motions(mean, sigma), mean, sigma)
    if match is None:
        return NO_MATCH
    per_px = views.projection.per_column
    variance = match.variance_px2 + motion.ambiguity / per_px**2
    off = wrap_angle(match.shift_px * per_px - motion.turn)
    if off**2 > DISAGREE**2 * (motion.variance + variance * per_px**2):  # another motion explains them as well
        return NO_MATCH
    return replace(match, variance_px2=variance)


def _sees_one_side(strip: Strip) -> bool:
    """Whether the camera itself shows so little of the circle that travel over metres may look like any turn."""
    return strip.seen is not None and strip.seen.widest_hidden > ONE_SIDED


def _sharpened(views: Views, pairs: Indices, rough: Fit, mean: Floats, yaw_sigma: float = math.inf) -> Match | None:
    """What corners that are inliers of the likeliest motion say once they are aligned; None where too few are alike."""
    inlier = rough.inlier[rough.best] > 0.5
    corners = views.aligned(pairs[inlier])
    if len(corners.at) < FEWEST:
        return None
    px, count = corners.per_column, len(rough.states)
    start = Start(rough.states, np.repeat(even_shares(), count, axis=0), np.ones(count))
    trials = ascend(corners.problem(rough.states[rough.best], mean, yaw_sigma), start, FIRST_PX * px)
    start = trials.only(trials.best)
    for _ in range(2):  # linear about the last state; what was expected has chosen, and says no more
        start = fit = ascend(corners.problem(start.states[0], mean), start, NEXT_PX * px)
    fit.ambiguity = ambiguity(trials.states[:, YAW], trials.log_posterior, fit)
    yaw, tilt_x, tilt_y = fit.states[0, ROTATION].tolist()
    strip = views.before.picture.strip
    variance = yaw_variance(fit, sectors_of(corners.at, strip.columns), True)
    variance += (LOCK_PX * px) ** 2 + tilt_error(strip, (tilt_x, tilt_y)) ** 2
    return Match(wrap_angle(yaw) / px, variance / px**2, float(inlier.mean()), tilt=(tilt_x, tilt_y))


def _rivalled(alike: Corners, motion: Motion, nats: float) -> bool:
    """Whether corners that look alike but are outliers of the motion are inliers of another one."""
    seen, again = alike.tangents.ahead.T, alike.seen.T
    left = np.flatnonzero(misses(motion.states, seen, again)[0] > INLIER**2)
    if left.size < FEWEST:
        return False
    rival = find_motion(seen[left], again[left], motion.turn)
    return evidence(rival, seen[left], again[left]) > min(RIVALRY, RELATIVE * nats)


@lru_cache(maxsize=2)
def landmarks_of(strip: Strip) -> Landmarks:
    """Corners of the world in a strip, with descriptors."""
    picture = Picture(strip)
    nothing = Landmarks(picture, np.empty((0, 2)), np.empty((0, 32), np.uint8))
    if min(strip.pixels.shape) <= PATCH:
        return nothing
    orb = cv2.ORB.create(CORNERS, nlevels=LEVELS, edgeThreshold=PATCH // 2, patchSize=PATCH)  # half a patch suffices
    corners, descriptors = orb.detectAndCompute(picture.bytes, None)
    if descriptors is None:
        return nothing
    at = np.array([corner.pt for corner in corners]) - [MARGIN, 0.0]
    inside = (at[:, 0] >= -0.5) & (at[:, 0] < strip.columns - 0.5)  # each once
    if picture.clear is not None:
        column, row = np.rint(at).astype(np.intp).T
        inside &= picture.clear[row, column % strip.columns]
    return Landmarks(picture, at[inside], np.asarray(descriptors, np.uint8)[inside])


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
