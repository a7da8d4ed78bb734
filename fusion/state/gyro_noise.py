"""Noise of a gyro, learnt from its own samples: how they scatter about a smooth turn, and which are repeated."""

from __future__ import annotations

import math
from dataclasses import field

from fusion.checks.rate_turn import SAME
from fusion.checks.windows import SAME_NUMBER
from fusion.record import record
from fusion.state.learnt_noise import LearntNoise

# Not derived: `NOISE_FACTORS`, `NOISE_MEMORY`, `NOISE_TAIL`, `COARSEST`, `HOLDS`, `PROVEN`,
# `FINE`, `HUNG`, `AT_REST`.
NOISE_FACTORS = tuple(2.0 ** (k / 2.0) for k in range(11))  # 1 to 32, on what is configured
NOISE_MEMORY = 500.0  # third differences, each of four samples
NOISE_TAIL = 10.0  # degrees of freedom; robots start and bump
COARSEST = 0.1  # rad/s; no gyro's resolution is more
PROVEN, FINE = 200, 3  # samples before of which no number came so often in a row: it has noise, and repeats nothing
HUNG = 25  # samples that are one number
AT_REST = 10.0  # deviations of its noise, within which a gyro may be at rest, where drivers say one number
HOLDS = 5  # numbers in a row, each sent more than once, that make a gyro one that is sent more often than it measures


def third_difference(walk: float, ramp: float, dt: float) -> float:
    """Variance, (rad/s)^2, that a turn rate gives to the third difference of samples `dt` s apart.

    Its acceleration is Gauss-Markov of correlation time `ramp`, s; over long times the rate walks by `walk`, rad/s a
    square root of a second.
    """
    kept = math.exp(-dt / ramp)
    own, next_one = dt - ramp * (1.0 - kept), 0.5 * ramp * (1.0 - kept) ** 2
    return walk**2 * max(6.0 * own - 8.0 * next_one + 2.0 * next_one * kept, 0.0)


@record
class GyroNoise:
    """What a gyro's samples say of their noise.

    Attributes
    ----------
    factor : LearntNoise
        On the noise that is configured.
    rates : tuple of float
        The last samples that the next third difference needs, rad/s.
    since_ns : int
        Stamp of the first of these.
    rate : float or None
        The last sample, rad/s.
    run, held, longest : int
        How often that number came in a row, the one before, and any before at most.
    holds : int
        How many numbers in a row came more than once.
    coarse : bool
        Whether a number has ever come twice in a row: numbers finer than the noise hardly do.
    step : float
        Least change between two samples, rad/s: no less than the resolution.
    count : int
        Of all samples.
    before : float
        The sample before the number that comes in a row at present, rad/s.
    begun_ns : int
        Stamp of the first sample of that row.
    """

    factor: LearntNoise = field(default_factory=lambda: LearntNoise(1.0))
    rates: tuple[float, ...] = ()
    since_ns: int = 0
    rate: float | None = None
    run: int = 1
    held: int = 1
    longest: int = 1
    holds: int = 0
    coarse: bool = False
    step: float = math.inf
    count: int = 0
    before: float = 0.0
    begun_ns: int = 0

    @staticmethod
    def prior(factor: float) -> GyroNoise:
        """Before the first sample: the noise is as configured but for this `factor`, as a standard deviation."""
        return GyroNoise(LearntNoise.about(1.0, factor, NOISE_FACTORS, NOISE_MEMORY, NOISE_TAIL))

    def variance(self, rate: float, sigma: float) -> float:
        """Of what a sample (rad/s) is off by, (rad/s)^2, beyond its noise `sigma`, rad/s: the numbers are that coarse.

        Rounded or truncated, it is off by the same all the while that it is one number: all these are one measurement.
        """
        if not (self.coarse and sigma < self.step <= COARSEST):
            return 0.0
        return self.step**2 / 3.0 * (self.run + 1 if self._again(rate) else 1)

    def hangs(self, rate: float, sigma: float) -> bool:
        """Whether a sample (rad/s) is one more of a number that comes again and again, though others differ by less."""
        return self._again(rate) and self.run >= SAME_NUMBER and not sigma < self.step <= COARSEST

    def repeats(self, rate: float, sigma: float) -> bool:
        """Whether a sample (rad/s) is the last one sent again: the resolution is finer than the noise `sigma`."""
        return self._again(rate) and self.holds >= HOLDS and self.run < 2 * self.held and self.step < sigma

    def hung(self, bias: float, sigma: float) -> bool:
        """Whether a gyro that has noise repeats one number, and not for being at rest: it measures nothing any more.

        Of one that hangs while the robot stands nobody can tell, as drivers say so, too.
        """
        if self.rate is None or self.run < HUNG or not self._proven:
            return False
        return max(abs(self.rate - bias), abs(self.rate - self.before)) > AT_REST * sigma

    @property
    def frozen(self) -> bool:
        """Whether a gyro that has noise repeats one number that is no zero, as a driver's is for one at rest."""
        return self.run >= SAME_NUMBER and self._proven and self.rate is not None and abs(self.rate) > SAME

    @property
    def _proven(self) -> bool:
        """Whether so many samples came before the present number that it has noise, and repeats nothing."""
        return self.count - self.run >= PROVEN and self.longest < FINE

    def unseen(self, t_ns: int, rate_sigma: float) -> float:
        """Variance, rad^2, of what a robot may have turned while it hung, up to a stamp, ns."""
        return (rate_sigma * (t_ns - self.begun_ns) * 1e-9) ** 2

    @property
    def stuck(self) -> bool:
        """Whether one number comes again and again, more than twice as often as any did before."""
        return self.run > 2 * self.longest

    def _again(self, rate: float) -> bool:
        return self.rate is not None and abs(rate - self.rate) <= SAME

    def after(self, t_ns: int, rate: float, sigma: float, walk: float, ramp: float) -> GyroNoise:
        """After a sample of a gyro whose noise is configured as `sigma`, rad/s; the rest as `third_difference`."""
        run, held, longest, holds = self.run, self.held, self.longest, self.holds
        coarse, step, before, begun_ns = self.coarse, self.step, self.before, self.begun_ns
        if self.rate is not None:
            change = abs(rate - self.rate)
            if change <= SAME:
                run, coarse = run + 1, True
            else:
                longest, before, begun_ns = max(longest, run), self.rate, t_ns
                held, run, holds = run, 1, holds + 1 if run > 1 else 0
                step = min(step, change)
        rates, since_ns, factor = (*self.rates, rate), self.since_ns if self.rates else t_ns, self.factor
        if len(rates) == 4:
            a, b, c, d = rates
            motion = third_difference(walk, ramp, (t_ns - since_ns) * 1e-9 / 3.0) / 20.0
            factor = factor.after((d - a + 3.0 * (b - c)) / math.sqrt(20.0), motion, sigma)
            rates = ()
        count = self.count + 1
        row = run, held, longest, holds, coarse, step, count, before, begun_ns
        return GyroNoise(factor, rates, since_ns, rate, *row)
