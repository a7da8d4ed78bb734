"""The alternative hypothesis of fault isolation: the sensor that is not followed is right after all."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from fusion.buffer.events import Sensor
from fusion.checks.contradiction import CONTRADICTION_SIGMAS
from fusion.checks.windows import Claim, Window

# Of the alternative where nobody can decide: the variance of a mixture grows by that share of the squared difference of
# the two claims. Gyro and compass: the claim stays within two sigmas. The odometry, whose tracks slip: within three.
ALTERNATIVE_PROBABILITY = {Sensor.GYRO: 0.25, Sensor.COMPASS: 0.25, Sensor.TRACKS: 0.15}
# The same of tracks against a view that was found again across a gap, twice: they slip and get lifted, it seldom errs.
FOUND_AGAIN_PROBABILITY = 0.1
# Not derived: `LONGEST_ROW_NS`, `AGREEING`, `UNDECIDED`.
LONGEST_ROW_NS = 1_000_000_000  # after a window a contradiction is taken to go on for, until the next one is judged
AGREEING = 0.4  # of the way from one to the other; a third as near to one takes its side
UNDECIDED = 0.4  # of the way, standard deviation: nor with less does it know where between the two it is


@dataclass(frozen=True, slots=True)
class Third:
    """On whose side a third sensor is while two contradict: 0 the followed one's, 1 the alternative's.

    The weighted least-squares fit of its claims between those of the two, window by window.

    Attributes
    ----------
    information : float
        Sum of squared differences between the two over the third's variance, but for its scale factor.
    moment : float
        The same of the differences times what the third claims beyond the followed one.
    scaled : float
        The same of the differences times the third's turn: by so much its scale factor moves the moment.
    scale : float
        Standard deviation of the scale factor, as a fraction.
    """

    information: float = 0.0
    moment: float = 0.0
    scaled: float = 0.0
    scale: float = 0.0

    def plus(self, claim: Claim | None, followed: float, difference: float) -> Third:
        """With a window in which the followed one turned by `followed`, and the alternative by `difference` more."""
        if claim is None:
            return self
        beyond = claim.turn - followed
        outside = max(beyond - max(difference, 0.0), min(difference, 0.0) - beyond, 0.0)
        if outside > AGREEING * abs(difference) + CONTRADICTION_SIGMAS * claim.sigma:
            return self  # it contradicts both
        weighed = difference / claim.noise**2
        return Third(
            self.information + weighed * difference,
            self.moment + weighed * beyond,
            self.scaled + weighed * claim.turn,
            max(self.scale, claim.scale),
        )

    def swapped(self) -> Third:
        """With the other one followed."""
        return replace(self, moment=self.information - self.moment, scaled=-self.scaled)

    @property
    def side(self) -> bool | None:
        """Whether it takes the side of the alternative; None where it is too vague, or on neither side."""
        if self.information <= 0.0:
            return None
        at = self.moment / self.information
        if math.hypot(self.information**-0.5, self.scale * self.scaled / self.information) > UNDECIDED:
            return None
        if abs(at - 1.0) < AGREEING:
            return True
        return False if abs(at) < AGREEING else None


@dataclass(frozen=True, slots=True)
class Alternative:
    """The hypothesis that a sensor is right that is not followed, and what it claims.

    Attributes
    ----------
    sensor : Sensor
    since_ns : int
    offset : float
        Its yaw less the filter's, rad.
    bias : float
        Bias with which its claims count if it is the gyro, rad/s.
    third : Third
        What a third sensor says.
    until_ns : int or None
        End of the last window that is in the offset.
    rate : float
        At which the offset grew in it, rad/s: as long as nobody knows better, it goes on so.
    no_bias : bool
        Whether a compass was followed before it, and no bias of the gyro explained all that they contradict by.
    """

    sensor: Sensor
    since_ns: int
    offset: float
    bias: float = 0.0
    third: Third = field(default_factory=Third)
    until_ns: int | None = None
    rate: float = 0.0
    no_bias: bool = False

    def variance(self, t_ns: int) -> float:
        """What it adds at a time, ns, to that of the yaw, rad^2."""
        later_ns = 0 if self.until_ns is None else min(t_ns - self.until_ns, LONGEST_ROW_NS)
        return ALTERNATIVE_PROBABILITY[self.sensor] * (self.offset + self.rate * later_ns * 1e-9) ** 2

    def plus(self, turn: float, window: Window) -> Alternative:
        """With a window in which the sensor claims a `turn`, rad, beyond the filter's."""
        return replace(self, offset=self.offset + turn, until_ns=window.t_ns, rate=turn / window.seconds)

    @property
    def against(self) -> Sensor:
        """Who is followed instead of a gyro or a compass."""
        return Sensor.GYRO if self.sensor is Sensor.COMPASS else Sensor.COMPASS

    def turn(self, claim: Claim, seconds: float, bias: float) -> float:
        """Its turn in a window, rad; a gyro's with the bias that it had before, and not with the present one."""
        return claim.turn + ((bias - self.bias) * seconds if self.sensor is Sensor.GYRO else 0.0)
