"""Noise of a gyro, learnt from its own samples: how they scatter about a smooth turn, and which are repeated."""

from __future__ import annotations

import math
from dataclasses import field

from fusion.checks.rate_turn import SAME
from fusion.checks.windows import SAME_NUMBER
from fusion.record import record
from fusion.state.learnt_noise import LearntNoise

# Not derived: `NOISE_FACTORS`, `NOISE_MEMORY`, `NOISE_TAIL`, `COARSEST`, `HOLDS`, `PROVEN`, `HUNG`, `AT_REST`, `HALT`.
NOISE_FACTORS = tuple(2.0 ** (k / 2.0) for k in range(11))  # 1 to 32, on what is configured
NOISE_MEMORY = 500.0  # third differences, each of four samples
NOISE_TAIL = 10.0  # degrees of freedom; robots start and bump
COARSEST = 0.1  # rad/s; no gyro's resolution is more
PROVEN = 200  # samples that differed from the one before: it has noise
HUNG = 5  # samples that are one number, of a gyro that has noise: its driver or its link hangs
AT_REST = 10.0  # deviations of its noise, within which a gyro may be at rest, where drivers say one number
HALT = 0.1  # rad/s; from faster turns no robot comes to rest between two samples
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
    moving : int
        The same as `longest` of numbers that no gyro at rest says, and none that hangs.
    changes : int
        How many samples were not the one before.
    holds : int
        How many numbers in a row came more than once.
    coarse : bool
        Whether a number has ever come twice in a row: numbers finer than the noise hardly do.
    step : float
        Least change between two samples, rad/s: no less than the resolution.
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
    moving: int = 1
    changes: int = 0
    holds: int = 0
    coarse: bool = False
    step: float = math.inf
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

    def hangs_at(self, rate: float, bias: float, sigma: float) -> bool:
        """Whether a sample (rad/s) is one number more often in a row than ever, of a gyro that has noise, and no rest.

        Of one that begins to hang while the robot stands nobody can tell, as drivers say zero for a gyro at rest, too.
        """
        return self._again(rate) and self.run >= self.moving and self._proven and self._moves(bias, sigma)

    @property
    def hung(self) -> bool:
        """Whether so many samples are one number that one more is no chance."""
        return self.run + 1 >= max(HUNG, 2 * self.moving)

    def _moves(self, bias: float, sigma: float) -> bool:
        """Whether the present number is none that a gyro says at rest."""
        rate = self.rate or 0.0
        return abs(rate - bias) > AT_REST * sigma or abs(rate - self.before) > HALT

    @property
    def frozen(self) -> bool:
        """Whether a gyro that has noise repeats one number that is no zero, as a driver's is for one at rest."""
        return self.run >= SAME_NUMBER and self._proven and self.rate is not None and abs(self.rate) > SAME

    @property
    def _proven(self) -> bool:
        """Whether a gyro has noise, and is not sent more often than it measures."""
        return self.changes >= PROVEN and self.moving < SAME_NUMBER

    @property
    def stuck(self) -> bool:
        """Whether one number comes again and again, more than twice as often as any did before."""
        return self.run > 2 * self.longest

    def _again(self, rate: float) -> bool:
        return self.rate is not None and abs(rate - self.rate) <= SAME

    def after(self, t_ns: int, rate: float, bias: float, sigma: float, walk: float, ramp: float) -> GyroNoise:
        """After a sample of a gyro of this bias and configured noise `sigma`, rad/s; the rest as `third_difference`."""
        run, held, longest, holds = self.run, self.held, self.longest, self.holds
        coarse, step, before, begun_ns = self.coarse, self.step, self.before, self.begun_ns
        moving, changes = self.moving, self.changes
        if self.rate is not None:
            change = abs(rate - self.rate)
            if change <= SAME:
                run, coarse = run + 1, True
            else:
                if run > moving and not (self._proven and self.hung) and self._moves(bias, sigma):
                    moving = run
                longest, before, begun_ns, changes = max(longest, run), self.rate, t_ns, changes + 1
                held, run, holds = run, 1, holds + 1 if run > 1 else 0
                step = min(step, change)
        rates, since_ns, factor = (*self.rates, rate), self.since_ns if self.rates else t_ns, self.factor
        if len(rates) == 4:
            a, b, c, d = rates
            motion = third_difference(walk, ramp, (t_ns - since_ns) * 1e-9 / 3.0) / 20.0
            factor = factor.after((d - a + 3.0 * (b - c)) / math.sqrt(20.0), motion, sigma)
            rates = ()
        row = run, held, longest, moving, changes, holds, coarse, step, before, begun_ns
        return GyroNoise(factor, rates, since_ns, rate, *row)
