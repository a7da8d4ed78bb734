"""The method `corners`: corners of the keyframe are tracked, and the rotation and travel found that explain their ways.

Where they show nothing but a turn, all rows pooled measure it best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from compass.agreement import AGREE, DISAGREE
from compass.angles import wrap_angle
from compass.features.bearings import Projection, Tangents, undo
from compass.features.motion import FIRST_PX, Motion, yaw_variance
from compass.features.padded_strip import MARGIN, WINDOW, Picture
from compass.features.points import Floats, Patches, cut_patches, find_corners, sectors_of
from compass.features.prior import FEWEST, GAP, imu_tilt, precision_of, tilt_error
from compass.features.solver import ROTATION, Fit, Problem, State
from compass.features.tracking import Tracks, track
from compass.flow.coarse_shift import CoarseShift, coarse_shift, quantile
from compass.flow.correlation import FLOOR_PX, signed, upright_spectrum
from compass.flow.pure_turn import pooled_turn, turn_variance
from compass.images.seen import MAST
from compass.images.strip import Strip
from compass.increment import CompassStatus
from compass.methods.match import Match, Search
from compass.methods.sector_median import match_small

# A deviation beyond it: no motion explains the corners, they show another place. Photographs that are pushed sideways
# only err by 0.052 deg in 44 of 54 with it, by 0.126 in all without (docs/lab-notes/neighbours-2026-11-30.md).
# With half of it a walk loses 8 of 240 images (docs/lab-notes/halves-and-doubles-2026-11-30.md).
UNRELATED_PX = 0.19


@dataclass(slots=True, eq=False)
class Keyframe:
    """A keyframe's n corners, and where they were seen last.

    Attributes
    ----------
    picture, patches, tangents
        The image, the corners, and the tangent planes at them.
    last : (n, 2) array
        Columns and rows where they were seen last, or would have been.
    predicted : (n, 2) array
        Where the last image's coarse shift, and the IMU's tilt, put them.
    pace : (n, 2) array
        How far each moved beside that from the image before to the last.
    motion : Motion
        As estimated from the images since.
    gap : float
        Share of the circle between two neighbouring corners, at most; 0 where the camera does not see all round.
    shift_px : int
        Coarse shift by which corners were sought in the last image that gave an answer, columns.
    """

    picture: Picture
    patches: Patches
    tangents: Tangents
    last: Floats
    predicted: Floats
    pace: Floats
    motion: Motion
    gap: float
    shift_px: int = 0


class CornerTracker:
    """Compares images with a keyframe by its corners, and remembers where they were seen last."""

    def __init__(self) -> None:
        self._keyframe: Keyframe | None = None
        self._newest: Picture | None = None

    def __call__(self, reference: Strip, current: Strip, search: Search) -> Match:
        """How the current strip lies on the reference, see `compass.match.Match`."""
        too_narrow = reference.columns <= 2 * MARGIN or len(reference.pixels) < 4 * WINDOW.half  # for patches
        if too_narrow:
            return match_small(reference, current, search)
        projection = Projection.of(reference, search.forward_px)
        key = self._keyframe_of(reference, projection)
        if len(key.patches) < FEWEST or key.gap > GAP:
            return match_small(reference, current, search)
        coarse = coarse_shift(upright_spectrum(reference, current), reference.columns, search)
        self._newest = Picture(current)
        measured = imu_tilt(reference, current, coarse.shift_px * projection.per_column)
        # an IMU may err, and of what repeats itself another peak may be the highest: then few corners are found again
        starts = dict.fromkeys([(coarse.shift_px, measured), (coarse.shift_px, (0.0, 0.0)), (key.shift_px, measured)])
        most, match = -1.0, Match(float(coarse.shift_px), math.inf, 0.0)
        for shift_px, tilt in starts:
            tried = replace(key, motion=replace(key.motion))
            inliers, found = _compared(tried, self._newest, replace(coarse, shift_px=shift_px), projection, tilt)
            if AGREE * inliers > most:
                most, match, self._keyframe = inliers, found, tried
            # no other motion has as many, but if the corners' errors grow with it, most may fit to a wrong one, too
            if 2.0 * inliers > len(key.patches) and not tried.motion.doubtful:
                break
        return match

    def _keyframe_of(self, strip: Strip, projection: Projection) -> Keyframe:
        """What is known of the keyframe; its corners are sought when it is new."""
        old, newest = self._keyframe, self._newest
        if old is not None and old.picture.strip is strip:
            return old
        picture = newest if newest is not None and newest.strip is strip else Picture(strip)
        patches = cut_patches(picture, find_corners(picture))
        tangents = Tangents.at(projection.directions(patches.at + patches.centre))
        motion = Motion.unknown()
        if old is not None and picture is newest:  # the image that was compared with the old keyframe last
            motion = old.motion
            state = motion.start.states[0]
            motion.start.states = np.array(
                [[0.0, 0.0, 0.0, state[State.DIRECTION] - state[State.YAW], state[State.CLIMB]]]
            )
            motion.start.noise = np.ones(1)
        gap = 0.0 if _sees_part(strip) else _widest_gap(patches.at[:, 0], strip.columns)
        still = np.zeros_like(patches.at)
        self._keyframe = Keyframe(picture, patches, tangents, patches.at, patches.at, still, motion, gap)
        return self._keyframe


def _widest_gap(column: Floats, columns: int) -> float:
    """Share of the circle between two neighbouring corners, at most: all of it where there are none."""
    if not column.size:
        return 1.0
    around = np.sort(column)
    return float(np.diff(around, append=around[:1] + columns).max()) / columns


def _sees_part(strip: Strip) -> bool:
    """Whether the camera itself does not see all round, so that travel sideways may look like a turn."""
    return strip.seen is not None and strip.seen.widest_hidden > MAST


def _common_parallax(key: Keyframe, problem: Problem, match: Match) -> float:
    """Of the turn, what may be parallax that all corners have in common, columns, a deviation.

    A camera that sees one side only cannot tell a turn from travel sideways past things that are all equally far. What
    they have in common is taken to be as large as what sets them apart, as far as their azimuths let it look like a
    turn: the less, the more of the circle they fill. Whereto the camera travels is no help, for that is found together
    with the turn, and wrong where the turn is. Of less than half a circle the turn as a whole may be such.
    """
    seen = key.picture.strip.seen
    narrow = seen is not None and seen.widest_hidden > 0.5
    x, y, _ = problem.tangents.ahead / np.hypot(*problem.tangents.ahead[:2])
    leverage = math.hypot(float(x.mean()), float(y.mean()))
    return leverage * (match.spread_px + (abs(match.shift_px) if narrow else 0.0))


def _compared(
    key: Keyframe, now: Picture, coarse: CoarseShift, projection: Projection, tilt: tuple[float, float]
) -> tuple[float, Match]:
    """How many corners are inliers, and how an image lies on the keyframe; the scene has about so tilted since, rad."""
    tracks, turned_px = _tracked(key, now, coarse, projection, tilt)
    energy = key.patches.contrast[tracks.index] ** 2
    confidence = min(float(tracks.likeness @ energy) / max(float(energy.sum()), 1e-9), 1.0)
    match = Match.none(float(coarse.shift_px), confidence)
    inliers = 0.0
    if tracks.index.size >= FEWEST:
        problem = _problem(key, tracks, turned_px, projection, tilt)
        fit = key.motion.follow(problem)
        inliers = float(fit.inlier.sum())
        spread = quantile(np.abs(fit.along[0]), 0.75) / problem.per_column
        if 2.0 * inliers <= len(key.patches):  # what is left of the keyframe is sought thrice, see above
            spread = math.inf
        match = _judged(key, tracks, fit, problem, Match(0.0, math.inf, confidence, coarse.status, spread))
        if not _sees_part(key.picture.strip):  # else what overlaps changes with the shift
            match = _pure_turn(key, fit, now.strip, match) or match
    if match.status is CompassStatus.LOW_CONFIDENCE:  # what misled this image shall not mislead the next one
        inliers, key.motion = 0.0, Motion.unknown()
    else:
        key.shift_px = coarse.shift_px
    return inliers, match


def _tracked(
    key: Keyframe, now: Picture, coarse: CoarseShift, projection: Projection, tilt: tuple[float, float]
) -> tuple[Tracks, float]:
    """Corners found again, and how far their median has moved since the last image whose motion is known, columns.

    They are sought where they were last, moved as the image seems to have rotated since.
    """
    rotation = undo(coarse.shift_px * projection.per_column, *tilt).T
    predicted = projection.pixels(rotation @ key.tangents.ahead) - key.patches.centre
    rotated = predicted - key.predicted
    expected = key.last + np.stack([signed(rotated[:, 0], now.columns), rotated[:, 1]], axis=1)
    # who moves by less than a first guess may be off is expected to go on so, and needs no pyramid: RMS of 16 drives
    # with that rule, with a pyramid always, and never: 0.034, 0.031, 0.039 deg; it saves a tenth of an update
    steady = not key.motion.is_unknown and quantile(np.maximum(*np.abs(key.pace).T), AGREE) < FIRST_PX
    guess = expected + key.pace if steady else expected
    tracks = track(key.picture, key.patches, now, guess.astype(np.float32), 0 if steady else 1)
    if now.clear is not None:
        column, row = np.rint(tracks.at).astype(np.intp).T
        tracks = tracks.some(now.clear[row, column % now.columns])
    since = key.patches.at if key.motion.is_unknown else key.last
    about = coarse.shift_px if key.motion.is_unknown else 0
    ways = signed(tracks.at[:, 0] - since[tracks.index, 0] - about, now.columns) + about
    key.last, key.predicted, key.pace = guess, predicted, np.zeros_like(guess)
    key.last[tracks.index] = tracks.at
    key.pace[tracks.index] = tracks.at - expected[tracks.index]
    return tracks, quantile(ways, 0.5) if ways.size else 0.0


def _problem(
    key: Keyframe, tracks: Tracks, turned_px: float, projection: Projection, tilt: tuple[float, float]
) -> Problem:
    """Ways of the corners, as bearings, and the prior."""
    tangents = key.tangents.some(tracks.index)
    seen = projection.directions(tracks.at + key.patches.centre[tracks.index])
    start = key.motion.start.states[0].copy()
    yaw = float(start[State.YAW]) + turned_px * projection.per_column
    prior = np.array([yaw, *tilt, 0.0, 0.0])
    start[ROTATION] = prior[ROTATION]
    right, mixed, down = tracks.noise * key.patches.covariance[tracks.index].T
    covariance = projection.covariance(tangents.ahead, right, mixed, down)
    return Problem.posed(tangents, seen, start, covariance, (prior, precision_of()), projection.per_column)


def _judged(key: Keyframe, tracks: Tracks, fit: Fit, problem: Problem, match: Match) -> Match:
    """The turn of a motion, its variance, and whether it is an answer."""
    px = problem.per_column
    yaw, tilt_x, tilt_y = fit.states[0, ROTATION].tolist()
    variance = yaw_variance(fit, sectors_of(tracks.at, tracks.columns), key.motion.travels) / px**2
    if not key.motion.travels:
        variance += FLOOR_PX**2
    status, inliers, badly_known = match.status, fit.inlier.sum(), False
    if variance > UNRELATED_PX**2 or inliers < FEWEST:
        badly_known = status is CompassStatus.OK and inliers > max(0.5 * len(key.patches), FEWEST)
        status = CompassStatus.LOW_CONFIDENCE
    tilt = tilt_x, tilt_y
    variance += (tilt_error(key.picture.strip, tilt) / px) ** 2
    judged = Match(wrap_angle(yaw) / px, variance, match.confidence, status, match.spread_px, tilt, badly_known)
    if _sees_part(key.picture.strip) and _widest_gap(tracks.at[:, 0], tracks.columns) > GAP:
        judged = replace(judged, variance_px2=variance + _common_parallax(key, problem, judged) ** 2)
    return judged


def _pure_turn(key: Keyframe, fit: Fit, current: Strip, match: Match) -> Match | None:
    """The same by all rows pooled, where the camera only turned and they agree with the corners; else None."""
    reference = key.picture.strip
    tilted = math.hypot(*match.tilt) > math.tau / reference.columns  # by a column, which moves no row along itself
    if key.motion.travels or tilted or fit.inlier.mean() < AGREE:
        return None
    peak, spectrum = pooled_turn(reference, current, match.shift_px)
    if peak.curvature >= 0.0:  # pixels that were doubled have no maximum half a column off
        return None
    # what moves corners by more than their patches know of moves all rows, too
    variance = turn_variance(peak, spectrum, reference) * max(float(fit.noise[0]), 1.0)
    shift = float(signed(peak.shift_px, reference.columns))
    apart = float(signed(shift - match.shift_px, reference.columns))
    # the edges of a mask stay where they are, and what has moved between, corners do without
    if variance > match.variance_px2 or apart**2 > DISAGREE**2 * (variance + match.variance_px2):
        return None
    return replace(match, shift_px=shift, variance_px2=variance, tilt=(0.0, 0.0))
