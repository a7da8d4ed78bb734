"""The alternative hypothesis of fault isolation: the sensor that is not followed is right after all."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from fusion.buffer.events import Sensor
from fusion.checks.contradiction import CONTRADICTION_SIGMAS
from fusion.checks.recovery import Recovery
from fusion.checks.windows import Claim, Window
from fusion.record import replace

# Probability of the alternative while nobody can decide. By that share of the squared difference of the two claims the
# published variance grows, as that of a mixture does: a wrong yaw stays within two sigmas where gyro and compass
# contradict each other, and within 2.6 where it is the odometry, whose tracks slip.
ALTERNATIVE_PROBABILITY = {Sensor.GYRO: 0.25, Sensor.COMPASS: 0.25, Sensor.TRACKS: 0.15}
# The same of tracks that contradict two images which found an old view again after a gap: tracks slip, or the robot is
# lifted; that two matches err alike is rare.
FOUND_AGAIN_PROBABILITY = 0.1
# Not derived: `LONGEST_ROW_NS`, `AGREEING`.
LONGEST_ROW_NS = 1_000_000_000  # for so long after the last window a claim is extrapolated at its last rate
AGREEING = 0.4  # of the difference of two claims; a third sensor that is farther outside contradicts both
# Difference of squared misfits at which one side is a thousand times as likely: with twenty times, tracks decide for a
# gyro of a wrong factor (docs/lab-notes/majorities-2026-11-30.md).
DECIDED = 2.0 * math.log(1000.0)
LEAST_SCALE = 0.05  # of tracks: the least that `initial_scale` may be; with less they have not turned with the robot
NEARER = (AGREEING / (1.0 - AGREEING)) ** 2  # ratio of the two squared misfits above which no side is taken


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a third sensor's claims fit what another one turned by, its scale factor being free.

    Attributes
    ----------
    turns, products : float
        Sums over windows of the other's squared turn, and of its turn times the claim, over the claim's variance.
    """

    turns: float = 0.0
    products: float = 0.0

    def plus(self, claim: Claim, turn: float) -> Fit:
        """With one more window."""
        return Fit(self.turns + (turn / claim.noise) ** 2, self.products + turn * claim.turn / claim.noise**2)

    def misfit(self, claims: float, scale_sigma: float) -> float:
        """Squared deviations that are left, with the best scale factor; `claims`: sum of the squared claims."""
        if scale_sigma <= 0.0:
            return claims - 2.0 * self.products + self.turns
        known = scale_sigma**-2
        scale = (self.products + known) / (self.turns + known)
        left = claims - 2.0 * scale * self.products + scale**2 * self.turns
        return left + known * math.log(max(scale, LEAST_SCALE)) ** 2  # half and double are as far from one


@dataclass(frozen=True, slots=True)
class Third:
    """On whose side a third sensor is while two contradict, window by window.

    Its scale factor is not known: it may explain a turn that is larger or smaller, but none where there was none.

    Attributes
    ----------
    followed, other : Fit
        To the one that is followed, and to the alternative.
    claims : float
        Sum of its squared claims over their variance.
    scale : float
        Standard deviation of its scale factor, as a fraction.
    """

    followed: Fit = field(default_factory=Fit)
    other: Fit = field(default_factory=Fit)
    claims: float = 0.0
    scale: float = 0.0

    def plus(self, claim: Claim | None, one: Claim, other: Claim) -> Third:
        """With a window: what it claims, what `one` does, which is followed, and the `other`, the alternative."""
        if claim is None:
            return self
        claim = replace(claim, noise=math.hypot(claim.noise, one.noise, other.noise))
        followed, difference = one.turn, other.turn - one.turn
        beyond = claim.turn - followed
        outside = max(beyond - max(difference, 0.0), min(difference, 0.0) - beyond, 0.0)
        if outside > AGREEING * abs(difference) + CONTRADICTION_SIGMAS * claim.sigma:
            return self  # it contradicts both
        return Third(
            self.followed.plus(claim, followed),
            self.other.plus(claim, followed + difference),
            self.claims + (claim.turn / claim.noise) ** 2,
            max(self.scale, claim.scale),
        )

    def swapped(self) -> Third:
        """With the other one followed."""
        return replace(self, followed=self.other, other=self.followed)

    @property
    def side(self) -> bool | None:
        """Whether it takes the side of the alternative; None where it is too vague, or on neither side."""
        followed, other = self._misfits
        if self.vague or min(followed, other) > NEARER * max(followed, other):
            return None
        return bool(other < followed)

    @property
    def vague(self) -> bool:
        """Whether both are about as likely."""
        followed, other = self._misfits
        return abs(followed - other) < DECIDED

    @property
    def _misfits(self) -> tuple[float, float]:
        """Squared deviations from the one that is followed, and from the alternative."""
        followed, other = (one.misfit(self.claims, self.scale) for one in (self.followed, self.other))
        return followed, other


@dataclass(frozen=True, slots=True)
class Alternative:
    """The hypothesis that a sensor is right that is not followed, and what it claims.

    Attributes
    ----------
    sensor : Sensor
    since_ns : int
    offset : float
        Its yaw less the filter's, rad.
    most : float
        The largest that ever was, in magnitude: of tracks, whose scale factor is not known, it may be any until then.
    bias : float
        Bias with which its claims count if it is the gyro, rad/s.
    third : Third
        What a third sensor says.
    change : float
        By how much the turn rate has changed over the windows in the offset, rad/s.
    until_ns : int or None
        End of the last window that is in the offset.
    rate : float
        At which the offset grew in it, rad/s: as long as nobody knows better, it goes on so.
    recovery : Recovery or None
        Whether it is as it was before; None before the first window since.
    driven : bool
        Whether the robot has driven since: as long as it stands, that it turns along with what it stands on, as the
        gyro has it, is as likely as before.
    no_bias : bool
        Whether a compass was followed before it, and no bias of the gyro explained all that they contradict by.
    refuted : bool
        Whether a third sensor has decided against it: it counts again should that find otherwise.
    by_rest : bool
        Whether nothing speaks for it but tracks that have rested since the start.
    """

    sensor: Sensor
    since_ns: int
    offset: float
    bias: float = 0.0
    third: Third = field(default_factory=Third)
    until_ns: int | None = None
    rate: float = 0.0
    no_bias: bool = False
    recovery: Recovery | None = None
    most: float = 0.0
    driven: bool = True
    change: float = 0.0
    refuted: bool = False
    by_rest: bool = False

    def variance(self, t_ns: int) -> float:
        """What it adds at a time, ns, to that of the yaw, rad^2."""
        if self.refuted:
            return 0.0
        later_ns = 0 if self.until_ns is None else min(t_ns - self.until_ns, LONGEST_ROW_NS)
        offset = abs(self.offset + self.rate * later_ns * 1e-9)
        if self.sensor is Sensor.TRACKS:
            offset = max(offset, self.most)
        return ALTERNATIVE_PROBABILITY[self.sensor] * offset**2

    def plus(self, turn: float, window: Window) -> Alternative:
        """With a window in which the sensor claims a `turn`, rad, beyond the filter's."""
        change, rate = self.change + window.rate_change, turn / window.seconds
        return replace(self.apart(turn), until_ns=window.t_ns, rate=rate, change=change)

    def apart(self, by: float) -> Alternative:
        """With a yaw that is off the filter's by so much more, rad."""
        offset = self.offset + by
        return replace(self, offset=offset, most=max(self.most, abs(offset)))

    def reversed(self, bias: float, window: Window) -> Alternative:
        """That the one that was followed until this window is right after all; `bias`: its own, rad/s."""
        claim, other = window.claim(self.sensor), window.claim(self.against)
        rate = (other.turn - claim.turn) / window.seconds if claim and other else 0.0
        third, since_ns = self.third.swapped(), self.since_ns
        return Alternative(self.against, since_ns, -self.offset, bias, third, window.t_ns, rate)

    @property
    def against(self) -> Sensor:
        """Who is followed instead of a gyro or a compass."""
        return Sensor.GYRO if self.sensor is Sensor.COMPASS else Sensor.COMPASS

    def turn(self, claim: Claim, seconds: float, bias: float) -> float:
        """Its turn in a window, rad; a gyro's with the bias that it had before, and not with the present one."""
        return claim.turn + ((bias - self.bias) * seconds if self.sensor is Sensor.GYRO else 0.0)
