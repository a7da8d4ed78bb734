"""What of the yaw's turn since two sensors last agreed only one of them has measured.

A fault shows in the next image or at the end of the next window of turns. Until then the yaw follows the sensor that
errs, and the filter's covariance does not grow, as the filter takes the gyro to be right. So the published variance
also holds what is *unconfirmed*: by how much the yaw has turned, since two sensors last agreed, beyond

- what the tracks claim, which confirm or contradict a gyro at every sample; without tracks,
- what the turn rate that was agreed on comes to: that a robot turns on as before needs no confirmation.

Differences as small as the steps of an encoder do not count.

Where an image was refused and no tracks speak, one of two sensors errs, and the turn rate is taken to be unknown; the
same where the gyro repeats one number.
"""

from __future__ import annotations

import math

from compass import wrap_angle
from fusion.buffer.events import Sensor
from fusion.checks.alternative import ALTERNATIVE_PROBABILITY
from fusion.checks.contradiction import CONTRADICTION_SIGMAS
from fusion.checks.rate_turn import FASTEST_ROBOT
from fusion.checks.silence import PERIODS, RATE_SILENT_NS, SILENT_NS
from fusion.checks.windows import Window
from fusion.record import record, replace
from fusion.samples import OdometrySample

ALIKE = 0.2  # of a turn; two sensors that differ by less agree; not derived
ALIKE_TURN = 1e-3  # rad; the same, as encoders have steps
WELL_WITHIN = 0.5  # standard deviations; what each agreement leaves out adds up over many of them; not derived
HIDES = 0.5  # of a turn; a sensor that differs by more may not have seen it; not derived
SLIP = 1.0  # standard deviations by which tracks may slip beside images, which are more exact
# Share of the squared unconfirmed turn where no third sensor speaks: a reversed sign errs by twice that turn, which
# stays within three sigmas.
REVERSED = (2.0 / 3.0) ** 2


@record
class Belief:
    """What the filter believes.

    Attributes
    ----------
    t_ns : int
        Stamp, ns.
    yaw, rate : float
        rad, rad/s.
    scale, scale_sigma : float
        Of the tracks.
    yaw_by_scale : float
        By how much the yaw would be another if that scale were, rad: tracks have turned it alone.
    """

    t_ns: int
    yaw: float
    rate: float
    scale: float
    scale_sigma: float
    yaw_by_scale: float = 0.0

    def turned(self, since: Belief) -> float:
        """Turn since then, rad: that the scale learnt meanwhile moves the yaw of then is none."""
        return self.yaw - since.yaw - since.yaw_by_scale * (self.scale - since.scale)


@record
class TracksSince:
    """What the tracks claim since a time, by their poses where they have any: a driver's twist lags.

    Attributes
    ----------
    last : OdometrySample
        The newest.
    turn : float
        Claimed until then, rad.
    """

    last: OdometrySample
    turn: float

    @staticmethod
    def begin(last: OdometrySample, t_ns: int) -> TracksSince:
        """From a time on, ns, after the newest sample, whose rate is held until then."""
        return TracksSince(last, -last.yaw_rate * (t_ns - last.t_ns) * 1e-9)

    def add(self, sample: OdometrySample) -> TracksSince:
        """With one more sample; a pose that jumped as no robot turns, by a reset or of another, says nothing."""
        seconds, by_poses = (sample.t_ns - self.last.t_ns) * 1e-9, math.inf
        if self.last.yaw is not None and sample.yaw is not None:
            by_poses = float(wrap_angle(sample.yaw - self.last.yaw))
        believed = abs(by_poses) <= FASTEST_ROBOT * seconds
        return TracksSince(sample, self.turn + (by_poses if believed else sample.yaw_rate * seconds))

    def turn_until(self, t_ns: int) -> float:
        """Up to a time, ns, after the newest sample, whose rate is held."""
        return self.turn + self.last.yaw_rate * (t_ns - self.last.t_ns) * 1e-9


@record
class Unconfirmed:
    """Since the last time that two sensors agreed.

    Attributes
    ----------
    since : Belief
        What was believed then.
    rate_sigma : float
        Of a turn rate that nobody measures, rad/s.
    tracks : TracksSince or None
        What the tracks have claimed since; None where they do not speak.
    blind_ns : int or None
        Since when no sensor but the tracks is believed to measure the turn rate: an image was refused, or the gyro
        repeats one number, or it is excluded and the robot only seems to stand.
    image_ns : int or None
        When the last image came, whatever it said.
    pace_ns : int
        From the last but one to it.
    noise : float
        Variance of what the tracks claim since, rad^2, but for their scale.
    seen : Belief or None
        What was believed at the last image that passed the gate.
    by_tracks : float
        By how much the tracks alone have reduced the yaw's variance since that image, plus the squared shift that they
        have given to the yaw, rad^2.
    held : float
        The largest unconfirmed variance beside the tracks at the end of any window since, rad^2. The difference to the
        tracks, whose scale factor is not known, may vanish for a moment while a robot turns to and fro.
    beginning : bool
        Whether no two sensors have agreed yet: since the start, at which a robot is taken to stand.
    left : float
        Unconfirmed variance from before `since`, rad^2: an image confirms the yaw to within its own error only.
    """

    since: Belief
    rate_sigma: float
    tracks: TracksSince | None = None
    blind_ns: int | None = None
    image_ns: int | None = None
    pace_ns: int = SILENT_NS
    noise: float = 0.0
    seen: Belief | None = None
    by_tracks: float = 0.0
    held: float = 0.0
    beginning: bool = False
    left: float = 0.0

    def is_alone(self, t_ns: int) -> bool:
        """Whether so much time has passed since the start that whoever speaks is the only one."""
        return self.beginning and t_ns - self.since.t_ns > SILENT_NS

    def with_tracks(self, sample: OdometrySample) -> Unconfirmed:
        """After an odometry sample; after a pause nobody knows what they would have claimed in it."""
        if self.beginning and self.tracks is None and sample.t_ns - self.since.t_ns <= RATE_SILENT_NS:
            return replace(self, tracks=TracksSince.begin(sample, self.since.t_ns))
        if self.tracks is None or sample.t_ns - self.tracks.last.t_ns > RATE_SILENT_NS:
            return replace(self, tracks=None)
        return replace(self, tracks=self.tracks.add(sample))

    def with_image(self, now: Belief, *, accepted: bool) -> Unconfirmed:
        """After an image, whatever it says."""
        pace_ns = SILENT_NS if self.image_ns is None else min(now.t_ns - self.image_ns, SILENT_NS)
        pace_ns = self.pace_ns if now.t_ns == self.image_ns else pace_ns
        if not accepted:
            return replace(self, image_ns=now.t_ns, pace_ns=pace_ns)
        return replace(self, image_ns=now.t_ns, pace_ns=pace_ns, seen=now, by_tracks=0.0)

    def told_by_tracks(self, variance: float) -> Unconfirmed:
        """After tracks that nobody confirms before the next image; `variance` as in `by_tracks`."""
        return replace(self, by_tracks=self.by_tracks + max(variance, 0.0))

    def with_window(self, window: Window | None, now: Belief, *, images: bool) -> Unconfirmed:
        """After a window of turns; `images` as in `variance`."""
        if window is None or window.tracks is None:
            return self
        known = replace(self, noise=self.noise + window.tracks.noise**2)
        if images or not self._witnessed(now):
            return known
        return replace(known, held=known._beside_tracks(now, images=images))

    def confirmed_by(self, innovation: float, variance: float, now: Belief) -> bool:
        """Whether an image that passed the gate says the same, by its innovation and variance, rad and rad^2.

        Not every one does: a camera's delay that is not known yet explains much at small rates.
        """
        known = self.beginning or now.t_ns - self.since.t_ns <= SILENT_NS
        turned = now.turned(self.since)
        return not known or innovation**2 <= CONTRADICTION_SIGMAS**2 * variance + (ALIKE * turned) ** 2

    def agrees(self, now: Belief) -> bool:
        """Whether the tracks say the same since then, well within noise that hides no turn."""
        if self.tracks is None:
            return True
        beyond = self._beyond(now, now)
        hidden = HIDES * max(abs(now.turned(self.since)), abs(self.tracks.turn_until(now.t_ns) / now.scale))
        if abs(beyond) > max(hidden, ALIKE_TURN):
            return False
        return beyond**2 <= WELL_WITHIN**2 * (self.noise + self._by_scale(now, now))

    def contradiction(self, now: Belief) -> float | None:
        """By how much the yaw has turned more than the tracks say, rad, where that cannot be their noise."""
        beyond = self._beyond(now, now)
        if self.tracks is None or not self._witnessed(now):
            return None
        noise = self.noise + self._by_scale(now, now) + ALIKE_TURN**2
        return beyond if beyond**2 > CONTRADICTION_SIGMAS**2 * noise else None

    def refutes(self, off: float, noise: float, now: Belief) -> bool:
        """Whether the tracks say that the robot has turned since then as believed, not by `off`, rad, more or less.

        Whatever their noise since then, of which `noise`, rad^2, is not counted yet.
        """
        if not self._witnessed(now):
            return False
        sigma = math.sqrt(self.noise + noise + self._by_scale(now, now) + ALIKE_TURN**2)
        return abs(self._beyond(now, now)) + CONTRADICTION_SIGMAS * sigma <= HIDES * abs(off)

    def _beyond(self, now: Belief, scaled: Belief) -> float:
        """By how much the yaw has turned since then more than the tracks say, rad, at the scale of `scaled`."""
        claimed = self.tracks.turn_until(now.t_ns) / scaled.scale if self.tracks else 0.0
        return now.turned(self.since) - claimed

    def _by_scale(self, now: Belief, scaled: Belief) -> float:
        """Variance that this scale gives to what the tracks claim since then, rad^2."""
        claimed = self.tracks.turn_until(now.t_ns) if self.tracks else 0.0
        return (scaled.scale_sigma * claimed / scaled.scale**2) ** 2

    def blind(self, t_ns: int) -> Unconfirmed:
        """From a time on, ns, at which it shows that nobody can be believed to measure the turn rate."""
        return self if self.blind_ns is not None else replace(self, blind_ns=t_ns)

    def _witnessed(self, now: Belief) -> bool:
        return self.tracks is not None and now.t_ns - self.tracks.last.t_ns <= RATE_SILENT_NS

    def variance(self, now: Belief, *, images: bool) -> float:
        """What it adds to that of the yaw, rad^2; `images`: no gyro, but images measure the turn, and tracks slip."""
        return self.left + self._since(now, images=images)

    def _since(self, now: Belief, *, images: bool) -> float:
        if self._witnessed(now):
            turned = self._beyond_rate(self.seen, now) if images and self.seen else 0.0
            return self._beside_tracks(now, images=images) + turned
        last_ns = self.since.t_ns if self.image_ns is None else self.image_ns
        if self.blind_ns is None and now.t_ns - last_ns > PERIODS * self.pace_ns:
            return 0.0  # the camera has stopped, and the other sensor is alone, not unconfirmed
        unseen_ns = 0 if self.blind_ns is None else min(now.t_ns - self.blind_ns, SILENT_NS)
        return (
            self._beyond_rate(self.since, now)
            + ALTERNATIVE_PROBABILITY[Sensor.GYRO] * (self.rate_sigma * unseen_ns * 1e-9) ** 2
        )

    def _beside_tracks(self, now: Belief, *, images: bool) -> float:
        """What the yaw has gone on by beyond what the tracks say, rad^2."""
        # at the scale of both times: the present one was learnt from who is in doubt
        slip = SLIP**2 * self.noise if images else 0.0
        beyond = max(
            self._beyond(now, scaled) ** 2 - ALIKE_TURN**2 - self._by_scale(now, scaled) for scaled in (self.since, now)
        )
        return max(ALTERNATIVE_PROBABILITY[Sensor.GYRO] * (beyond - slip), self.held)

    @staticmethod
    def _beyond_rate(since: Belief, now: Belief) -> float:
        """What the yaw has gone on by since a time beyond the turn rate of then, rad^2."""
        beyond = now.turned(since) - since.rate * (now.t_ns - since.t_ns) * 1e-9
        return REVERSED * max(beyond**2 - ALIKE_TURN**2, 0.0)
