"""Two independent instruments that agree are both right: what that says of the gyro's bias and the tracks' veer.

While a robot keeps to one speed, a gyro's bias and tracks that veer cannot be told apart, and the filter, whose priors
are normal, allows for errors of any size that happen to cancel. But whether this gyro and these tracks are good or bad
ones of their kind is not known beforehand: each prior's standard deviation may be any from the configured one down to
that of a calibrated one. Errors that cancel are then a coincidence, and agreement tells that both are small (a scale
mixture of normals: West 1987, doi:10.1093/biomet/74.3.646). Where a measurement tells the two apart this
changes nothing.
"""

from __future__ import annotations

import math
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

    def mixed(self, x: Array, P: Array, states: tuple[int, int]) -> tuple[Array, Array]:
        """State and covariance where the priors of the two `states` may have any of these deviations.

        A narrower prior is the configured one and a measurement of zero beside. So each pair of priors is exact, by
        one Kalman update; then the mixture's mean and covariance are taken.
        """
        (i, j), (one, other) = states, self.sigmas
        R, other_R, constant = _narrower(self.sigmas, self.least)
        m, n = float(x[i]) / one, float(x[j]) / other
        own, others = max(float(P[i, i]) / one**2, 0.0), max(float(P[j, j]) / other**2, 0.0)
        most = math.sqrt(own * others)  # rounding may leave more
        c = min(max(float(P[i, j]) / (one * other), -most), most)
        a, b = own + R, others + other_R
        det = a * b - c * c
        p, q, r = b / det, -c / det, a / det  # of the innovations' inverse covariance
        u, v = p * m + q * n, q * m + r * n
        evidence = constant - 0.5 * np.log(det) - 0.5 * (m * u + n * v)
        weight = np.exp(evidence - np.maximum.reduce(evidence))
        weight /= np.add.reduce(weight)  # half the time of `weight.sum()`
        # over the mixture: x - G S_inv m, P - G S_inv G' and the spread of the means
        G = P[:, [i, j]] / [one, other]
        mean_u, mean_v = float(np.add.reduce(weight * u)), float(np.add.reduce(weight * v))
        u -= mean_u
        v -= mean_v
        both = np.add.reduce(weight * (u * v - q))
        change: Array = np.array(
            ((np.add.reduce(weight * (u * u - p)), both), (both, np.add.reduce(weight * (v * v - r))))
        )
        return x - G @ [mean_u, mean_v], P + G @ change @ G.T


@lru_cache(maxsize=8)  # of a config
def _narrower(sigmas: tuple[float, float], least: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Variances of the measurement of zero of either error, and the evidence's constant: each of all pairs, (49,)."""
    shares = np.minimum(np.array(least) / np.array(sigmas), 1.0)[:, None] ** STEPS
    R = np.minimum(shares**2 / np.maximum(1.0 - shares**2, 1.0 / UNINFORMATIVE), UNINFORMATIVE)
    narrow = -np.log(shares) + 0.5 * np.log(R)
    one, other = (np.ravel(part) for part in np.meshgrid(*R, indexing="ij"))
    return one, other, np.ravel(narrow[0][:, None] + narrow[1])
