"""Two independent instruments that agree are both right: what that says of the gyro's bias and the tracks' veer.

While a robot keeps to one speed, a gyro's bias and tracks that veer cannot be told apart, and the filter, whose priors
are normal, allows for errors of any size that happen to cancel. But whether this gyro and these tracks are good or bad
ones of their kind is not known beforehand: each prior's standard deviation may be any from the configured one down to
that of a calibrated one. Errors that cancel are then a coincidence, and agreement tells that both are small (a scale
mixture of normals: West 1987, doi:10.1093/biomet/74.3.646). Where a measurement tells the two apart this
changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
STEPS = np.arange(7.0) / 6.0  # from the configured standard deviation to the least, by their logarithm, all as likely
UNINFORMATIVE = 1e9  # variance of an uninformative measurement, in units of the prior's


@dataclass(frozen=True, slots=True)
class BiasPrior:
    """Standard deviations that two errors have at most, as the filter takes them to have, and at least."""

    sigmas: tuple[float, float]
    least: tuple[float, float]

    def mixed(self, x: Array, P: Array, states: Sequence[int]) -> tuple[Array, Array]:
        """State and covariance where the priors of the two `states` may have any of these deviations.

        A narrower prior is the configured one and a measurement of zero beside. So each pair of priors is exact, by
        one Kalman update; then the mixture's mean and covariance are taken.
        """
        states, sigmas = list(states), np.array(self.sigmas)
        m = x[states] / sigmas
        C = P[np.ix_(states, states)] / np.outer(sigmas, sigmas)
        R, narrow = _narrower(self.sigmas, self.least)
        own = np.maximum(np.diagonal(C), 0.0)
        most = float((own[0] * own[1]) ** 0.5)  # rounding may leave more
        c = min(max(float(C[0, 1]), -most), most)
        a, b = own[0] + R[0][:, None], own[1] + R[1][None, :]
        det = a * b - c**2
        S_inv = np.stack([b / det, -c / det + 0.0 * a, a / det])  # of the innovations, symmetric
        weighted = np.stack([S_inv[0] * m[0] + S_inv[1] * m[1], S_inv[1] * m[0] + S_inv[2] * m[1]])
        misfit = m[0] * weighted[0] + m[1] * weighted[1]
        evidence = narrow[0][:, None] + narrow[1][None, :] - 0.5 * np.log(det) - 0.5 * misfit
        weight = np.exp(evidence - evidence.max())
        weight /= weight.sum()
        # over the mixture: x - G S_inv m, P - G S_inv G' and the spread of the means
        G = P[:, states] / sigmas
        mean = (weight * weighted).sum(axis=(1, 2))
        off = weighted - mean[:, None, None]
        shrunk = (weight * S_inv).sum(axis=(1, 2))
        spread = (weight * np.stack([off[0] ** 2, off[0] * off[1], off[1] ** 2])).sum(axis=(1, 2))
        change = (spread - shrunk)[[0, 1, 1, 2]].reshape(2, 2)
        return x - G @ mean, P + G @ change @ G.T


@lru_cache(maxsize=8)  # of a config
def _narrower(sigmas: tuple[float, float], least: tuple[float, float]) -> tuple[Array, Array]:
    """Of either error and each deviation, (2, 7): variance of the measurement of zero, and the evidence's constant."""
    shares = np.minimum(np.array(least) / np.array(sigmas), 1.0)[:, None] ** STEPS
    R = np.minimum(shares**2 / np.maximum(1.0 - shares**2, 1.0 / UNINFORMATIVE), UNINFORMATIVE)
    return R, -np.log(shares) + 0.5 * np.log(R)
