"""Relative pose of a camera on the ground between two views, by RANSAC over bearings of the same points in both.

Epipolar constraint: a bearing b before the camera moved along t is afterwards on the great circle through b and t,
further from t than before (positive depth), and not behind -t. Two points give turn and t in closed form. Of many pairs
that are drawn, the motions with most inliers are refined (Fischler & Bolles 1981, doi:10.1145/358669.358692).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from compass.angles import wrap_angle
from compass.features.prior import INDEPENDENT
from compass.flow.correlation import Floats

# Pairs of bearings; each gives two turns, and travel ahead or back. Where a fifth are inliers, a pair of inliers is
# among them with a probability of 0.998.
DRAWS = 150
COUNTED = 200  # bearings that judge what was drawn: the share of inliers to 0.035
# Inlier threshold of a motion that was drawn: roll and pitch are not estimated yet. Turns no further apart than that
# share their inliers.
ROUGH_INLIER = np.deg2rad(4.0)
# Best motions that are refined, with turns that share no inliers; with three, one pair of views of `weave` was 12.3 deg
# off at a claimed 1.2 (docs/lab-notes/gaps-2026-11-28.md).
STARTS = 6
OTHER_TURN = np.deg2rad(45.0)  # a turn so far away is another answer; not derived
WIDTHS = np.deg2rad([6.0, 3.0, 1.5, 0.75])  # scales of the robust weights while a motion is refined
GAUSS_NEWTON_ROUNDS = 8  # at most, at each width
DERIVATIVE_STEP = 1e-4  # rad, of numerical derivatives; a smaller change of the turn ends a width
PRIORS = np.deg2rad([1e3, 1e3, 6.0, 6.0, 6.0])  # deviations of turn, direction, tilt about x and y, climb
UNTILT = np.array([[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0.0]])  # rotations by -1 about x and y
# Not derived: `WIDTHS`, `PRIORS`, `INLIER`, `TURN_FLOOR`, `TILT_GAIN`.
INLIER = np.deg2rad(1.0)  # inlier threshold of the refined motion
SHUFFLES = 8  # of the partners, to know what chance gives
TURN_FLOOR = np.deg2rad(0.06)  # error that no number of bearings averages out
MIN_SCATTER = 1e-8  # rad^2, mean squared residual at least; else nothing is left of `PRIORS`
TILT_GAIN = 4.0  # error of the turn per tilt or climb and share of outliers


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How a camera moved.

    Attributes
    ----------
    states : (1, 5) array
        Turn to the left about its own axis, direction of travel, the scene's tilt about x and y before the turn, climb;
        rad.
    variance : float
        Of the turn, rad^2.
    support : float
        Number of inliers, each weighted by how small its residual is.
    ambiguity : float
        What of that variance allows for its being another motion, rad^2.
    """

    states: Floats
    variance: float
    support: float
    ambiguity: float = 0.0

    @property
    def turn(self) -> float:
        """In [-pi, pi), rad."""
        return wrap_angle(float(self.states[0, 0]))


def find_motion(seen: Floats, again: Floats, besides: float | None = None) -> Motion:
    """The motion with most inliers.

    Parameters
    ----------
    seen, again : (n, 3) arrays
        Bearings of the same points before and after, unit vectors, outliers among them; x ahead, y left, z up.
    besides : float, optional
        A turn, rad, to keep `OTHER_TURN` away from.
    """
    drawn = _drawn(seen, again)
    some = np.random.default_rng(2).permutation(len(seen))[:COUNTED]
    seen_some, again_some = seen[some], again[some]
    miss = misses(drawn, seen_some.astype(np.float32), again_some.astype(np.float32))
    support = np.maximum(1.0 - miss / ROUGH_INLIER**2, 0.0).sum(axis=1)
    if besides is not None:
        support[np.cos(drawn[:, 0] - besides) > np.cos(OTHER_TURN)] = -1.0
    tried = []
    for _ in range(STARTS):
        start = drawn[support.argmax()]
        tried.append(_refined(start, seen_some, again_some))
        for turn in start[0], tried[-1].turn:
            support[np.cos(drawn[:, 0] - turn) > np.cos(ROUGH_INLIER)] = -1.0
    likeliest = max(tried, key=attrgetter("support"))
    ambiguity = max(_ambiguity(likeliest, other) for other in tried)
    best = _refined(likeliest.states[0], seen, again)
    return replace(best, variance=best.variance + ambiguity, ambiguity=ambiguity)


def _ambiguity(best: Motion, other: Motion) -> float:
    """Variance of a turn that could be another one, at the odds that their inliers give, rad^2."""
    odds = np.exp(INDEPENDENT * (other.support - best.support))
    return float(odds / (1.0 + odds) * wrap_angle(other.turn - best.turn) ** 2)


def _drawn(seen: Floats, again: Floats) -> Floats:
    """(4 * DRAWS, 5) level motions, each through two bearings: t is the line that their epipolar planes share."""
    i, j = np.random.default_rng(0).integers(len(seen), size=(2, DRAWS))
    a, b = (np.arctan2(one[:, 1], one[:, 0]) for one in (seen, again))
    e, f = (one[:, 2] / np.hypot(one[:, 0], one[:, 1]) for one in (seen, again))
    whole = f[i] * f[j] * np.sin(a[i] - a[j]) + e[i] * e[j] * np.sin(b[i] - b[j])
    cosine = f[i] * e[j] * np.sin(a[i] - b[j]) + e[i] * f[j] * np.sin(b[i] - a[j])
    sine = e[i] * f[j] * np.cos(b[i] - a[j]) - f[i] * e[j] * np.cos(a[i] - b[j])
    either = np.arccos(np.clip(whole / np.maximum(np.hypot(cosine, sine), 1e-12), -1.0, 1.0))
    turn = np.arctan2(sine, cosine) + np.stack([either, -either])
    y, x = (f[i] * of(a[i]) - e[i] * of(b[i] + turn) for of in (np.sin, np.cos))
    ahead = np.arctan2(y, x).ravel()
    motions = np.zeros((4 * DRAWS, 5))
    motions[:, 0], motions[:, 1] = np.tile(turn.ravel(), 2), np.concatenate([ahead, ahead + np.pi])
    return motions


def _angles_missed(motions: Floats, seen: Floats, again: Floats) -> Floats:
    """(3, motions, n) angles by which bearings leave their circle, come nearer to t, or pass behind -t, rad."""
    turn, direction, climb = motions[:, 0], motions[:, 1], motions[:, 4]
    about_z = np.zeros((len(motions), 3, 3))
    about_z[:, 0, 0] = about_z[:, 1, 1] = np.cos(turn)
    about_z[:, 1, 0], about_z[:, 0, 1], about_z[:, 2, 2] = np.sin(turn), -np.sin(turn), 1.0
    untilt = (motions[:, 2:4] @ UNTILT).reshape(-1, 3, 3)
    rotation = ((np.eye(3) + untilt + 0.5 * untilt @ untilt) @ about_z).astype(seen.dtype)  # from after to before
    level = np.cos(climb)
    travel = np.stack([np.cos(direction) * level, np.sin(direction) * level, np.sin(climb)], axis=1).astype(seen.dtype)
    products = (seen.T[:, None] * again.T).reshape(9, -1)
    off = np.cross(rotation, travel[:, :, None], axis=1).reshape(-1, 9) @ products
    together = rotation.reshape(-1, 9) @ products
    ahead, now_ahead = travel @ seen.T, (travel[:, None] @ rotation)[:, 0] @ again.T
    aside, now_aside = (np.sqrt(np.maximum(1.0 - one * one, 1e-6)) for one in (ahead, now_ahead))
    nearer = np.maximum(now_ahead - ahead * together, 0.0) / aside
    passed = np.maximum(ahead * now_ahead - together, 0.0) / np.maximum(aside, now_aside)
    return np.stack([off / np.hypot(aside, now_aside), nearer, passed])


def misses(motions: Floats, seen: Floats, again: Floats) -> Floats:
    """(motions, n) squared residuals of bearings for motions, (motions, 5) as in `Motion`; rad^2."""
    return np.asarray(np.square(_angles_missed(motions, seen, again)).sum(axis=0))


def _refined(states: Floats, seen: Floats, again: Floats) -> Motion:
    """The motion near `states`, (5,), by robust Gauss-Newton: Geman-McClure weights, each time narrower."""
    trials = DERIVATIVE_STEP * np.concatenate([np.zeros((1, 5)), np.eye(5), -np.eye(5)])
    for width in WIDTHS:
        for _ in range(GAUSS_NEWTON_ROUNDS):
            angles = _angles_missed(states + trials, seen, again).transpose(1, 0, 2)
            missed = np.square(angles[0]).sum(axis=0)
            weight = (1.0 + missed / width**2) ** -2
            scatter = max(float(weight @ missed / weight.sum()), MIN_SCATTER)
            weight, angles = np.tile(weight, 3), angles.reshape(len(trials), -1)
            slope = (angles[1:6] - angles[6:]) / (2.0 * DERIVATIVE_STEP)
            precision = (slope * weight) @ slope.T + np.diag(scatter / PRIORS**2)
            step = np.linalg.solve(precision, slope @ (weight * angles[0]) + scatter * states / PRIORS**2)
            states = states - step
            if abs(step[0]) < DERIVATIVE_STEP:
                break
    known = scatter * np.linalg.inv(precision)[0, 0] / INDEPENDENT
    missed = misses(states[None], seen, again)
    outliers = float(np.mean(missed > INLIER**2))
    variance = float(known + TURN_FLOOR**2 + (TILT_GAIN * outliers) ** 2 * (states[2:] @ states[2:]))
    return Motion(states[None], variance, float(np.maximum(1.0 - missed / INLIER**2, 0.0).sum()))


def evidence(motion: Motion, seen: Floats, again: Floats) -> float:
    """Nats by which a motion has more inliers than among shuffled pairs: a binomial's large deviation."""
    rng, count = np.random.default_rng(1), len(seen)
    partners = np.concatenate([rng.permutation(count) for _ in range(SHUFFLES)])
    shuffled = misses(motion.states, np.tile(seen, (SHUFFLES, 1)), again[partners]) < INLIER**2
    inliers = int(np.count_nonzero(misses(motion.states, seen, again) < INLIER**2))
    chance, share = (float(shuffled.sum()) / SHUFFLES + 0.5) / (count + 1.0), min(inliers / count, 1.0 - 1e-9)
    if share <= chance:
        return 0.0
    nats = share * np.log(share / chance) + (1.0 - share) * np.log((1.0 - share) / (1.0 - chance))
    return float(count * nats)
