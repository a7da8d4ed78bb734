"""The turn between two views that are seconds and metres apart, by corners that both show.

ORB corners are matched; the motion that explains their ways is found as between neighbours, then once more from where
their surroundings are to hundredths of a pixel. Where the turn is not known, a view is taken for the same place only if
its inliers are far more than chance gives, and if the place does not repeat itself: a corridor may look the same ahead
and behind, a square grid of pillars in four directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import rel_entr

from compass.agreement import ALIKE, DISAGREE
from compass.angles import wrap_angle
from compass.features.bearings import Projection, Tangents
from compass.features.landmarks import Indices, Landmarks, landmarks_of, look_alikes, mutual_landmarks, two_nearest
from compass.features.motion import DIRECTIONS, ambiguity, narrowing, yaw_variance
from compass.features.padded_strip import MARGIN
from compass.features.patch_alignment import align
from compass.features.points import sectors_of
from compass.features.prior import FEWEST, GAP, TILT_SIGMA, imu_tilt, precision_of, tilt_error
from compass.features.relative_pose import likely_states
from compass.features.solver import ROTATION, Fit, Problem, Start, State, ascend
from compass.flow.correlation import FLOOR_PX, Floats
from compass.images.strip import Strip
from compass.methods.match import Match, Search

Flags = npt.NDArray[np.bool_]

# Times as far as between neighbours do corners move in some seconds: parallaxes, outliers, first rounds. Seven tuned
# drives, views 1 to 4 s apart, err by 0.0139 deg with 8, 0.0150 with 16, 0.0158 with 32; with 4 some by 2 deg, wrong
# minima (docs/lab-notes/long-baseline-2026-11-28.md).
WIDER = 8.0
# Nats by which matches must surpass chance, and rivals, to be an answer: unrelated pairs, 150 of them, reach 65
# (docs/lab-notes/constants-2026-11-29.md). A place whose rivals have as many repeats itself: in those that do, all but
# one of 114 wrong matches have 99 and more (docs/lab-notes/gaps-2026-11-29.md).
MIN_EVIDENCE = 80.0


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
        return self._corners(one, other, np.tile([1.0, 0.0, 1.0], (len(pairs), 1)))  # but for a factor

    def aligned(self, pairs: Indices) -> Corners:
        """The same found again to hundredths of a pixel, as far as they look alike."""
        one, other = self.before.corners[pairs[:, 0]], self.after.corners[pairs[:, 1]]
        margin = np.array([MARGIN, 0.0])
        found, likeness, covariance = align(
            self.before.picture.soft, self.after.picture.soft, one + margin, other + margin
        )
        found -= margin
        kept = likeness > ALIKE
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
        return Problem.posed(
            self.tangents, self.seen, start, self.covariance, prior, self.per_column, WIDER * self.per_column
        )

    def motions(self, mean: Floats, yaw_sigma: float = math.inf) -> Fit:
        """Motions near `mean` that explain them, one of each of some directions of travel."""
        return ascend(self.problem(mean, mean, yaw_sigma), _all_round(mean), narrowing(self.per_column))


def _all_round(mean: Floats) -> Start:
    """Directions of travel all round, with nothing known of the mixture."""
    states = np.repeat(mean[None], DIRECTIONS, axis=0)
    states[:, State.DIRECTION] = np.arange(DIRECTIONS) * math.tau / DIRECTIONS
    return Start.unknown(states)


def follow_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views up to some metres apart where it is about known; else LOW_CONFIDENCE.

    Right to thousandths of a degree. What is known of the turn chooses among motions, and has no part in the answer.
    The variance is that of the turn about the camera's own axis; the confidence is the share of matching corners that
    are inliers.
    """
    seen = _matched_views(reference, current, search)
    if seen is None:
        return Match.none()
    views, pairs = seen
    per_px = views.projection.per_column
    mean, sigma = views.expected(search.expected_px * per_px), search.reach_px * per_px / DISAGREE
    return _sharpened(views, pairs, views.matched(pairs).motions(mean, sigma), mean, sigma)


def match_landmarks(reference: Strip, current: Strip, search: Search) -> Match:
    """Turn between two views of one place that are up to some metres apart; LOW_CONFIDENCE where it cannot be known.

    As `follow_landmarks`, but whatever the turn.
    """
    seen = _matched_views(reference, current, search)
    if seen is None:
        return Match.none()
    views, pairs = seen
    corners, alike = views.matched(pairs), two_nearest(views.before, views.after)
    motion = _found(views, corners)
    outliers = ~_inliers(views, views.matched(alike), motion)
    if 2 * np.count_nonzero(_inliers(views, corners, motion)) <= len(pairs):  # another motion may have as many
        return Match.none()
    rivals = _rival(views, views.matched(alike[outliers]), float(motion.states[0, State.YAW]))
    rivals += sum(_repetition(strip, search.forward_px) for strip in (reference, current))
    # half a squared deviation each: by deviations do they differ
    left = math.sqrt(_evidence(views, corners, motion)) - math.sqrt(rivals)
    if rivals > MIN_EVIDENCE or left < math.sqrt(MIN_EVIDENCE):
        return Match.none()
    per_px, mean = views.projection.per_column, views.expected(float(motion.states[0, State.YAW]))
    sigma = math.sqrt(yaw_variance(motion, sectors_of(corners.at, reference.columns), True))
    match = _sharpened(views, pairs, corners.motions(mean, sigma), mean, sigma)
    # what misleads all corners alike, alignment does not mend
    variance = match.variance_px2 + (sigma / per_px) ** 2
    # motions were told apart by as much: in fog one of 15 pairs was 4 deg off at a claimed half, on rough ground 6
    return replace(match, variance_px2=variance) if variance * per_px**2 < TILT_SIGMA**2 else Match.none()


def _matched_views(reference: Strip, current: Strip, search: Search) -> tuple[Views, Indices] | None:
    """Two views and their pairs of corners; None of a part of the circle, and where they are few.

    Of a part of the circle travel over metres may look like any turn.
    """
    if reference.seen is not None and reference.seen.widest_hidden > GAP:
        return None
    views = Views.of(reference, current, search)
    pairs = mutual_landmarks(views.before, views.after)
    return (views, pairs) if len(pairs) >= FEWEST else None


def _found(views: Views, corners: Corners) -> Fit:
    """The motion with most inliers, of those that pairs of corners agree on, whatever the turn; see `likely_states`.

    Not the likeliest: where views are far apart, that may be one with large parallaxes for fewer corners.
    """
    trials = [_refined(views, corners, state) for state in likely_states(corners.tangents, corners.seen)]
    support = np.array([np.count_nonzero(_inliers(views, corners, trial)) for trial in trials])
    best = trials[support.argmax()]
    best.ambiguity = ambiguity(
        np.array([trial.states[0, State.YAW] for trial in trials]), support - support.max(), best
    )
    return best


def _refined(views: Views, corners: Corners, state: Floats) -> Fit:
    """The motion near a (5,) state that explains the corners."""
    px, mean = corners.per_column, views.expected(float(state[State.YAW]))
    fit = ascend(corners.problem(state, mean), Start.unknown(state[None]), narrowing(px))
    return ascend(corners.problem(fit.states[0], mean), fit, narrowing(px, goes_on=True))  # linear about the last state


def _inliers(views: Views, corners: Corners, motion: Fit) -> Flags:
    """(n,) which corners are inliers of a motion."""
    problem = corners.problem(motion.states[0], views.expected(float(motion.states[0, State.YAW])))
    return np.asarray(ascend(problem, Start.unknown(motion.states), np.empty(0)).inlier[0] > 0.5)


def _evidence(views: Views, corners: Corners, motion: Fit) -> float:
    """Nats by which a motion has more inliers than among shuffled partners: a binomial's large deviation."""
    order = np.random.default_rng(1).permutation(len(corners.at))
    shuffled = replace(corners.some(order), tangents=corners.tangents)
    inliers, by_chance = (np.count_nonzero(_inliers(views, one, motion)) for one in (corners, shuffled))
    chance, share = (by_chance + 0.5) / (len(order) + 1.0), inliers / len(order)
    return len(order) * float(rel_entr(share, chance) + rel_entr(1.0 - share, 1.0 - chance)) if share > chance else 0.0


def _rival(views: Views, corners: Corners, besides: float) -> float:
    """Nats of evidence for the motion that most corners agree on and that turns elsewhere; 0 where there are few.

    Only the first of the likely states is refined: the evidence is all that is asked for.
    """
    if len(corners.at) < FEWEST:
        return 0.0
    state = likely_states(corners.tangents, corners.seen, besides)[0]
    return _evidence(views, corners, _refined(views, corners, state))


@lru_cache(maxsize=2)
def _repetition(strip: Strip, forward_px: float) -> float:
    """Nats of evidence that a place looks the same once it is turned: from the corners of a view to their look-alikes.

    Where another bay of a grid is taken for the last view, all corners agree with the wrong turn, and few of the second
    nearest with the true one: of dozens of copies it is any. Each view by itself still shows that there are copies.
    """
    seen = landmarks_of(strip)
    views = Views(seen, seen, Projection.of(strip, forward_px))
    return _rival(views, views.matched(look_alikes(seen)), 0.0)


def _sharpened(views: Views, pairs: Indices, rough: Fit, mean: Floats, yaw_sigma: float) -> Match:
    """What corners that are inliers of the likeliest motion say once they are aligned."""
    inlier = rough.inlier[rough.best] > 0.5
    corners = views.aligned(pairs[inlier])
    if len(corners.at) < FEWEST:
        return Match.none()
    px = corners.per_column
    start = Start.unknown(rough.states)
    trials = ascend(corners.problem(rough.states[rough.best], mean, yaw_sigma), start, narrowing(px))
    start = trials.only(trials.best)
    for _ in range(2):  # linear about the last state; what was expected has chosen, and says no more
        start = fit = ascend(corners.problem(start.states[0], mean), start, narrowing(px, goes_on=True))
    fit.ambiguity = ambiguity(trials.states[:, State.YAW], trials.log_posterior - fit.log_posterior[0], fit)
    yaw, tilt_x, tilt_y = fit.states[0, ROTATION].tolist()
    strip = views.before.picture.strip
    variance = yaw_variance(fit, sectors_of(corners.at, strip.columns), True)
    variance += (FLOOR_PX * px) ** 2 + tilt_error(strip, (tilt_x, tilt_y)) ** 2
    return Match(wrap_angle(yaw) / px, variance / px**2, float(inlier.mean()), tilt=(tilt_x, tilt_y))
