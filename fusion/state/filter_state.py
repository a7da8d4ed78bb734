"""All that the filter knows after an event, and whom of its sensors it hears."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from fusion.buffer.events import Sensor
from fusion.checks.alternative import ALTERNATIVE_PROBABILITY
from fusion.checks.common_source import CommonSource
from fusion.checks.early_images import EarlyImages
from fusion.checks.gate import Gate
from fusion.checks.isolation import Isolation
from fusion.checks.refusal import Refusal
from fusion.checks.scale_conflict import ScaleConflict
from fusion.checks.silence import RATE_SILENT_NS, SILENT_NS
from fusion.checks.stillness import Stillness
from fusion.checks.turn_count import TurnCount
from fusion.checks.unconfirmed import Belief, TracksSince, Unconfirmed
from fusion.checks.unwatched import Unwatched
from fusion.checks.warnings import Warning, most_serious_first
from fusion.checks.windows import SAME_NUMBER, Turns
from fusion.imu.tilt import BiasGain, TiltedTurn
from fusion.record import replace
from fusion.samples import OdometrySample
from fusion.state.bias_prior import BiasPrior
from fusion.state.bias_walk import BiasWalk
from fusion.state.clones import Clones
from fusion.state.ekf import Array, Correction, State, Transition, YawEkf
from fusion.state.gyro_noise import GyroNoise
from fusion.state.gyro_trail import GyroTrail
from fusion.state.learnt_noise import LearntNoise
from fusion.state.track_claim import OdometryFields, TrackClaim


@dataclass
class FilterState:
    """All that the filter knows after an event; its members are replaced, never changed.

    Attributes
    ----------
    ekf : YawEkf
        State and covariance, see `fusion.state.ekf.State`.
    t_ns : int or None
        Time they hold for, ns; None before the first event.
    clones : Clones
        The yaws it remembers.
    tracks : TrackClaim or None
        What the tracks claim since the state TRACK_REF was cloned.
    odometry_fields : OdometryFields
        What of the odometry has ever spoken.
    gates : dict of Sensor to Gate
        Gate and last report of each sensor.
    references_lost : int
        Increments whose reference the filter had never seen or forgotten.
    stillness : Stillness
        Signs of standing still.
    rested_ns : int or None
        When the robot was last found to stand, which showed the gyro's bias.
    turns : Turns
        What each sensor says of the present window.
    common_source : CommonSource
        Whether the odometry takes its turns from the gyro.
    isolation : Isolation
        Who contradicts and is excluded, and what the alternatives are.
    gyro_vague : bool
        Whether the gyro's last sample says next to nothing, as at its end stop.
    gyro_since_ns : int or None
        Since when the gyro has spoken without a pause.
    refusal : Refusal or None
        Increments that the gate refuses at present.
    image_excess : float
        Squared innovation of the last image beyond its variance, rad^2, whether it passed the gate or not.
    image_turning : float
        As `mean_turning` has it.
    image_innovation : tuple of float or None
        Of the last increment from a keyframe, rad, and the turn rate then, rad/s; None where none was judged.
    unconfirmed : Unconfirmed or None
        Since when only one sensor measures the turn; None before two have agreed.
    warnings : tuple of Warning
        What is wrong.
    trail : GyroTrail
        What the gyro said lately.
    bias_gain : BiasGain
        Tilt of the robot, as far as it matters to the gyro's bias.
    tilted_turn : TiltedTurn
        What the yaw owes to a vertical that may err.
    paused_ns : int
        End of the last pause of all sensors that was long enough to turn round in, ns.
    turn_count : TurnCount
        What is not known of the number of full turns.
    scale_conflict : ScaleConflict
        By what factor gyro and compass differ.
    early_images : EarlyImages
        By how much the compass seems to be ahead of the gyro.
    hung_since_ns : int or None
        Since when a gyro hangs, ns.
    hung_tracks : OdometrySample or None
        What the odometry said as it began to, as long as it has said nothing else since, or zero.
    gyro_factor_sigma : float
        Of the gyro's last sample, see `GyroSample.factor_sigma`.
    aided_yaw, aided_ns : float, int or None
        The yaw when a compass last measured it, or when it was set, rad, and when that was: since then the gyro's scale
        counts.
    yaw_lead : float
        By how much the published yaw is ahead of what is believed, rad: standing, the robot finds out how far wrong it
        has turned for minutes, but its yaw does not jump.
    standing_yaw : float or None
        The yaw of a robot that stands as it is believed, rad, where the step to this state asked for it.
    agreement : BiasPrior or None
        What is known beforehand of the gyro's bias and the tracks' veer; None once a bias has jumped.
    unwatched : Unwatched
        What the gyro turned while no images watched it.
    agreed_scale : tuple of float or None
        Scale factor of the tracks and its standard deviation when gyro and images last agreed on a turn.
    bias_walk : BiasWalk
        How fast the gyro's bias walks.
    jitter : LearntNoise
        Timestamp jitter of the images, s.
    rate_walk_scale, slip_turn, slip_speed : LearntNoise
        How much less or more than configured the turn rate changes while a gyro watches, and the tracks slip by turning
        and by driving: factors.
    gyro_noise : GyroNoise
        How much noisier than configured the gyro is.
    """

    ekf: YawEkf
    t_ns: int | None = None
    clones: Clones = field(default_factory=Clones)
    tracks: TrackClaim | None = None
    odometry_fields: OdometryFields = field(default_factory=OdometryFields)
    gates: dict[Sensor, Gate] = field(default_factory=lambda: {sensor: Gate() for sensor in Sensor})
    references_lost: int = 0
    stillness: Stillness = field(default_factory=lambda: Stillness(0))
    rested_ns: int | None = None
    turns: Turns = field(default_factory=Turns)
    common_source: CommonSource = field(default_factory=CommonSource)
    isolation: Isolation = field(default_factory=Isolation)
    gyro_vague: bool = False
    gyro_since_ns: int | None = None
    refusal: Refusal | None = None
    image_excess: float = 0.0
    image_innovation: tuple[float, float] | None = None
    image_turning: float = 0.0
    unconfirmed: Unconfirmed | None = None
    warnings: tuple[Warning, ...] = ()
    trail: GyroTrail = field(default_factory=GyroTrail)
    bias_gain: BiasGain = field(default_factory=BiasGain)
    tilted_turn: TiltedTurn = field(default_factory=TiltedTurn)
    paused_ns: int = 0
    turn_count: TurnCount = field(default_factory=TurnCount)
    scale_conflict: ScaleConflict = field(default_factory=lambda: ScaleConflict(0.0))
    early_images: EarlyImages = field(default_factory=EarlyImages)
    hung_since_ns: int | None = None
    hung_tracks: OdometrySample | None = None
    gyro_factor_sigma: float = 0.0
    aided_yaw: float = 0.0
    aided_ns: int | None = None
    yaw_lead: float = 0.0
    standing_yaw: float | None = None
    agreement: BiasPrior | None = None
    unwatched: Unwatched = field(default_factory=lambda: Unwatched(0.0))
    agreed_scale: tuple[float, float] | None = None
    bias_walk: BiasWalk = field(default_factory=lambda: BiasWalk(0.0))
    jitter: LearntNoise = field(default_factory=lambda: LearntNoise(0.0))
    rate_walk_scale: LearntNoise = field(default_factory=lambda: LearntNoise(1.0))
    slip_turn: LearntNoise = field(default_factory=lambda: LearntNoise(1.0))
    slip_speed: LearntNoise = field(default_factory=lambda: LearntNoise(1.0))
    gyro_noise: GyroNoise = field(default_factory=GyroNoise)

    @property
    def x(self) -> Array:
        """State of the EKF, shape (DIM,)."""
        return self.ekf.x

    @property
    def P(self) -> Array:  # noqa: N802 - the textbook's
        """Its covariance, shape (DIM, DIM)."""
        return self.ekf.P

    def fork(self, tape: list[Transition | Correction] | None = None) -> FilterState:
        """A state to be changed by one step: with an EKF of its own, which notes on `tape` what is done to it."""
        state = self._copy()
        ekf = state.ekf = self.ekf.fork(tape)
        ekf.jitter, ekf.rate_walk_scale = self.jitter.variance, self.rate_walk_scale.variance
        ekf.bias_walk_scale = self.bias_walk.scale
        ekf.slip_turn, ekf.slip_speed = self.slip_turn.variance, self.slip_speed.variance
        return state

    def _copy(self) -> FilterState:
        """What `copy.copy` does, in a tenth of the time."""
        state: FilterState = object.__new__(FilterState)
        state.__dict__ = self.__dict__.copy()
        return state

    def at(self, x: Array, P: Array) -> FilterState:
        """The same with another state and covariance."""
        state = self._copy()
        state.ekf = self.ekf.fork(None)
        state.ekf.x, state.ekf.P = x, P
        state.standing_yaw = None
        return state

    @property
    def gyro_scale_sigma(self) -> float:
        """Standard deviation to expect of the excess of the gyro's scale factor over one."""
        return math.hypot(self.ekf.config.gyro_scale_sigma, self.gyro_factor_sigma)

    @property
    def scale_variance(self) -> float:
        """Variance (rad^2) that the gyro's scale gives to the turn since the yaw was last measured or set."""
        if self.gates[Sensor.GYRO].accepted_ns is None or self.hears(Sensor.COMPASS):
            return 0.0
        turn = float(self.x[State.YAW]) - self.aided_yaw
        return float(self.P[State.GYRO_SCALE, State.GYRO_SCALE]) * turn**2

    @property
    def belief(self) -> Belief:
        """Of yaw, turn rate and tracks."""
        return self._belief(self.x if self.hears(Sensor.COMPASS) else believed(self)[0])

    def _belief(self, x: Array) -> Belief:
        variance = max(float(self.P[State.SCALE, State.SCALE]), 0.0)
        by_scale = float(self.P[State.YAW, State.SCALE]) / variance if variance > 0.0 else 0.0
        return Belief(
            self.t_ns or 0,
            float(x[State.YAW]),
            float(x[State.RATE]),
            float(x[State.SCALE]),
            math.sqrt(variance),
            by_scale,
        )

    def confirmed(self, rate_sigma: float) -> Unconfirmed:
        """Two sensors agree; `rate_sigma`: of a turn rate that nobody measures, rad/s."""
        # tracks that have said nothing yet but zero may begin to speak before the next window is over
        witness = self.speaks(Sensor.TRACKS) and (self.believes(Sensor.GYRO) or self.hears(Sensor.COMPASS))
        t_ns = self.t_ns or 0
        claims = TracksSince.begin(self.tracks.last, t_ns) if witness and self.tracks else None
        if self.unconfirmed is None:
            return Unconfirmed(self.belief, rate_sigma, claims)
        since = {"since": self.belief, "tracks": claims, "beginning": False}
        return replace(self.unconfirmed, blind_ns=None, noise=0.0, held=0.0, **since)  # type: ignore[arg-type]

    def begun(self, yaw: float, rate_sigma: float) -> Unconfirmed:
        """Nobody has agreed yet with whoever speaks first; the robot is taken to stand at a yaw, rad."""
        return Unconfirmed(replace(self.belief, yaw=yaw, rate=0.0), rate_sigma, beginning=True)

    @property
    def only_tracks_watch(self) -> bool:
        """Whether nobody but the tracks can contradict the images."""
        return not self.believes(Sensor.GYRO) and self.believes(Sensor.TRACKS) and self.hears(Sensor.COMPASS)

    def unconfirmed_variance(self, known: Array | None = None) -> float:
        """What the yaw owes to one sensor only, rad^2; `known`: the state as `believed` has it, if that was asked."""
        if self.unconfirmed is None or (self.unconfirmed.beginning and not self.gates[Sensor.GYRO].report):
            return 0.0
        slipped, unconfirmed = ALTERNATIVE_PROBABILITY[Sensor.TRACKS] * self.unconfirmed.by_tracks, self.unconfirmed
        gyro = self.believes(Sensor.GYRO)
        if self.common_source.one is not False if gyro else not self.believes(Sensor.TRACKS):
            unconfirmed = replace(unconfirmed, tracks=None)  # they confirm and contradict nobody
        belief = self.belief if known is None or self.hears(Sensor.COMPASS) else self._belief(known)
        variance = unconfirmed.variance(belief, images=self.only_tracks_watch) + self.against_tracks
        return variance + (slipped if self.hears(Sensor.COMPASS) else 0.0)

    def is_blind(self, *, refused: bool) -> bool:
        """Whether no gyro and no compass can be believed to measure the turn rate; `refused`: the last image was.

        A robot only seems to stand where nobody is left that would see it start at once.
        """
        gyro, standing = self.turns.gyro, self.stillness.standing
        if self.believes(Sensor.GYRO):
            stuck = self.gyro_noise.stuck or (gyro is not None and gyro.repeats >= SAME_NUMBER)
            return refused or (stuck and not standing) or self.gyro_noise.frozen
        return refused or (standing and not self.believes(Sensor.TRACKS))

    @property
    def against_tracks(self) -> float:
        """Variance, rad^2, for what tracks say that no gyro contradicts, while images are followed instead."""
        tracks, scale, t_ns = self.turns.tracks, float(self.x[State.SCALE]), self.t_ns or 0
        if (
            tracks is None
            or tracks.gap_ns > RATE_SILENT_NS
            or self.believes(Sensor.GYRO)
            or not self.believes(Sensor.TRACKS)
        ):
            return 0.0
        beyond = float(self.x[State.YAW]) - self.turns.start.yaw - tracks.turn_until(t_ns) / scale
        known = self.turns.start.scale_sigma / scale * tracks.turn_until(t_ns) / scale
        return ALTERNATIVE_PROBABILITY[Sensor.COMPASS] * max(beyond**2 - known**2, 0.0)

    def believes(self, sensor: Sensor) -> bool:
        """Whether a gyro or tracks speak, have ever said anything but zero, and are not excluded."""
        spoke = sensor is Sensor.GYRO or self.odometry_fields.pose or self.odometry_fields.twist
        return spoke and self.speaks(sensor)

    def speaks(self, sensor: Sensor) -> bool:
        """Whether a gyro or tracks speak and are not excluded."""
        turn = self.turns.gyro if sensor is Sensor.GYRO else self.turns.tracks
        if turn is None or (self.t_ns or 0) - turn.t_ns > RATE_SILENT_NS:
            return False
        return not self.isolation.exclusions or not self.isolation.excludes(sensor)

    @property
    def all_warnings(self) -> tuple[Warning, ...]:
        """What is wrong, the turns that nobody counted included, most serious first."""
        named = {warning.code for warning in self.warnings}
        more = [one for one in (*self.early_images.warnings(), *self._hung()) if one.code not in named]
        others = (*self.scale_conflict.warnings(), *more, *self.turn_count.warnings(), *self.common_source.warnings())
        return tuple(most_serious_first((*self.warnings, *others)))

    def _hung(self) -> tuple[Warning, ...]:
        if self.hung_since_ns is None:
            return ()
        also = "" if self.hung_tracks is None else ", and the odometry has said nothing new since, either"
        text = (
            f"the gyro repeats {self.gyro_noise.rate:.4g} rad/s to the last bit{also}: what it says is not used; "
            "restart or replace the IMU, check its driver and its link"
        )
        sensors = "gyro" if self.hung_tracks is None else "gyro+tracks"
        return (Warning("gyro_stuck", sensors, self.hung_since_ns, text),)

    def hears(self, sensor: Sensor) -> bool:
        """Whether a sensor has measured the turning lately."""
        t_ns = self.gates[sensor].accepted_ns
        silent_ns = SILENT_NS if sensor is Sensor.COMPASS else RATE_SILENT_NS
        if t_ns is None or (self.t_ns or 0) - t_ns > silent_ns:
            return False
        return not self.isolation.exclusions or not self.isolation.excludes(sensor)


def believed(state: FilterState) -> tuple[Array, Array]:
    """State and covariance with what gyro and tracks say by agreeing."""
    two = state.common_source.one is False and state.gates[Sensor.TRACKS].accepted_ns is not None
    if state.agreement is None or not two:
        return state.x, state.P
    return state.agreement.mixed(state.x, state.P, (State.BIAS, State.VEER))
