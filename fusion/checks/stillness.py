"""Standstill, found from all sensors together.

Each sensor is watched since the last sign of motion. The robot is taken to stand once none of those that speak shows
any, and the tracks or the compass could by now have seen a turn as slow as `RESOLUTION`: to the gyro alone a slow turn
looks like its bias. One sign of motion from one sensor ends it. Detectors of one inertial unit are compared by Skog
et al. 2010, doi:10.1109/TBME.2010.2060723.
"""

from __future__ import annotations

import math
from dataclasses import field

from compass import YawIncrement, wrap_angle
from fusion.checks.silence import SILENT_NS
from fusion.record import record, replace
from fusion.samples import OdometrySample

# Not derived: `RESOLUTION`, `SHORTEST_STANDSTILL_NS`, `DYING_NS`, `UNKNOWN_TRACK_NOISE`, `RESTING`, `RECENT`,
# `BLIND`, `MOTION_SIGMAS`.
RESOLUTION = 0.0005  # rad/s; slower turns are left to the filter, which goes on estimating the rate
SHORTEST_STANDSTILL_NS = 500_000_000  # of quiet before it is called standstill
DYING_NS = 100_000_000  # in which the rest of a motion dies away after its last sign
UNKNOWN_TRACK_NOISE = 0.02  # rad/s; noise to expect of resting tracks until it is known
CREEP_RATE = 0.001  # rad/s; a robot that turns by less is taken to stand; not derived
CREEP = 0.01  # m/s; slower is not driving; not derived
RESTING = 20  # samples without a sign of motion that their scatter is estimated from
RECENT = 25  # gyro samples in its recent mean, for turns too slow to show in one sample
BLIND = 0.02  # rad; an increment with a larger standard deviation misses how a robot starts to turn
MOTION_SIGMAS = 4.0  # standard deviations that make a sign of motion


@record
class Running:
    """Mean and scatter of a series, one value at a time (Welford 1962, doi:10.1080/00401706.1962.10490022)."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def add(self, value: float) -> Running:
        """With one more value."""
        count = self.count + 1
        step = value - self.mean
        mean = self.mean + step / count
        return Running(count, mean, self.squares + step * (value - mean))

    @property
    def sigma(self) -> float:
        """Standard deviation of the values; 0 for fewer than two."""
        return math.sqrt(self.squares / (self.count - 1)) if self.count > 1 else 0.0

    @property
    def mean_sigma(self) -> float:
        """Standard deviation of the mean; infinite for fewer than five values, too few for a scatter."""
        return self.sigma / math.sqrt(self.count) if self.count > 4 else math.inf


@record
class CompassTurn:
    """Turn (rad) the compass has seen since `start_ns`: an increment less `offset`, whose variance is `variance`.

    `first` and `last` are the variances of the increments at its start and at its end.
    """

    start_ns: int
    t_ns: int
    reference_ns: int
    offset: float
    variance: float
    turn: float
    turn_variance: float
    first: float
    last: float

    @staticmethod
    def begin(increment: YawIncrement) -> CompassTurn:
        """Count from the increment's image on."""
        i = increment
        return CompassTurn(i.t_ns, i.t_ns, i.t_ref_ns, i.yaw, i.variance, 0.0, 2.0 * i.variance, i.variance, i.variance)

    def add(self, increment: YawIncrement) -> CompassTurn:
        """With the next increment; counts from it anew if its reference cannot be joined to what went before."""
        i = increment
        offset, variance = self.offset, self.variance
        if i.t_ref_ns == self.t_ns:
            offset, variance = -self.turn, self.turn_variance
        elif i.t_ref_ns != self.reference_ns:
            return CompassTurn.begin(i)
        turn = self.turn + float(wrap_angle(i.yaw - offset - self.turn))
        total = variance + i.variance
        return CompassTurn(self.start_ns, i.t_ns, i.t_ref_ns, offset, variance, turn, total, self.first, i.variance)

    @property
    def quiet(self) -> bool:
        """Whether it could be no turn at all."""
        return abs(self.turn) <= MOTION_SIGMAS * math.sqrt(self.turn_variance)

    @property
    def resolution(self) -> float:
        """Standard deviation of the mean rate since the start, rad/s."""
        seconds = (self.t_ns - self.start_ns) * 1e-9
        return math.sqrt(self.turn_variance) / seconds if seconds > 0.0 else math.inf


@record
class Stillness:
    """What each sensor has shown since the last sign of motion at `since_ns`, and whether that is standstill.

    `since_ns` is 0 before the first. `reference_ns` is when all motion had died away; None before.
    """

    since_ns: int
    reference_ns: int | None = None
    standing: bool = False
    gyro_ns: int | None = None
    gyro_sigma: float = 0.0
    gyro: Running = field(default_factory=Running)
    gyro_lately: float = 0.0
    tracks_ns: int | None = None
    track_rate: Running = field(default_factory=Running)
    track_speed: Running = field(default_factory=Running)
    compass: CompassTurn | None = None

    def moved(self, t_ns: int) -> Stillness:
        """After a sign of motion."""
        return Stillness(t_ns)

    def hidden_start(self) -> tuple[float, float]:
        """What `RECENT` samples of a turn that their mean does not show make of bias (rad/s) and yaw (rad)."""
        if self.gyro_ns is None:
            return 0.0, 0.0
        rate, share = MOTION_SIGMAS * self.gyro_sigma * RECENT**-0.5, min(RECENT / self.gyro.count, 1.0)
        return rate * share, rate * share * (self.gyro_ns - self.since_ns) * 1e-9

    def gyro_noise(self, sigma: float) -> float:
        """Noise of a gyro sample, rad/s: its scatter since the last sign of motion, within half and once `sigma`."""
        return min(max(self.gyro.sigma, 0.5 * sigma), sigma) if self.gyro.count >= RESTING else sigma

    def with_gyro(self, t_ns: int, yaw_rate: float, sigma: float) -> Stillness:
        """After a gyro sample of noise `sigma` (rad/s)."""
        known, lately = self.gyro, self.gyro_lately
        if known.count > 4 and abs(yaw_rate - known.mean) > (MOTION_SIGMAS + 1.0) * sigma:
            return self.moved(t_ns)
        lately = lately + (yaw_rate - lately) / min(known.count + 1, RECENT)
        if known.count > 2 * RECENT and abs(lately - known.mean) > MOTION_SIGMAS * sigma * RECENT**-0.5:
            return self.moved(t_ns)
        # at every sample, and `replace` takes twice as long
        return Stillness(
            self.since_ns,
            self.reference_ns,
            self.standing,
            t_ns,
            sigma,
            known.add(yaw_rate),
            lately,
            self.tracks_ns,
            self.track_rate,
            self.track_speed,
            self.compass,
        )

    def with_tracks(self, sample: OdometrySample) -> Stillness:
        """After an odometry sample."""
        rate, speed = self.track_rate, self.track_speed
        rate_limit = MOTION_SIGMAS * (rate.sigma if rate.count > RESTING else UNKNOWN_TRACK_NOISE) + CREEP_RATE
        speed_limit = MOTION_SIGMAS * speed.sigma + CREEP
        if abs(sample.yaw_rate) > rate_limit or abs(sample.speed) > speed_limit:
            return self.moved(sample.t_ns)
        rate, speed = rate.add(sample.yaw_rate), speed.add(sample.speed)
        if rate.count > RESTING and not _creeping(rate):
            return self.moved(sample.t_ns)
        return replace(self, tracks_ns=sample.t_ns, track_rate=rate, track_speed=speed)

    def with_increment(self, increment: YawIncrement) -> Stillness:
        """After a yaw increment; one that sees next to nothing, as a copy of the image before, is no witness."""
        if increment.variance > BLIND**2:
            others = (t_ns for t_ns in (self.gyro_ns, self.tracks_ns) if t_ns is not None)
            watched = any(increment.t_ns - t_ns < SILENT_NS for t_ns in others)
            return self if watched else self.moved(increment.t_ns)
        compass = self.compass.add(increment) if self.compass else CompassTurn.begin(increment)
        if not compass.quiet:
            return self.moved(increment.t_ns)
        return replace(self, compass=compass)

    def judged(self, t_ns: int, bias: float, bias_sigma: float) -> Stillness:
        """Decide whether the robot stands at `t_ns`, with what is known of the gyro's bias (rad/s).

        Switched on, it stands: until the first sign of motion a bias larger than expected is likelier than a slow turn.
        """
        if self.reference_ns is None and t_ns - self.since_ns >= DYING_NS:
            return replace(self, reference_ns=t_ns)
        if self.standing or t_ns - self.since_ns < SHORTEST_STANDSTILL_NS:
            return self
        witness = False
        if self.tracks_ns is not None and t_ns - self.tracks_ns < SILENT_NS:
            witness = self.track_rate.mean_sigma <= RESOLUTION and _creeping(self.track_rate)
        if self.compass is not None and t_ns - self.compass.t_ns < SILENT_NS:
            seen = abs(self.compass.turn) <= 2.0 * math.sqrt(self.compass.turn_variance)
            witness = seen and self.compass.resolution <= RESOLUTION
            if not witness:
                return self
        if self.gyro_ns is not None and t_ns - self.gyro_ns < SILENT_NS:
            off, sigmas = abs(self.gyro.mean - bias), 3.0 if self.since_ns else MOTION_SIGMAS
            if self.gyro.sigma > 2.0 * self.gyro_sigma or off > sigmas * math.hypot(bias_sigma, 4.0 * RESOLUTION):
                return self
        if not witness:
            return self
        return replace(self, standing=True)


def _creeping(rate: Running) -> bool:
    """Whether the mean of the tracks' claimed rates could be no motion."""
    return abs(rate.mean) <= MOTION_SIGMAS * rate.mean_sigma + CREEP_RATE
