"""Standard deviations of noises that no constant fits, learnt from innovations while driving.

Good wheels and slipping tracks differ tenfold, so do the turn rates of a wheelbarrow and of a racer, and the stamps of
a camera triggered by hardware and of one behind a web server. A bank of hypotheses, weighted by the likelihood of the
innovations (Magill 1965, doi:10.1109/TAC.1965.1098191).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from operator import mul

from fusion.record import record

JITTERS = tuple(1e-4 * 10.0 ** (k / 4.0) for k in range(12))  # s, 0.1 to 56 ms of timestamp jitter
# Not derived: `JITTER_MEMORY`, `JITTER_TAIL`, `FACTOR_TAIL`.
JITTER_MEMORY = 300  # images while turning
JITTER_TAIL = 10.0  # degrees of freedom of their innovations, which have other reasons, too
FACTORS = tuple(2.0 ** (k / 2.0) for k in range(-8, 5))  # 1/16 to 4, on what is configured
FACTOR_TAIL = 30.0  # slips and starts are rare and large


@record
class LearntNoise:
    """What is known of a standard deviation: `known` if nothing else is, else log-weights of the squares it may have.

    `prior` are those known beforehand, to which the others return within `memory` innovations. These are taken to be of
    Student's distribution with `tail` degrees of freedom. `variance` is the mean of the squared deviation.
    """

    known: float
    squares: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    prior: tuple[float, ...] = ()
    memory: float = 1.0
    tail: float = 1.0
    variance: float = field(init=False, compare=False)  # asked for at every step, and changes seldom

    def __post_init__(self) -> None:
        object.__setattr__(self, "variance", self._mean_square())

    @staticmethod
    def about(sigma: float, factor: float, values: Sequence[float], memory: float, tail: float) -> LearntNoise:
        """Known to be `sigma` but for a factor, as a standard deviation; 1: exactly."""
        if sigma == 0.0 or factor == 1.0:
            return LearntNoise(sigma)
        prior = normalised([-0.5 * (math.log(one / sigma) / math.log(factor)) ** 2 for one in values])
        return LearntNoise(sigma, tuple(one**2 for one in values), prior, prior, memory, tail)

    @staticmethod
    def jitter(sigma: float, factor: float) -> LearntNoise:
        """Timestamp jitter of the images, s."""
        return LearntNoise.about(sigma, factor, JITTERS, JITTER_MEMORY, JITTER_TAIL)

    @staticmethod
    def factor(factor: float, memory: float) -> LearntNoise:
        """A factor on what is configured, which is one but for this `factor`, as a standard deviation."""
        return LearntNoise.about(1.0, factor, FACTORS, memory, FACTOR_TAIL)

    def _mean_square(self) -> float:
        if not self.weights:
            return self.known**2
        shares = list(map(math.exp, self.weights))
        total: float = sum(map(mul, shares, self.squares))
        return total / sum(shares)

    def after(self, innovation: float, others: float, gain: float) -> LearntNoise:
        """After an innovation in which it shows `gain` times; `others` is the variance for all other reasons."""
        squared = gain * gain
        if not self.weights or self.squares[-1] * squared < others:
            return self  # uninformative
        log = math.log
        forgotten = 1.0 / self.memory
        keep, power, scaled = 1.0 - forgotten, self.tail + 1.0, innovation * innovation / self.tail
        weights = []  # in a loop: before Python 3.12 a list comprehension is a function of its own, and slower
        for weight, prior, square in zip(self.weights, self.prior, self.squares):  # noqa: B905 - `strict` is slower
            S = others + square * squared
            weights.append(keep * weight + forgotten * prior - 0.5 * (log(S) + power * log(1.0 + scaled / S)))
        return LearntNoise(self.known, self.squares, normalised(weights), self.prior, self.memory, self.tail)


def normalised(weights: list[float]) -> tuple[float, ...]:
    """Log-weights of which the largest is zero."""
    top = max(weights)
    return tuple([weight - top for weight in weights])
