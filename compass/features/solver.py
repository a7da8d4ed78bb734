"""Rotation and travel from tracked corners: the mode of their posterior, by Gauss-Newton inside EM.

What a corner has moved by, once the rotation is undone, is split along and across its epipolar line. Across it there is
noise; along it noise and a parallax that is never negative (see `density`); or the corner is an outlier. Noise is
Student's t: each corner's own scale follows from its residual across, where no prior touches it, and so does the scale
that all share. Component and both scales of a corner are the hidden variables of the EM algorithm (Dempster,
Laird & Rubin 1977; for the t, Lange, Little & Taylor 1989, doi:10.1080/01621459.1989.10478852).

Parallaxes of neighbours are no independent draws: a picture on a wall has one distance, and its ten corners would pull
the yaw to where that is infinite. So along their lines all corners of a sector weigh as much as one: a composite
likelihood, whose variance the jackknife over sectors gives (Varin, Reid & Firth 2011, Statistica Sinica 21, 5-42).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from compass.features.bearings import Complexes, Tangents, undo
from compass.features.density import exponentially_modified
from compass.features.padded_strip import WINDOW
from compass.features.points import Floats
from compass.flow.correlation import TINY


class State(IntEnum):
    """Where the unknowns are in the state of a motion; all in rad."""

    YAW = 0
    TILT_X = 1
    TILT_Y = 2
    DIRECTION = 3
    CLIMB = 4


ROTATION = slice(0, 3)
FREEDOM = 3.0  # degrees of freedom of the t: 2 to 5 differ by a tenth in the yaw's RMS over a drive
# Of the parallaxes, columns: from what noise hides to a keyframe's end. Halved, held-out drives err as much, and
# their raw yaw by 1.05; doubled, tuned ones by 1.14 and 1.18 (docs/lab-notes/constants-, walk-2026-11-30.md).
MEANS_PX = np.array([0.3, 2.0, 12.0])


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """n corners of one image, in the tangent planes of the keyframe's.

    Attributes
    ----------
    tangents : Tangents
        At the keyframe's directions.
    moved : (n,) complex array
        Where they are seen once the rotation of `start` is undone, rad.
    rotating : (3, n) complex array
        How that moves with the rotation, rad per rad.
    start : (5,) array
        Yaw, tilt about x and y, direction of travel, climb, rad.
    covariance : (2, n) complex array
        Of `moved`: mean of the variances to the left and up, and half of the first less the second plus i times their
        covariance, rad^2, but for a factor that all share.
    prior_mean, prior_precision : (5,) arrays
        Of the state, rad and rad^-2.
    per_column, scale : float
        rad; the latter as many times as much as corners move further than between neighbours.
    """

    tangents: Tangents
    moved: Complexes
    rotating: Complexes
    start: Floats
    covariance: Complexes
    prior_mean: Floats
    prior_precision: Floats
    per_column: float
    scale: float

    @staticmethod
    def posed(
        tangents: Tangents,
        seen: Floats,
        start: Floats,
        covariance: Complexes,
        prior: tuple[Floats, Floats],
        per_column: float,
        scale: float | None = None,
    ) -> Problem:
        """Of corners that are now seen in (3, n) directions; `prior` is its mean and precision."""
        now = undo(*start[ROTATION]) @ seen
        return Problem(
            tangents,
            tangents.project(now),
            tangents.rotating(now),
            start,
            covariance,
            *prior,
            per_column,
            scale or per_column,
        )

    @property
    def means(self) -> Floats:
        """(exponentials, 1, 1) mean parallaxes abeam, rad."""
        return (MEANS_PX * self.scale)[:, None, None]


@dataclass(slots=True, eq=False)
class Start:
    """What k ascents start from; arrays with k in front.

    Attributes
    ----------
    states : (k, 5) array
        As `Problem.start`.
    shares : (k, components) array
        Of the mixture: no parallax first, then each of `MEANS_PX`, outliers last.
    noise : (k,) array
        Factor by which the covariances have to be multiplied.
    """

    states: Floats
    shares: Floats
    noise: Floats

    @staticmethod
    def unknown(states: Floats, pushed: bool = True) -> Start:
        """(k, 5) states, with nothing known of the mixture and the noise."""
        return Start(states, np.repeat(even_shares(pushed), len(states), axis=0), np.ones(len(states)))

    def only(self, index: int) -> Start:
        """One of them."""
        one = slice(index, index + 1)
        return Start(self.states[one], self.shares[one], self.noise[one])


@dataclass(slots=True, eq=False)
class Fit(Start):
    """What they came to.

    Attributes
    ----------
    log_posterior : (k,) array
        At the states, but for a constant.
    precision : (k, 5, 5) array
        Its negative curvature there, rad^-2.
    slopes : (k, 5, n) array
        Of each corner's share of it, 1/rad.
    jacobian, weights : (k, 5, 2 n), (k, 2 n) arrays
        Change of the residuals along and across, in turn, with the state; what each weighs in the precision, rad^-2.
    inlier : (k, n) array
        Probability of being none of the outliers.
    off : (k, n) complex array
        Residuals to the left and up, rad.
    along, sigma : (k, n) arrays
        Residuals along the epipolar lines, and their noise's standard deviations, rad.
    ambiguity : float
        Variance of the yaw for its being another motion, rad^2.
    """

    log_posterior: Floats
    precision: Floats
    slopes: Floats
    jacobian: Floats
    weights: Floats
    inlier: Floats
    off: Complexes
    along: Floats
    sigma: Floats
    ambiguity: float = 0.0

    @property
    def best(self) -> int:
        """Which is the likeliest."""
        return int(self.log_posterior.argmax())


def even_shares(pushed: bool = True) -> Floats:
    """(1, components) nothing known of the mixture."""
    count = MEANS_PX.size + 2 if pushed else 2
    return np.full((1, count), 1.0 / count)


def ascend(problem: Problem, start: Start, extra: Floats, pushed: bool = True) -> Fit:
    """Follow the posterior upwards from each of some states.

    Parameters
    ----------
    start : Start
        States, shares and noise to begin with.
    extra : (rounds,) array
        Deviation that is added to the noise in each round, rad: wide at first, so that a distant start is not lost.
    pushed : bool
        Whether there are parallaxes; else direction of travel and climb stay as they are, and `shares` are those of
        no parallax and of outliers.
    """
    states, shares, noise = start.states, start.shares, start.noise
    # outliers lie evenly over what a search finds: a patch at half the size, to either side
    uniform = 2.0 * math.pi / (2.0 * 2.0 * WINDOW.side * problem.scale) ** 2
    least_precision = np.diag(problem.prior_precision + TINY)
    longest = (problem.prior_precision + TINY) ** -0.5
    parts = np.empty((shares.shape[1], len(states), problem.moved.size))  # of the mixture: how likely, of each corner
    bends = np.empty((2, len(parts) - 1, *parts.shape[1:]))  # slope of the logarithm of all but the outliers', and bend
    slope, bend = bends
    forces, weights = both = np.empty((2, *parts.shape[1:], 2))  # along and across
    bend[0] = 1.0
    together = 1.0 / np.bincount(problem.tangents.sector)[problem.tangents.sector]
    means = problem.means
    for index, beyond in enumerate((*(extra * extra).tolist(), None)):
        if pushed or not index:  # the lines of a turn alone stay
            lines = _Lines(problem, states)
        lines.split(problem, states)
        var_along, var_across = lines.variances(problem, noise)
        if beyond:
            var_along, var_across = var_along + beyond, var_across + beyond
        ratio = lines.across**2 / var_across
        scale = (FREEDOM + 1.0) / (FREEDOM + ratio)  # of the corner's own precision
        var_along /= scale
        sigma = np.sqrt(var_along)
        scaled = lines.along / sigma
        np.negative(scaled, out=slope[0])
        parts[0] = np.exp(-0.5 * scaled * scaled)
        if pushed:
            parts[1:-1], slope[1:], bend[1:] = exponentially_modified(scaled, sigma / (lines.length * means))
        parts[:-1] *= scale ** (0.5 * (FREEDOM + 1.0)) / (sigma * np.sqrt(var_across))
        parts[-1] = uniform
        parts *= shares.T[:, :, None]
        total = parts.sum(axis=0)
        parts /= total
        inlier = 1.0 - parts[-1]
        across = inlier * scale / var_across
        if pushed or not index:
            jacobian = lines.jacobian(problem, pushed)
        np.einsum("ckn,bckn->bkn", parts[:-1], bends, out=both[..., 0])
        forces[..., 0] /= sigma
        weights[..., 0] /= var_along
        forces[..., 1], weights[..., 1] = -across * lines.across, across
        # what is not known of the corners' own scales takes its share of the information (Lange et al. 1989)
        weights *= (FREEDOM + 1.0) / (FREEDOM + 3.0)
        if pushed:
            both[..., 0] *= together
        precision = (jacobian * weights.reshape(len(states), 1, -1)) @ jacobian.transpose(0, 2, 1)
        precision += least_precision
        condition(precision)
        if beyond is None:
            break
        gradient = (jacobian @ forces.reshape(len(states), -1, 1))[..., 0] - problem.prior_precision * (
            states - problem.prior_mean
        )
        change = np.linalg.solve(precision, gradient[..., None])[..., 0]
        # nor further in one round than a deviation of the prior: an IMU may err, and the way is long
        states = states + np.minimum(np.maximum(change, -longest), longest)
        shares = parts.sum(axis=2).T + 1.0  # the posterior mean of a flat Dirichlet prior
        shares /= shares.sum(axis=1, keepdims=True)
        if not beyond:
            free = 5.0 if pushed else 3.0
            left = (inlier * scale * ratio).sum(axis=1)
            noise = noise * left / np.maximum(inlier.sum(axis=1) - free, 1.0)
    log_posterior = np.log(total).sum(axis=1)
    log_posterior -= 0.5 * (problem.prior_precision * (states - problem.prior_mean) ** 2).sum(axis=1)
    pulls = jacobian * forces.reshape(len(states), 1, -1)
    slopes = pulls[..., ::2] + pulls[..., 1::2]
    weights = weights.reshape(len(states), -1)
    seen = inlier, lines.off, lines.along, sigma
    return Fit(states, shares, noise, log_posterior, precision, slopes, jacobian, weights, *seen)


def condition(precision: Floats) -> None:
    """Make (k, 5, 5) precisions invertible where one exact corner is all there is, in place; by a part in 10^6."""
    diagonal = precision.reshape(-1, 25)[:, ::6]
    diagonal *= 1.0 + TINY**2


class _Lines:
    """Epipolar lines of n corners for k states, and the residuals along and across them, (k, n) arrays."""

    def __init__(self, problem: Problem, states: Floats) -> None:
        direction, climb = states[:, State.DIRECTION], states[:, State.CLIMB]
        sine, cosine, level, rise = np.sin(direction), np.cos(direction), np.cos(climb), np.sin(climb)
        travel = cosine * level, sine * level, rise
        changes = -sine * level, cosine * level, 0.0 * rise, -cosine * rise, -sine * rise, level
        # of the travel, and of its changes with direction and climb
        vectors = np.array([*travel, *changes]).T.reshape(len(states), 3, 3)
        seen = vectors.astype(np.complex128) @ problem.tangents.axes
        self._travel, self._changes = seen[:, 0], seen[:, 1:]
        # whose patch shows where the camera travels to or comes from has no line
        self.length = np.maximum(np.abs(self._travel), WINDOW.half * problem.per_column)
        self._back = -self._travel.conj() / self.length  # turns what lies away from the travel to the real axis

    def split(self, problem: Problem, states: Floats) -> None:
        """Residuals of states whose lines these are."""
        self.off = (states - problem.start)[:, ROTATION] @ problem.rotating + problem.moved
        self._residual = self.off * self._back
        self.along, self.across = self._residual.real, self._residual.imag

    def variances(self, problem: Problem, noise: Floats) -> tuple[Floats, Floats]:
        """(k, n) variances along and across."""
        mean, excess = problem.covariance
        excess = (excess * self._back * self._back).real
        least = (TINY * problem.per_column) ** 2
        return noise[:, None] * (mean.real + excess) + least, noise[:, None] * (mean.real - excess) + least

    def jacobian(self, problem: Problem, pushed: bool) -> Floats:
        """(k, 5, 2 n) change of the residuals along and across, in turn, with the state."""
        jacobian = np.empty((len(self.along), 5, self.along.shape[1]), np.complex128)
        np.multiply(problem.rotating, self._back[:, None], out=jacobian[:, ROTATION])
        swings = jacobian[:, State.DIRECTION :]
        if pushed:  # by so many rad do the lines turn
            turning = (self._changes * (self._back / -self.length)[:, None]).imag
            np.multiply(-1j * self._residual[:, None], turning, out=swings)
        else:
            swings[:] = 0.0
        return jacobian.view(np.float64)
