"""Fault detection and isolation: who is excluded, what the alternatives are, and what evidence there is.

Sample by sample the gyro is by far the most precise, so a filter would believe it against all others; and a compass
that is steadily misled would in time be believed against a sound gyro. So over windows of half a second the sensors are
compared as turns (`fusion.checks.windows`, judged in `fusion.checks.isolation_rules`):

- Where two of three agree, the third is excluded. What the filter believed of it in that window is taken back.
- Where only two speak, or the third is too vague to decide, nobody can know who is right. One is followed, the other
  excluded, and that this one is right after all is the *alternative* hypothesis (`fusion.checks.alternative`): what it
  claims beyond the followed one, summed up, widens the published variance.
- What a third sensor has decided it may find otherwise later: the refuted alternative is kept as long as its
  sensor is excluded, and adds no variance.
- An excluded sensor is trusted again once it agrees where it would have been seen to err: in a window with at least
  half the turning of the least one in which it contradicted. Driving straight tells nothing of a wrong sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from fusion.buffer.events import FOREVER_NS, Sensor
from fusion.checks.alternative import Alternative, Third
from fusion.checks.contradiction import GROSS, limit
from fusion.checks.exclusion import Exclusion, fits_anything, may_give_degrees
from fusion.checks.recovery import Recovery
from fusion.checks.time_offset import EVERY_WINDOWS, TimeOffset, Turned, time_offset, with_window
from fusion.checks.windows import Claim, Window
from fusion.record import replace

MOST_STRIKES = 6  # exclusions that count: it takes 32 telling windows then, and no more after others; not derived
NEVER = 1_000_000_000  # windows; more than any drive has
NO_SPIKES = 3  # windows with turns that no robot makes are no spikes but another unit; not derived
EVIDENCE_WINDOWS = 20  # windows with a contradiction that are remembered, to name the fault; not derived
TELLING = 0.2  # of a turn; a gyro that errs by less is not wrong, but badly calibrated; not derived
BEST_FIRST = (Sensor.COMPASS, Sensor.GYRO, Sensor.TRACKS)


@dataclass(frozen=True, slots=True)
class Remedy:
    """What the filter has to do after a window.

    Attributes
    ----------
    shift, shift_variance : float
        To add to the yaw, rad, and to its variance, rad^2.
    bias, bias_sigma : float or None, float
        What the gyro's bias seems to be, and its standard deviation, rad/s, infinite where only that it is another is
        known; None where nothing changes.
    fold : float
        Variance by which the frame of all yaws is known less, rad^2.
    delay : float
        By how much more than thought the images seem to be stamped late, s.
    rate : float or None
        The turn rate that the robot has instead of what the gyro said, rad/s.
    since_ns : int
        Since when the yaws that are taken back are wrong.
    """

    shift: float = 0.0
    shift_variance: float = 0.0
    bias: float | None = None
    bias_sigma: float = math.inf
    fold: float = 0.0
    delay: float = 0.0
    rate: float | None = None
    since_ns: int = FOREVER_NS

    @staticmethod
    def of(remedies: Iterable[Remedy]) -> Remedy:
        """Several in one; of biases the last counts."""
        total = Remedy()
        for one in remedies:
            bias = (total.bias, total.bias_sigma) if one.bias is None else (one.bias, one.bias_sigma)
            shift = total.shift + one.shift, total.shift_variance + one.shift_variance
            rate = total.rate if one.rate is None else one.rate
            since_ns = min(total.since_ns, one.since_ns)
            total = Remedy(*shift, *bias, total.fold + one.fold, total.delay + one.delay, rate, since_ns)
        return total


@dataclass(frozen=True, slots=True)
class Isolation:
    """Who is excluded, and what the alternatives are.

    Attributes
    ----------
    exclusions : tuple of Exclusion
    alternatives : tuple of Alternative
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
    start : Window or None
        All windows since the robot was switched on as one, the gyro's bias not taken out; None once it has moved.
    moved : bool
        Whether it has, or may have.
    turned : tuple of Turned
        What each sensor turned by in the last windows without a gap.
    offset : TimeOffset or None
        Whose clock is off, as they tell.
    one_source : bool or None
        Whether the odometry takes its turns from the gyro: it is no third sensor; None: not known yet.
    """

    exclusions: tuple[Exclusion, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    evidence: tuple[Window, ...] = ()
    strikes: tuple[int, ...] = (0,) * len(Sensor)
    windows: int = 0
    last: Window | None = None
    long: Window | None = None
    start: Window | None = None
    moved: bool = False
    turned: tuple[Turned, ...] = ()
    offset: TimeOffset | None = None
    one_source: bool | None = False

    def with_turns(self, window: Window, bias: float) -> Isolation:
        """With what the sensors turned by in one more window, the gyro's bias (rad/s) not taken out."""
        turned, windows = with_window(self.turned, Turned.of(window, bias)), self.windows + 1
        offset = time_offset(turned) if windows % EVERY_WINDOWS == 0 else self.offset
        return replace(self, turned=turned, offset=offset, windows=windows)

    def excludes(self, sensor: Sensor) -> bool:
        """Whether a sensor is not listened to."""
        if self.one_source and sensor is Sensor.TRACKS:
            return True
        return bool(self.exclusions) and any(one.sensor is sensor for one in self.exclusions)

    def side(self, alternative: Alternative, window: Window) -> bool | None:
        """Whether a third sensor takes the side of an alternative.

        Not that of a gyro that seems to be its source, or that repeats one number, no turn, while the robot drives.
        """
        side, gyro, tracks = alternative.third.side, window.gyro, window.tracks
        still = gyro is not None and window.gyro_repeats and abs(gyro.turn) < GROSS * window.seconds
        doubted = self.one_source is None or (still and tracks is not None and not tracks.rests)
        return None if doubted and side is (alternative.sensor is Sensor.GYRO) else side

    def with_one_source(self, one_source: bool | None) -> Isolation:
        """With an odometry that turns by the gyro, or not any more; what was decided with its help is open again."""
        if one_source is False:
            return replace(self, one_source=False)
        alternatives = tuple(replace(one, refuted=False) for one in self.alternatives)
        iso = replace(self, one_source=one_source, alternatives=alternatives)
        if one_source:
            iso = iso.without_alternative(Sensor.TRACKS).trusting(Sensor.TRACKS)
            alternatives = tuple(replace(one, third=Third()) for one in iso.alternatives)
            iso = replace(iso, alternatives=alternatives, last=None, long=None)
        return iso

    def variance(self, t_ns: int) -> float:
        """What all alternatives add at a time, ns, to the variance of the yaw, rad^2."""
        return sum(alternative.variance(t_ns) for alternative in self.alternatives)

    @property
    def contradicting(self) -> frozenset[Sensor]:
        """Who is excluded, or the sensor of an alternative."""
        return frozenset([one.sensor for one in self.exclusions] + [one.sensor for one in self.alternatives])

    @property
    def contradicted(self) -> bool:
        """Whether gyro or compass are excluded, or the sensor of an alternative."""
        return bool(self.contradicting - {Sensor.TRACKS})

    @property
    def gyro_shown_right(self) -> bool:
        """Whether gyro and images agree on the turn of the last window, so large that no gyro that errs would."""
        if self.last is None or self.contradicted or self.last.gyro is None or self.last.compass is None:
            return False
        gyro, compass = self.last.gyro, self.last.compass
        return limit(gyro, compass, self.last.seconds) <= TELLING * abs(compass.turn)

    def alternative(self, sensor: Sensor) -> Alternative | None:
        """What a sensor claims that may be right although it is not followed."""
        found = self.hypothesis(sensor)
        return None if found is None or found.refuted else found

    def hypothesis(self, sensor: Sensor) -> Alternative | None:
        """What a sensor claims that is not followed, refuted or not."""
        return next((one for one in self.alternatives if one.sensor is sensor), None)

    @property
    def undecided(self) -> bool:
        """Whether there is an alternative that nobody has refuted."""
        return any(not one.refuted for one in self.alternatives)

    def trusted(self, sensor: Sensor, window: Window) -> Claim | None:
        """What a sensor says of a window; None where it is excluded, too."""
        return None if self.excludes(sensor) else window.claim(sensor)

    def reference(self, sensor: Sensor, window: Window) -> Claim | None:
        """The best of what the others say of a window."""
        claims = (self.trusted(other, window) for other in BEST_FIRST if other is not sensor)
        return next((claim for claim in claims if claim), None)

    def joined(self, window: Window) -> tuple[Window, ...]:
        """The last window, in which what shows in this one may have begun, and this one."""
        return (self.last, window) if self.last and self.last.t_ns == window.start_ns else (window,)

    def following(self, sensor: Sensor, window: Window) -> Remedy:
        """Have the filter's yaw go on as a sensor says, in this window and in the last one.

        What images have made of the yaw of before meanwhile is taken back, too; nobody knows whether that was right.
        """
        claims = [(one, claim) for one in self.joined(window) if (claim := one.claim(sensor))]
        if not claims:
            return Remedy()
        shift = claims[0][0].corrected + sum(claim.turn - one.followed for one, claim in claims)
        earlier = sum(one.earlier_corrected for one, _ in claims)
        return Remedy(shift, earlier**2 + sum(claim.sigma**2 for _, claim in claims), since_ns=claims[0][0].start_ns)

    def needed(self, sensor: Sensor) -> int:
        """In how many telling windows in a row an excluded sensor must agree to be trusted again."""
        if sensor is Sensor.GYRO and sum(window.gyro_beyond for window in self.evidence) >= NO_SPIKES:
            return NEVER  # it gives other units, and will not stop to
        strikes = self.strikes[list(Sensor).index(sensor)]
        return 1 << max(strikes - 1, 0)

    def excluding(self, sensor: Sensor, window: Window, turn: float, size: float) -> Isolation:
        """With a sensor excluded that in this window was off by `size` from the others' `turn`, rad."""
        rate = turn / window.seconds
        degrees = not self.moved and may_give_degrees(sensor, size, window)
        fitted = rate if degrees or fits_anything(sensor, rate, window) else None
        least = abs(rate), abs(size) / window.seconds, abs(window.rate_change)
        silent = sensor is Sensor.TRACKS and not window.tracks_spoke
        recovery = Recovery.begun(size / window.seconds)
        one = Exclusion(sensor, window.start_ns, *least, recovery, fitted=fitted, silent=silent)
        counts = zip(self.strikes, Sensor, strict=True)
        strikes = tuple(min(count + (other is sensor), MOST_STRIKES) for count, other in counts)
        return replace(self, exclusions=(*self.trusting(sensor).exclusions, one), strikes=strikes)

    def trusting(self, sensor: Sensor) -> Isolation:
        """With a sensor that is excluded no more; nor is it refuted."""
        kept = (one for one in self.alternatives if not (one.refuted and one.sensor is sensor))
        exclusions = tuple(one for one in self.exclusions if one.sensor is not sensor)
        return replace(self, exclusions=exclusions, alternatives=tuple(kept))

    def with_exclusion(self, changed: Exclusion) -> Isolation:
        """With what is known of an excluded sensor."""
        kept = (changed if one.sensor is changed.sensor else one for one in self.exclusions)
        return replace(self, exclusions=tuple(kept))

    def with_alternative(self, alternative: Alternative) -> Isolation:
        """With this alternative, instead of an earlier one of its sensor."""
        return replace(self, alternatives=(*self.without_alternative(alternative.sensor).alternatives, alternative))

    def without_alternative(self, sensor: Sensor) -> Isolation:
        """Without the alternative that a sensor is right: it is decided."""
        return replace(self, alternatives=tuple(one for one in self.alternatives if one.sensor is not sensor))

    def noting(self, window: Window) -> Isolation:
        """With a window that shows a contradiction."""
        return self if window in self.evidence else replace(self, evidence=(*self.evidence, window)[-EVIDENCE_WINDOWS:])


Judged = tuple[Isolation, Remedy]
