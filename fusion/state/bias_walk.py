"""How fast a gyro's bias walks, learnt from what a compass contradicts it by.

A gyro that warms up drifts by a hundred times what its data sheet says, too slowly for any window to show a
contradiction. A filter that is sure of the bias then explains the rest by whatever else is uncertain: the camera's
delay, the timestamp jitter, the gyro's scale. So beside it a bank of scalar Kalman filters follows the bias, each with
another random walk, weighted by the likelihood of what it did not expect (Magill 1965, doi:10.1109/TAC.1965.1098191).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from fusion.checks.windows import Start, Window
from fusion.state.learnt_noise import normalised

FACTORS = tuple(4.0**k for k in range(5))  # on the random walk as configured
# Not derived: `MEMORY`, `TAIL`, `TIMING`, `LASTS`.
MEMORY = 60  # windows of half a second
TAIL = 10.0  # degrees of freedom of Student's distribution
TIMING = 0.01  # s, by which gyro and images may be shifted at least; it shows at the ends of a turn and does not add up
LASTS = 0.1  # share of the variance of a compass's turn that adds up from window to window: keyframes last


@dataclass(frozen=True, slots=True)
class Drift:
    """By how much a gyro has gone on beyond a compass, rad, the rate of that, rad/s, and their covariance."""

    turn: float
    bias: float
    turn_variance: float
    covariance: float = 0.0
    bias_variance: float = 0.0

    def after(self, turn: float, seconds: float, walk: float, noise: float, R: float) -> tuple[Drift, float]:
        """After a window with so much more turn, of which `noise` adds up and `R` does not; and the log-likelihood."""
        # predicted: the bias walks, the turn is its integral less what is measured
        p, c, b = self.turn_variance, self.covariance, self.bias_variance
        p += 2.0 * c * seconds + b * seconds**2 + walk**2 * seconds**3 / 3.0 + noise
        c += b * seconds + walk**2 * seconds**2 / 2.0
        b += walk**2 * seconds
        off, S = turn - self.turn - self.bias * seconds, p + R
        likelihood = -0.5 * (math.log(S) + (TAIL + 1.0) * math.log1p(off * off / (TAIL * S)))
        # and what the filter believes of the turn, counted from what is measured now
        drift = Drift((p / S - 1.0) * off, self.bias + c / S * off, p * R / S, c * R / S, b - c * c / S)
        return drift, likelihood


def _mean_square(weights: tuple[float, ...]) -> float:
    """Of `FACTORS` by their log-weights."""
    shares = list(map(math.exp, weights))
    return sum(share * factor**2 for share, factor in zip(shares, FACTORS, strict=True)) / sum(shares)


@dataclass(frozen=True, slots=True)
class BiasWalk:
    """Random walks that a bias may have, and their weights.

    Attributes
    ----------
    walk : float
        As configured, rad/s/sqrt(s).
    prior, weights : tuple of float
        Log-weights, of each of `FACTORS`; empty where the walk is known.
    drifts : tuple of Drift
        By each; empty before the first window.
    t_ns : int or None
        When the last window ended, ns.
    scale : float
        Squared factor on the walk: its mean over that of the prior, so that without a compass it is one.
    """

    walk: float
    prior: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    drifts: tuple[Drift, ...] = ()
    t_ns: int | None = None
    scale: float = field(init=False, compare=False)

    def __post_init__(self) -> None:
        scale = _mean_square(self.weights) / _mean_square(self.prior) if self.prior else 1.0
        object.__setattr__(self, "scale", scale)

    @staticmethod
    def about(walk: float, factor: float) -> BiasWalk:
        """Known but for a factor, as a standard deviation; 1: exactly."""
        if walk == 0.0 or factor == 1.0:
            return BiasWalk(walk)
        prior = normalised([-0.5 * (math.log(one) / math.log(factor)) ** 2 for one in FACTORS])
        return BiasWalk(walk, prior, prior)

    def after(self, window: Window, start: Start) -> BiasWalk:
        """After a window in which gyro and compass do not contradict; `start`: what was known at its beginning."""
        gyro, compass, seconds = window.gyro, window.compass, window.seconds
        if not self.prior or gyro is None or compass is None:
            return self
        beyond = gyro.turn - compass.turn + start.bias * seconds
        noise = max(gyro.noise**2 - (start.bias_sigma * seconds) ** 2, 0.0)
        noise += LASTS * compass.noise**2 + (gyro.scale * compass.turn) ** 2
        timing = max(start.delay_sigma, TIMING)
        R = compass.noise**2 + (timing * (start.rate + window.rate_change)) ** 2
        drifts = self.drifts
        if self.t_ns != window.start_ns:  # joined to nothing: all begin with what the filter knows by now
            before = compass.noise**2 + (timing * start.rate) ** 2
            drifts = (Drift(0.0, start.bias, before, 0.0, start.bias_sigma**2),) * len(FACTORS)
        found = [
            one.after(beyond, seconds, factor * self.walk, noise, R)
            for one, factor in zip(drifts, FACTORS, strict=True)
        ]
        forgotten = 1.0 / MEMORY
        weights = [
            (1.0 - forgotten) * weight + forgotten * prior + likelihood
            for weight, prior, (_, likelihood) in zip(self.weights, self.prior, found, strict=True)
        ]
        return BiasWalk(self.walk, self.prior, normalised(weights), tuple(one for one, _ in found), window.t_ns)
