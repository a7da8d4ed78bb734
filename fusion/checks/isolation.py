"""Fault detection and isolation: who is excluded, what is in doubt, and what evidence there is.

Sample by sample the gyro is by far the most precise, so a filter would believe it against all others; and a compass
that is steadily misled would in time be believed against a sound gyro. So over windows of half a second the sensors are
compared as turns (`fusion.checks.windows`, judged in `fusion.checks.isolation_rules`):

- Where two of three agree, the third is excluded. What the filter believed of it in that window is taken back.
- Where only two speak, or the third is too vague to tell, nobody can know who is right. One is followed, the other
  excluded, and what the other claims beyond it, summed up, is a *doubt*: it widens the published variance.
- An excluded sensor is trusted again once it agrees where it would have been seen to err: in a window with at least
  half the turning of the least one in which it contradicted. Driving straight tells nothing of a wrong sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from fusion.buffer.events import Sensor
from fusion.checks.time_offset import EVERY, TimeOffset, Turned, time_offset, with_window
from fusion.checks.windows import Claim, Window

GROSS = 0.02  # rad/s; smaller contradictions are for the filter's gates to settle
CLEAR = 5.0  # standard deviations of a contradiction
CLEAR_SCALE = 2.5  # of scale factors: theirs are no normal distributions, none is negative
MOST_STRIKES = 6
NEVER = 1_000_000_000  # windows
NO_SPIKES = 3  # windows with turns that no robot makes
CHANGED = 0.1  # rad/s in a window; who errs at less errs at a steady rate, too
EVIDENCE = 20  # windows with a contradiction that are remembered, to name the fault
# Probability that a sensor is right that is not followed although nobody could tell: a share of its claim beyond the
# other, squared. Gyro and compass: the claim stays within two sigmas. The odometry, whose tracks slip: within three.
DOUBT = {Sensor.GYRO: 0.25, Sensor.COMPASS: 0.25, Sensor.TRACKS: 0.15}
# The same of tracks against a view that was found again across a gap, twice: they slip and get lifted, it seldom errs.
DOUBT_FOUND_AGAIN = 0.1
LONGEST_ROW_NS = 1_000_000_000  # after a window a contradiction is taken to go on for, until the next one tells
AGREEING = 0.4  # of the way from one to the other; a third as near to one takes its side
VAGUE = 0.4  # of the way, standard deviation: nor with less does it know where between the two it is
BEST_FIRST = (Sensor.COMPASS, Sensor.GYRO, Sensor.TRACKS)


def limit(one: Claim, other: Claim, seconds: float) -> float:
    """By how much two claims may differ before they contradict, rad; no scale factor makes a turn of none."""
    noise = math.hypot(max(one.noise, one.at_worst), max(other.noise, other.at_worst))
    scale = math.hypot(one.scale, other.scale) * min(abs(one.turn), abs(other.turn))
    return max(GROSS * seconds, CLEAR * noise + CLEAR_SCALE * scale)


def contradict(one: Claim | None, other: Claim | None, seconds: float) -> bool:
    """Whether two sensors cannot both be right."""
    return bool(one and other and abs(one.turn - other.turn) > limit(one, other, seconds))


def _fits_anything(sensor: Sensor, turn_rate: float, window: Window) -> bool:
    """Whether a bias found at a turn rate (rad/s) may stand for a wrong scale, too, or for images that do not turn."""
    return sensor is Sensor.GYRO and not window.gyro_beyond and (abs(turn_rate) > GROSS or window.tracks is None)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A sensor that is not listened to.

    Attributes
    ----------
    sensor : Sensor
    since_ns : int
        Beginning of the first window in which it contradicted.
    least_turn, least_size, least_change : float
        Least turn rate in which it contradicted, by how much it did at least, and by how much the turn rate at least
        changed meanwhile, rad/s: only in as much turning, and against one who knows better than that, it can show that
        it is well; one that is late, only where the rate changes.
    windows : int
        In how many it has contradicted.
    agreed : int
        In how many telling ones in a row it has agreed since.
    fitted : float or None
        Turn rate, rad/s, at which a gyro was given the bias with which it would agree. At that rate it agrees whatever
        is wrong with it; at another one only if that is its bias. None while it has erred at rest only: that is bias.
    """

    sensor: Sensor
    since_ns: int
    least_turn: float
    least_size: float
    least_change: float = 0.0
    windows: int = 1
    agreed: int = 0
    fitted: float | None = None

    def again(self, turn: float, size: float, window: Window) -> Exclusion:
        """After one more window with a contradiction by `size`, while the others turned by `turn`, rad."""
        turn_rate, size = turn / window.seconds, size / window.seconds
        turning, least_size = min(self.least_turn, abs(turn_rate)), min(self.least_size, abs(size))
        changing = min(self.least_change, abs(window.rate_change))
        fitted = turn_rate if self.fitted is not None or _fits_anything(self.sensor, turn_rate, window) else None
        return Exclusion(self.sensor, self.since_ns, turning, least_size, changing, self.windows + 1, fitted=fitted)

    def shows_well(self, claim: Claim, reference: Claim, window: Window) -> bool:
        """Whether it agrees with a reference in a window in which it would have been seen to err."""
        seconds = window.seconds
        if self.least_change > CHANGED and abs(window.rate_change) < 0.5 * self.least_change:
            return False
        telling = 0.5 * self.least_size * seconds  # nearer to none than to the least contradiction there was
        sharp = max(abs(claim.turn - reference.turn), math.hypot(claim.sigma, reference.sigma)) < telling
        if self.fitted is not None:
            return sharp and abs(reference.turn - self.fitted * seconds) >= telling
        return sharp and abs(reference.turn) >= 0.5 * self.least_turn * seconds


@dataclass(frozen=True, slots=True)
class Third:
    """On whose side a third sensor is while two contradict: 0 the followed one's, 1 the doubted one's.

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
        """With a window in which the followed one turned by `followed`, and the doubted one by `difference` more."""
        if claim is None:
            return self
        beyond = claim.turn - followed
        outside = max(beyond - max(difference, 0.0), min(difference, 0.0) - beyond, 0.0)
        if outside > AGREEING * abs(difference) + CLEAR * claim.sigma:
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
        """Whether it takes the side of the doubted one; None where it is too vague, or on neither side."""
        if self.information <= 0.0:
            return None
        at = self.moment / self.information
        if math.hypot(self.information**-0.5, self.scale * self.scaled / self.information) > VAGUE:
            return None
        if abs(at - 1.0) < AGREEING:
            return True
        return False if abs(at) < AGREEING else None


@dataclass(frozen=True, slots=True)
class Doubt:
    """What a sensor claims that is not followed, should it be right after all.

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
        return DOUBT[self.sensor] * (self.offset + self.rate * later_ns * 1e-9) ** 2

    def plus(self, turn: float, window: Window) -> Doubt:
        """With a window in which the sensor claims a `turn`, rad, beyond the filter's."""
        return replace(self, offset=self.offset + turn, until_ns=window.t_ns, rate=turn / window.seconds)

    @property
    def against(self) -> Sensor:
        """Who is followed instead of a gyro or a compass."""
        return Sensor.GYRO if self.sensor is Sensor.COMPASS else Sensor.COMPASS

    def turn(self, claim: Claim, seconds: float, bias: float) -> float:
        """Its turn in a window, rad; a gyro's with the bias that it had before, and not with the present one."""
        return claim.turn + ((bias - self.bias) * seconds if self.sensor is Sensor.GYRO else 0.0)


@dataclass(frozen=True, slots=True)
class Remedy:
    """What the filter has to do after a window.

    Attributes
    ----------
    shift, shift_variance : float
        To add to the yaw, rad, and to its variance, rad^2.
    bias, bias_sigma : float or None, float
        What the gyro's bias seems to be, and its standard deviation, rad/s; None where nothing changes.
    fold : float
        Variance by which the frame of all yaws is known less, rad^2.
    delay : float
        By how much more than thought the images seem to be stamped late, s.
    rate : float or None
        The turn rate that the robot has instead of what the gyro said, rad/s.
    """

    shift: float = 0.0
    shift_variance: float = 0.0
    bias: float | None = None
    bias_sigma: float = math.inf
    fold: float = 0.0
    delay: float = 0.0
    rate: float | None = None

    @staticmethod
    def of(remedies: Iterable[Remedy]) -> Remedy:
        """Several in one; of biases the last counts."""
        total = Remedy()
        for one in remedies:
            bias = (total.bias, total.bias_sigma) if one.bias is None else (one.bias, one.bias_sigma)
            shift = total.shift + one.shift, total.shift_variance + one.shift_variance
            rate = total.rate if one.rate is None else one.rate
            total = Remedy(*shift, *bias, total.fold + one.fold, total.delay + one.delay, rate)
        return total


@dataclass(frozen=True, slots=True)
class Isolation:
    """Who is excluded, and what is in doubt.

    Attributes
    ----------
    exclusions : tuple of Exclusion
    doubts : tuple of Doubt
    evidence : tuple of Window
        The last windows with a contradiction.
    strikes : tuple of int
        How often each sensor was excluded, in the order of `Sensor`; it takes ``2**(strikes - 1)`` telling windows of
        agreement to be trusted again.
    windows : int
        How many were compared.
    last : Window or None
        The last of them: a fault may have begun in it without being seen.
    long : Window or None
        The last ones together, in which nothing contradicted: what is lost in the noise of one shows in several.
    turned : tuple of Turned
        What each sensor turned by in the last windows without a gap.
    offset : TimeOffset or None
        Whose clock is off, as they tell.
    """

    exclusions: tuple[Exclusion, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    evidence: tuple[Window, ...] = ()
    strikes: tuple[int, ...] = (0,) * len(Sensor)
    windows: int = 0
    last: Window | None = None
    long: Window | None = None
    turned: tuple[Turned, ...] = ()
    offset: TimeOffset | None = None

    def with_turns(self, window: Window, bias: float) -> Isolation:
        """With what the sensors turned by in one more window, the gyro's bias (rad/s) not taken out."""
        turned, windows = with_window(self.turned, Turned.of(window, bias)), self.windows + 1
        offset = time_offset(turned) if windows % EVERY == 0 else self.offset
        return replace(self, turned=turned, offset=offset, windows=windows)

    def excludes(self, sensor: Sensor) -> bool:
        """Whether a sensor is not listened to."""
        return any(one.sensor is sensor for one in self.exclusions)

    def variance(self, t_ns: int) -> float:
        """What all doubts add at a time, ns, to the variance of the yaw, rad^2."""
        return sum(doubt.variance(t_ns) for doubt in self.doubts)

    @property
    def contradicting(self) -> frozenset[Sensor]:
        """Who is excluded or in doubt."""
        return frozenset([one.sensor for one in self.exclusions] + [one.sensor for one in self.doubts])

    @property
    def contradicted(self) -> bool:
        """Whether gyro or compass are excluded or in doubt."""
        return bool(self.contradicting - {Sensor.TRACKS})

    def doubt(self, sensor: Sensor) -> Doubt | None:
        """What a sensor claims that may be right although it is not followed."""
        return next((one for one in self.doubts if one.sensor is sensor), None)

    def trusted(self, sensor: Sensor, window: Window) -> Claim | None:
        """What a sensor says of a window; None where it is excluded, too."""
        return None if self.excludes(sensor) else window.claim(sensor)

    def reference(self, sensor: Sensor, window: Window) -> Claim | None:
        """The best of what the others say of a window."""
        claims = (self.trusted(other, window) for other in BEST_FIRST if other is not sensor)
        return next((claim for claim in claims if claim), None)

    def following(self, sensor: Sensor, window: Window) -> Remedy:
        """Have the filter's yaw go on as a sensor says, in this window and in the last one."""
        joined = [one for one in (self.last, window) if one and (one is window or one.t_ns == window.start_ns)]
        told = [(one, claim) for one in joined if (claim := one.claim(sensor))]
        if not told:
            return Remedy()
        shift = told[0][0].corrected + sum(claim.turn - one.followed for one, claim in told)
        return Remedy(shift, sum(claim.sigma**2 for _, claim in told))

    def needed(self, sensor: Sensor) -> int:
        """In how many telling windows in a row an excluded sensor must agree to be trusted again."""
        if sensor is Sensor.GYRO and sum(window.gyro_beyond for window in self.evidence) >= NO_SPIKES:
            return NEVER  # it gives other units, and will not stop to
        strikes = self.strikes[list(Sensor).index(sensor)]
        return 1 << max(strikes - 1, 0)

    def excluding(self, sensor: Sensor, window: Window, turn: float, size: float) -> Isolation:
        """With a sensor excluded that in this window was off by `size` from the others' `turn`, rad."""
        rate = turn / window.seconds
        fitted = rate if _fits_anything(sensor, rate, window) else None
        least = abs(rate), abs(size) / window.seconds, abs(window.rate_change)
        one = Exclusion(sensor, window.start_ns, *least, fitted=fitted)
        counts = zip(self.strikes, Sensor, strict=True)
        strikes = tuple(min(count + (other is sensor), MOST_STRIKES) for count, other in counts)
        return replace(self, exclusions=(*self.trusting(sensor).exclusions, one), strikes=strikes)

    def trusting(self, sensor: Sensor) -> Isolation:
        """With a sensor that is excluded no more."""
        return replace(self, exclusions=tuple(one for one in self.exclusions if one.sensor is not sensor))

    def with_exclusion(self, changed: Exclusion) -> Isolation:
        """With what is known of an excluded sensor."""
        kept = (changed if one.sensor is changed.sensor else one for one in self.exclusions)
        return replace(self, exclusions=tuple(kept))

    def doubting(self, doubt: Doubt) -> Isolation:
        """With this doubt, instead of an earlier one of its sensor."""
        return replace(self, doubts=(*self.sure_of(doubt.sensor).doubts, doubt))

    def sure_of(self, sensor: Sensor) -> Isolation:
        """With no doubt left about a sensor."""
        return replace(self, doubts=tuple(one for one in self.doubts if one.sensor is not sensor))

    def noting(self, window: Window) -> Isolation:
        """With a window that shows a contradiction."""
        return self if window in self.evidence else replace(self, evidence=(*self.evidence, window)[-EVIDENCE:])
