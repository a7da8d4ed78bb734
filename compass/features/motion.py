"""From the ways of corners to the motion that explains them: a turn alone, or a turn with a direction of travel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from compass.agreement import AGREE, DISAGREE
from compass.features.bearings import Index
from compass.features.points import PER_SECTOR, SECTORS, Floats
from compass.features.solver import Fit, Problem, Start, State, ascend, even_shares
from compass.flow.correlation import TINY

# Of travel that are tried where none is known: a basin of attraction is wider than 60 deg; 3 and 12 are as good
# (docs/lab-notes/halves-and-doubles-2026-11-30.md).
DIRECTIONS = 6
# By so many columns is a motion off of which nothing is known yet: with 5 tracks of a corridor that turns go astray,
# with 1 increments' error^2/variance is 1.12 times as much (docs/lab-notes/halves-and-doubles-2026-11-30.md).
FIRST_PX = 2.0


@dataclass(slots=True, eq=False)
class Motion:
    """What is known from the images before.

    Attributes
    ----------
    start : Start
        The state of the last one, and its mixture and noise.
    travels : bool
        Whether its direction of travel is known.
    is_unknown : bool
        Whether there was no image yet.
    doubtful : bool
        Whether the corners of the last image err by more than those of the image before, and many fit to no motion.
    """

    start: Start
    travels: bool = False
    is_unknown: bool = True
    doubtful: bool = False

    @staticmethod
    def unknown() -> Motion:
        """Before any image."""
        return Motion(Start(np.zeros((1, 5)), even_shares(), np.ones(1)))

    def follow(self, problem: Problem) -> Fit:
        """The motion that explains the corners' ways in the next image; it is where the one after starts."""
        fit = self._continued(problem) if self.travels else None
        if fit is None or fit.inlier.mean() < AGREE or self._noise_rose(fit):
            fit = self._anew(problem, fit)
        self.doubtful = not self.is_unknown and fit.inlier.mean() < AGREE and self._noise_rose(fit)
        self.start = Start(fit.states, fit.shares if self.travels else even_shares(), fit.noise)
        self.is_unknown = False
        return fit

    def _continued(self, problem: Problem) -> Fit:
        """From the state of the image before."""
        start = Start(problem.start[None], self.start.shares, self.start.noise)
        return ascend(problem, start, narrowing(problem.per_column, goes_on=True))

    def _noise_rose(self, fit: Fit) -> bool:
        """Whether corners err by more than a while ago, beyond what so many of them tell: another motion may fit.

        The logarithm of the ratio of two variances estimated from n corners each has the variance 4 / n.
        """
        rise = math.log(float(fit.noise[0] / self.start.noise[0]))
        return rise > DISAGREE * math.sqrt(4.0 / fit.inlier.sum())

    def _anew(self, problem: Problem, continued: Fit | None) -> Fit:
        """A turn alone, if that explains everything; else the best of all directions of travel."""
        per_column = problem.per_column
        start = Start(problem.start[None], even_shares(pushed=False), np.ones(1))
        goes_on = continued is None and not self.is_unknown
        turned = ascend(problem, start, narrowing(per_column, goes_on), pushed=False)
        # those of a sector err together, as one; a drive's first image has 16
        stands_out = parallax_score(turned, problem) ** 2 > PER_SECTOR * DISAGREE**2
        self.travels = turned.inlier.mean() < AGREE or stands_out
        if not self.travels:
            return turned
        states = np.repeat(turned.states, DIRECTIONS, axis=0)
        states[:, State.DIRECTION] += np.arange(DIRECTIONS) * math.tau / DIRECTIONS
        states[:, State.CLIMB] = 0.0
        starts = Start(states, np.repeat(even_shares(), DIRECTIONS, axis=0), np.repeat(turned.noise, DIRECTIONS))
        trials = ascend(problem, starts, narrowing(per_column))
        fit = ascend(problem, trials.only(trials.best), narrowing(per_column, goes_on=True))
        if continued is not None and continued.log_posterior[0] > fit.log_posterior[0]:
            fit = continued
        fit.ambiguity = ambiguity(trials.states[:, State.YAW], trials.log_posterior - fit.log_posterior[0], fit)
        self.travels = bool(fit.log_posterior[0] > turned.log_posterior[0])
        return fit if self.travels else turned


def narrowing(per_column: float, goes_on: bool = False) -> Floats:
    """(rounds,) deviations added to the noise in each round of an ascent, rad; each a quarter of the one before.

    The last two rounds are without. One that goes on from a motion which is about known needs no wide ones.
    """
    extra = FIRST_PX * per_column * np.array([1.0, 1 / 4, 1 / 16, 1 / 64, 0.0, 0.0])
    return extra[2:] if goes_on else extra


def ambiguity(yaw: Floats, log_odds: Floats, fit: Fit) -> float:
    """Variance of a yaw that could as well be one of those tried, at its odds, rad^2: the largest.

    `yaw` (rad) and `log_odds` against the fit are (k,) of what was tried.
    """
    odds = np.exp(np.minimum(log_odds, 0.0) / PER_SECTOR)  # those of a sector err together, as one
    apart = (yaw - fit.states[0, State.YAW] + math.pi) % math.tau - math.pi
    return float((odds / (1.0 + odds) * apart**2).max())


def parallax_score(turned: Fit, problem: Problem) -> float:
    """Deviations by which the likeliest direction of travel explains the residuals of a turn better than none.

    A score test (Rao 1948): residuals along the epipolar lines, in their deviations, are summed, each with the sine of
    its corner's angle from the travel as its weight. Deviations are those that patches claim: where corners are few,
    parallax is most of what a turn alone takes for noise.
    """
    direction = np.arange(2 * DIRECTIONS) * (math.pi / DIRECTIONS)
    lines = np.stack([np.cos(direction), np.sin(direction), 0.0 * direction], axis=1) @ problem.tangents.axes
    claimed = turned.sigma / math.sqrt(max(float(turned.noise[0]), 1.0))
    along = -(lines * turned.off.conj()).real / claimed  # times the sine
    score = (turned.inlier * along).sum(axis=1)
    expected = np.sqrt((turned.inlier * np.abs(lines) ** 2).sum(axis=1))
    return float((score / np.maximum(expected, TINY)).max())


def yaw_variance(fit: Fit, sector: Index, travels: bool) -> float:
    """Variance of the yaw, rad^2: neighbours err together, so that sectors of the circle are what is independent.

    The jackknife over them (Efron 1982, doi:10.1137/1.9781611970319): by how much the yaw changes without each sector,
    to first order. The sandwich estimator takes what few corners decide alone for free of error. What a border cuts in
    two is in both sectors, so neighbours go together in pairs: Bartlett's weights of one lag (Newey & West 1987,
    doi:10.2307/1913610).
    """
    used = 5 if travels else 3
    sectors = np.arange(SECTORS) == sector[:, None]
    seen = sectors.any(axis=0)
    sectors = sectors[:, seen].astype(np.float64)  # (n, those that show a corner)
    slopes = fit.slopes[0, :used] @ sectors
    jacobian = fit.jacobian[0, :used]
    information = (jacobian * fit.weights[0])[:, None] * jacobian
    shares = (information[..., ::2] + information[..., 1::2]) @ sectors
    without = fit.precision[0, :used, :used] - shares.transpose(2, 0, 1)
    change = np.zeros(SECTORS)
    change[seen] = np.linalg.solve(without, slopes.T[..., None])[:, 0, 0]
    pairs = change.copy()
    pairs[1:] += change[:-1]
    pairs[0] += change[-1]
    return 0.5 * float(pairs @ pairs) * (1.0 - 1.0 / max(int(seen.sum()), 1)) + fit.ambiguity
