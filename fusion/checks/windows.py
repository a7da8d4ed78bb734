"""What each sensor says of the same turn, window by window.

A window ends at an image half a second or more after it began; without images, at a sample of the track odometry. All
turns are changes of heading in rad, to the left, and hold from the stamp of the window's beginning to that of its end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from compass import YawIncrement, wrap_angle
from fusion.buffer.events import Sensor
from fusion.checks.silence import SILENT_NS
from fusion.checks.stillness import CompassTurn
from fusion.record import record, replace
from fusion.samples import GyroSample, OdometrySample

WINDOW_NS = 500_000_000  # not derived
# Not derived: `LONGEST_WINDOW_NS`, `LONGEST_GAP`, `BEYOND`, `SAME_NUMBER`.
LONGEST_WINDOW_NS = 5_000_000_000  # a sensor's integral over longer says more of its noise than of the turn

LONGEST_GAP = 0.4  # of a window, in which an integrated sensor may have been silent and still be a witness
FASTEST_ROBOT = 4.0 * math.pi  # rad/s; two turns a second, faster than tracked robots spin
FASTEST_CHANGE = FASTEST_ROBOT / 0.25  # rad/s^2: at its fastest in a quarter of a second; not derived
COMES_BACK = 0.5  # of a spike is enough to be back, as the robot may turn meanwhile; not derived
BEYOND = 4  # one sample in so many of a window beyond that is no spike
SAME = 1e-6  # rad/s; less than any gyro's least step, more than one number varies when it is levelled
SAME_NUMBER = 10  # samples in a row that are one number: no gyro that works does that


@record
class RateTurn:
    """Integral (rad) of a turn rate since `start_ns`, as the sensor gives it.

    Spikes are left out: samples that no robot can have turned to since the last `steady` one, nor back from them.

    Attributes
    ----------
    start_ns, t_ns : int
        Of the integral and of the newest sample, ns.
    start_rate, rate : float
        At these, rad/s.
    turn : float
        By the trapezoidal rule up to `t_ns`, rad.
    distance : float
        Driven meanwhile as the odometry claims, m.
    unseen : float
        Variance of the turn, rad^2, as nobody saw when the rate changed between two samples: at once, but at any time.
    gap_ns : int
        Longest time between two samples.
    count, repeats, beyond : int
        How many samples; how many at the end were the same number; how many were beyond `FASTEST_ROBOT`.
    steady_ns, steady_rate, steady_turn : int, float, float
        Stamp, rate and integral at the last sample that was no spike.
    spike : float
        By how much the rate has gone off since, at most, rad/s.
    yaw : float or None
        Of the newest sample, rad, where its poses are followed: a driver's rates may lag.
    """

    start_ns: int
    t_ns: int
    start_rate: float
    rate: float
    turn: float = 0.0
    distance: float = 0.0
    unseen: float = 0.0
    gap_ns: int = 0
    count: int = 0
    repeats: int = 0
    beyond: int = 0
    steady_ns: int = 0
    steady_rate: float = 0.0
    steady_turn: float = 0.0
    spike: float = 0.0
    yaw: float | None = None

    @staticmethod
    def begun(t_ns: int, rate: float, yaw: float | None = None, repeats: int = 0) -> RateTurn:
        """From `t_ns` on, with the rate that is held since."""
        return RateTurn(t_ns, t_ns, rate, rate, repeats=repeats, steady_ns=t_ns, steady_rate=rate, yaw=yaw)

    def add(self, t_ns: int, rate: float, speed: float = 0.0, yaw: float | None = None) -> RateTurn:
        """With one more sample (rad/s, m/s, rad)."""
        dt_ns = t_ns - self.t_ns
        seconds = dt_ns * 1e-9
        if yaw is not None and self.yaw is not None and dt_ns > 0:
            step = float(wrap_angle(yaw - self.yaw))
            rate, turn = step / seconds, self.turn + step
        else:
            turn = self.turn + 0.5 * (self.rate + rate) * seconds
        spike, off, within = self.spike, abs(rate - self.steady_rate), (t_ns - self.steady_ns) * 1e-9
        if off > FASTEST_CHANGE * within:
            steady, spike = (self.steady_ns, self.steady_rate, self.steady_turn), max(spike, off)
        else:
            if off < COMES_BACK * spike:
                turn = self.steady_turn + 0.5 * (self.steady_rate + rate) * within
            steady, spike = (t_ns, rate, turn), 0.0
        return RateTurn(
            self.start_ns,
            t_ns,
            self.start_rate,
            rate,
            turn,
            self.distance + abs(speed) * seconds,
            self.unseen + ((rate - self.rate) * seconds) ** 2 / 12.0,
            max(self.gap_ns, dt_ns),
            self.count + 1,
            self.repeats + 1 if abs(rate - self.rate) <= SAME else 0,
            self.beyond + (abs(rate) > FASTEST_ROBOT),
            *steady,
            spike,
            yaw,
        )

    def anew(self, t_ns: int) -> RateTurn:
        """From `t_ns` on; the last rate is held until then."""
        rate = self.steady_rate if self.spike else self.rate
        yaw = None if self.yaw is None else self.yaw + rate * (t_ns - self.t_ns) * 1e-9
        return RateTurn.begun(t_ns, rate, yaw, self.repeats)

    def turn_until(self, t_ns: int) -> float:
        """Turn up to a time after the newest sample, whose rate is held."""
        return self.turn + self.rate * (t_ns - self.t_ns) * 1e-9

    def spans(self, start_ns: int, t_ns: int) -> bool:
        """Whether there were samples all the way from the beginning of a window to its end."""
        longest_ns = LONGEST_GAP * (t_ns - start_ns)
        return self.start_ns <= start_ns and self.count > 0 and max(self.gap_ns, t_ns - self.t_ns) <= longest_ns


@dataclass(frozen=True, slots=True)
class Start:
    """What the filter knew at the beginning of a window.

    Attributes
    ----------
    yaw, rate : float
        rad, rad/s.
    bias, bias_sigma : float
        Of the gyro, rad/s.
    gyro_scale, gyro_scale_sigma : float
        Excess of the gyro's scale factor over one.
    scale, scale_sigma : float
        Of the tracks.
    delay, delay_sigma : float
        Of the camera, s.
    lag, lag_rate : float
        Turn from the exposure to the stamp of an image of then, rad, and by how much it grows with the delay, rad/s.
    doubt : float
        What the yaw owed to one sensor only, rad^2.
    standing : bool
        Whether the robot stood.
    """

    yaw: float = 0.0
    rate: float = 0.0
    bias: float = 0.0
    bias_sigma: float = 0.0
    gyro_scale: float = 0.0
    gyro_scale_sigma: float = 0.0
    scale: float = 1.0
    scale_sigma: float = 0.0
    delay: float = 0.0
    delay_sigma: float = 0.0
    lag: float = field(default=0.0, kw_only=True)
    lag_rate: float = field(default=0.0, kw_only=True)
    doubt: float = field(default=0.0, kw_only=True)
    standing: bool = field(default=False, kw_only=True)


@record
class Turns:
    """The present window as far as it has come.

    Attributes
    ----------
    start_ns : int or None
        When it began; None before the first sample.
    start, earlier : Start
        What the filter knew then, and at the beginning of the window before.
    gyro, tracks : RateTurn or None
    compass : CompassTurn or None
        None before the first increment, or while nothing joins the last one.
    compass_ns : int or None
        When the compass last spoke.
    corrected : float
        By how much the image at its beginning moved the yaw, rad.
    earlier_corrected : float
        By how much all its images have moved the yaw of before, rad: that is no turn.
    """

    start_ns: int | None = None
    start: Start = field(default_factory=Start)
    earlier: Start = field(default_factory=Start)
    gyro: RateTurn | None = None
    tracks: RateTurn | None = None
    compass: CompassTurn | None = None
    compass_ns: int | None = None
    corrected: float = 0.0
    earlier_corrected: float = 0.0

    def with_gyro(self, sample: GyroSample) -> Turns:
        """After a gyro sample."""
        t_ns, rate = sample.t_ns, sample.yaw_rate
        gyro = self.gyro.add(t_ns, rate) if self.gyro else RateTurn.begun(t_ns, rate)
        # at every sample, and `replace` takes twice as long
        return Turns(
            self.start_ns,
            self.start,
            self.earlier,
            gyro,
            self.tracks,
            self.compass,
            self.compass_ns,
            self.corrected,
            self.earlier_corrected,
        )

    def with_tracks(self, sample: OdometrySample, *, by_poses: bool) -> Turns:
        """After an odometry sample; `by_poses`: where it has a yaw, that counts, and not its rate."""
        t_ns, rate, yaw = sample.t_ns, sample.yaw_rate, sample.yaw if by_poses else None
        tracks = self.tracks.add(t_ns, rate, sample.speed, yaw) if self.tracks else RateTurn.begun(t_ns, rate, yaw)
        return replace(self, tracks=tracks)

    def with_increment(self, increment: YawIncrement) -> Turns:
        """After a yaw increment between stamps."""
        compass = self.compass.add(increment) if self.compass else CompassTurn.begin(increment)
        return replace(self, compass=compass, compass_ns=increment.t_ns)

    def anew(self, t_ns: int, start: Start, increment: YawIncrement | None) -> Turns:
        """The next window, which begins at the stamp `t_ns`; `increment`: that of the image it begins at, if any."""
        gyro, tracks = (turn.anew(t_ns) if turn else None for turn in (self.gyro, self.tracks))
        compass = CompassTurn.begin(increment) if increment else None
        return Turns(
            t_ns, start, self.start if self.start_ns is not None else start, gyro, tracks, compass, self.compass_ns
        )

    def with_correction(self, earlier: float) -> Turns:
        """After an image that has moved the yaw of the one it is compared with by `earlier`, rad."""
        return replace(self, earlier_corrected=self.earlier_corrected + earlier) if earlier else self

    def ends_at_image(self) -> bool:
        """Whether the newest increment ends the window, or begins one because nothing joins it to the last."""
        compass = self.compass
        return compass is not None and not 0 < compass.t_ns - compass.start_ns < WINDOW_NS

    def ends_at_odometry(self, t_ns: int) -> bool:
        """Whether an odometry sample of this stamp ends the window, as no image does."""
        if self.start_ns is None:
            return True
        silent = self.compass_ns is None or t_ns - self.compass_ns > SILENT_NS
        return silent and t_ns - self.start_ns >= WINDOW_NS


@dataclass(frozen=True, slots=True)
class Claim:
    """What one sensor says of a window, its calibration taken out.

    Attributes
    ----------
    turn, noise : float
        Turn and its standard deviation, rad, but for the error of a scale factor.
    scale : float
        Standard deviation of its scale factor, as a fraction.
    at_worst : float
        Noise that it may have nevertheless, rad, where `noise` is what the gate let pass lately.
    begin, end : float
        What of the noise's variance, rad^2, is in the window before, or in the next one, too, with the opposite sign:
        the error of the image between them, or of the gyro's rate held until then.
    rests : bool
        Whether tracks say that the robot neither turned nor drove.
    """

    turn: float
    noise: float
    scale: float = 0.0
    at_worst: float = 0.0
    begin: float = 0.0
    end: float = 0.0
    rests: bool = False

    def plus(self, later: Claim | None) -> Claim | None:
        """Of this window and the next one together."""
        if later is None:
            return None
        variance = max(self.noise**2 - self.end, 0.0) + max(later.noise**2 - later.begin, 0.0)
        worst = math.hypot(self.at_worst, later.at_worst)
        turn, scale = self.turn + later.turn, max(self.scale, later.scale)
        return Claim(turn, math.sqrt(variance), scale, worst, self.begin, later.end, self.rests and later.rests)

    @property
    def sigma(self) -> float:
        """Standard deviation of the turn, rad."""
        return math.hypot(self.noise, self.scale * self.turn)


@dataclass(frozen=True, slots=True)
class Window:
    """A window that is over.

    Attributes
    ----------
    start_ns, t_ns : int
        Its stamps.
    gyro, tracks, compass : Claim or None
        None where the sensor did not measure all of it.
    followed, corrected : float
        By how much the filter's yaw went on, rad, and how much of that the image at its beginning did.
    earlier_corrected : float
        How much of that is no turn, rad: images moved the yaw of before as well.
    gyro_repeats : bool
        Whether the gyro gave one and the same number all the time.
    gyro_hangs : bool
        Whether it did so, and never for nearly as long before.
    gyro_beyond : bool
        Whether it turned faster than robots do, and not for a sample only.
    tracks_spoke : bool
        Whether the odometry has ever said anything but zero.
    rate_change : float
        Of the turn rate between its ends, rad/s, as the filter has it.
    bias_sigma : float
        Standard deviation of the gyro bias at its beginning, rad/s.
    stood : bool
        Whether the robot stood at both ends.
    part : bool
        Whether the images say that they do not show the full circle once: then the compass turns by a wrong factor.
    """

    start_ns: int
    t_ns: int
    gyro: Claim | None
    tracks: Claim | None
    compass: Claim | None
    followed: float
    gyro_repeats: bool = False
    tracks_spoke: bool = True
    rate_change: float = 0.0
    gyro_beyond: bool = False
    corrected: float = 0.0
    bias_sigma: float = 0.0
    stood: bool = False
    part: bool = False
    gyro_hangs: bool = False
    earlier_corrected: float = 0.0

    def plus(self, later: Window) -> Window:
        """This window and the next one as one."""
        gyro, tracks, compass = (one and one.plus(other) for one, other in zip(self.claims, later.claims, strict=True))
        return Window(
            self.start_ns,
            later.t_ns,
            gyro,
            tracks,
            compass,
            self.followed + later.followed,
            self.gyro_repeats and later.gyro_repeats,
            later.tracks_spoke,
            self.rate_change + later.rate_change,
            self.gyro_beyond or later.gyro_beyond,
            self.corrected,
            self.bias_sigma,
            self.stood and later.stood,
            self.part or later.part,
            self.gyro_hangs and later.gyro_hangs,
            self.earlier_corrected + later.earlier_corrected,
        )

    @property
    def claims(self) -> tuple[Claim | None, ...]:
        """In the order of `Sensor`."""
        return self.gyro, self.tracks, self.compass

    @property
    def seconds(self) -> float:
        """Its length, s."""
        return (self.t_ns - self.start_ns) * 1e-9

    def claim(self, sensor: Sensor) -> Claim | None:
        """What a sensor says of it."""
        return dict(zip(Sensor, self.claims, strict=True))[sensor]
