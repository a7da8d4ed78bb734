"""What each sensor says of the same turn, window by window.

A window ends at an image half a second or more after it began; without images, at a sample of the track odometry. All
turns are changes of heading in rad, to the left, and hold from the stamp of the window's beginning to that of its end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from compass import YawIncrement
from fusion.buffer.events import Sensor
from fusion.checks.rate_turn import RateTurn
from fusion.checks.silence import SILENT_NS
from fusion.checks.stillness import CompassTurn
from fusion.record import record, replace
from fusion.samples import GyroSample, OdometrySample

# Not derived: all four.
WINDOW_NS = 500_000_000
LONGEST_WINDOW_NS = 5_000_000_000  # a sensor's integral over longer says more of its noise than of the turn
BEYOND = 4  # one sample in so many of a window beyond that is no spike
SAME_NUMBER = 10  # samples in a row that are one number: no gyro that works does that


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
