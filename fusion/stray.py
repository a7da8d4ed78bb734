"""How far the stamps of images stray, learnt from what the compass says while the robot turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

SIGMAS = tuple(1e-4 * 10.0 ** (k / 4.0) for k in range(12))  # s, 0.1 to 56 ms, the standard deviations that are tried
MEMORY = 300  # images while turning
TAIL = 10.0  # degrees of freedom of the innovations, which have other reasons, too


@dataclass(frozen=True, slots=True)
class Stray:
    """What is known of the standard deviation: `known` (s) if nothing else is, else log-weights of `SIGMAS`.

    `prior` are those known beforehand, to which the others return in time.
    """

    known: float
    weights: tuple[float, ...] = ()
    prior: tuple[float, ...] = ()

    @staticmethod
    def about(sigma: float, factor: float) -> Stray:
        """Known to be `sigma` (s) but for a factor, as a standard deviation; 1: exactly."""
        if sigma == 0.0 or factor == 1.0:
            return Stray(sigma)
        prior = tuple(-0.5 * (math.log(one / sigma) / math.log(factor)) ** 2 for one in SIGMAS)
        return Stray(sigma, prior, prior)

    @property
    def variance(self) -> float:
        """Mean of the squared deviation, s^2."""
        if not self.weights:
            return self.known**2
        top = max(self.weights)
        shares = [math.exp(weight - top) for weight in self.weights]
        return float(sum(share * sigma**2 for share, sigma in zip(shares, SIGMAS, strict=True)) / sum(shares))

    def after(self, innovation: float, others: float, rate: float) -> Stray:
        """After an innovation (rad) at a turn rate (rad/s); `others` is its variance for all other reasons, rad^2."""
        if not self.weights or (SIGMAS[-1] * rate) ** 2 < others:
            return self  # it tells nothing
        keep, weights = 1.0 - 1.0 / MEMORY, []
        for weight, prior, sigma in zip(self.weights, self.prior, SIGMAS, strict=True):
            S = others + (sigma * rate) ** 2
            likelihood = -0.5 * math.log(S) - 0.5 * (TAIL + 1.0) * math.log1p(innovation**2 / (TAIL * S))
            weights.append(keep * weight + (1.0 - keep) * prior + likelihood)
        top = max(weights)
        return Stray(self.known, tuple(weight - top for weight in weights), self.prior)
