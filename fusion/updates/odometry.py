"""The track odometry, or a wheel odometry: which of its fields speak, its model, its gate, and how its slip is learnt.

"Tracks" stands for wheels, too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from compass import wrap_angle
from fusion.buffer.events import Sensor, TracksEvent
from fusion.checks.gate import Verdict
from fusion.checks.rate_turn import SAME
from fusion.checks.turn_count import TurnCount
from fusion.config import FusionConfig
from fusion.record import replace
from fusion.samples import OdometrySample
from fusion.state.ekf import DIM, Expectation, Measurement, State, YawEkf
from fusion.state.learnt_noise import LearntNoise
from fusion.state.track_claim import TrackClaim
from fusion.updates.gating import Gating

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState
    from fusion.updates.fault_isolation import FaultIsolation

# Not derived: `LEAST_OTHERS`, `STAMPS_APART`, `TRACK_MEMORY`, `LEAST_SCALE`.
LEAST_OTHERS = 0.05  # share of an innovation's variance that is no slip, at least: what correlations hide of it
STAMPS_APART = 4.0  # times by how much they may be off, between odometry samples whose difference in yaw is a turn rate
LEAST_SCALE = 0.2  # of the expected one: tracks that claim less of a turn have stood, it is no factor
TRACK_MEMORY = 300.0  # turns of the tracks; some minutes


class OdometryUpdate:
    """Takes odometry samples into a state.

    Parameters
    ----------
    config : FusionConfig
        Of all models.
    gating : Gating
        The gates of all sensors.
    isolation : FaultIsolation
        Ends windows where no image does.
    """

    def __init__(self, config: FusionConfig, gating: Gating, isolation: FaultIsolation) -> None:
        self._config = config
        self._gating = gating
        self._isolation = isolation
        self._slip = LearntNoise.factor(config.slip_factor, TRACK_MEMORY)

    def fuse(self, state: FilterState, event: TracksEvent) -> None:
        """Take in what the tracks claim since their reference, once `track_interval` is over."""
        sample, ekf, config = event.sample, state.ekf, self._config
        if self._hangs(state, sample):
            state.tracks, state.turns = None, replace(state.turns, tracks=None)
            return
        state.common_source = state.common_source.with_tracks(sample)
        state.turns = state.turns.with_tracks(sample, by_poses=config.odometry == "pose")
        if state.turns.ends_at_odometry(event.t_ns):
            self._isolation.compare(state, None)
        tracks = state.tracks
        alone = not (state.hears(Sensor.GYRO) or state.hears(Sensor.COMPASS))
        # seldom enough that a slip meets what the others have settled; alone, that stamps that are off do not matter
        interval = config.track_interval
        if alone:
            interval = min(interval, STAMPS_APART * config.track_timing)
        turn, modulo_turn = tracks.turn_until(sample, config.odometry) if tracks else (None, False)
        seconds = (sample.t_ns - tracks.reference.t_ns) * 1e-9 if tracks else 0.0
        if tracks is None or turn is None:
            state.tracks = TrackClaim(sample, sample, 0.0)
            refer_tracks(ekf)
        elif seconds > 0.0 and seconds >= interval - 1e-6:
            jerk = (sample.yaw_rate - tracks.reference.yaw_rate) * config.track_timing
            noise = ekf.slip_speed * config.track_noise**2 * seconds + jerk**2
            measurement = tracks_measurement(ekf, turn, noise, modulo_turn=modulo_turn, alone=alone)
            # across a gap in which it may have turned round poses tell nothing: their full turn is not its own
            expected = ekf.expect(measurement)
            paused = modulo_turn and state.paused_ns > tracks.reference.t_ns
            if not paused or TurnCount().after(event.t_ns, measurement.innovation, expected.S).since_ns is None:
                fastest = max(sample.yaw_rate, turn / seconds, key=abs)
                yaw, variance = float(ekf.x[State.YAW]), float(ekf.P[State.YAW, State.YAW])
                self._judge(state, measurement, expected, fastest, seconds, alone=alone)
                if state.unconfirmed is not None:
                    gained = variance - float(ekf.P[State.YAW, State.YAW]) + (float(ekf.x[State.YAW]) - yaw) ** 2
                    state.unconfirmed = state.unconfirmed.told_by_tracks(gained)
            state.tracks = TrackClaim(sample, sample, 0.0)
            refer_tracks(ekf)
        else:
            gap = (sample.t_ns - tracks.last.t_ns) * 1e-9
            state.tracks = TrackClaim(tracks.reference, sample, tracks.turn + sample.yaw_rate * gap)
        note_slip(ekf, sample.yaw_rate, sample.speed)

    @staticmethod
    def _hangs(state: FilterState, sample: OdometrySample) -> bool:
        """Whether the odometry says nothing new since a gyro hangs: they may share what hangs."""
        heard = state.hung_tracks
        if heard is not None and not (
            _nothing_new(sample.yaw_rate, heard.yaw_rate) and _nothing_new(sample.speed, heard.speed)
        ):
            state.hung_tracks = None
        return state.hung_tracks is not None

    def _judge(
        self,
        state: FilterState,
        measurement: Measurement,
        expected: Expectation,
        fastest: float,
        seconds: float,
        *,
        alone: bool,
    ) -> None:
        """Pass a turn over `seconds`, at most at `fastest` rad/s, through the gate, and learn how it slipped."""
        ekf, config = state.ekf, self._config
        learnt = learnt_slip(
            ekf, (state.slip_turn, state.slip_speed), measurement.innovation, expected.S, fastest, seconds
        )
        verdict = self._gating.judge(state, Sensor.TRACKS, measurement, expected)
        if not alone and verdict is Verdict.ACCEPTED:
            state.slip_turn, state.slip_speed = learnt
        elif verdict is Verdict.RECOVERED:  # the ground has changed: learn anew how the tracks slip on it
            state.slip_turn, state.slip_speed = self._slip, self._slip
        if verdict is Verdict.RECOVERED or float(ekf.x[State.SCALE]) < LEAST_SCALE * config.initial_scale:
            ekf.renew(State.SCALE, config.initial_scale_sigma**2, config.initial_scale)


def _nothing_new(value: float, heard: float) -> bool:
    """Whether a driver that hangs may say so: what it said last, or zero."""
    return min(abs(value), abs(value - heard)) <= SAME


def tracks_measurement(ekf: YawEkf, turn: float, noise: float, *, modulo_turn: bool, alone: bool) -> Measurement:
    """What the turn (rad) claimed since the tracks' reference says: scale times the true turn, plus their error.

    `noise` is the variance of its white noise, rad^2; a pose counts no turns (`modulo_turn`). `alone` says that
    nothing else measures the turning. The scale cannot be observed then (linearised, the tracks would seem to
    observe it), so it is only considered.

    The second-order terms of scale times turn are kept (Bar-Shalom, Li & Kirubarajan 2001, section 10.3.2), but
    not when the tracks are alone: then the two err together so that their product is right. From sample to sample
    the turn changes by more than its noise, so the scale's error goes into the rate by the *new* turn: `H_after`.
    """
    M = np.zeros(DIM)
    M[State.YAW], M[State.TRACK_REF] = 1.0, -1.0
    PM = ekf.P @ M
    true_turn, scale = float(M @ ekf.x), float(ekf.x[State.SCALE])
    H = scale * M
    H[State.TRACK_ERROR] = 1.0
    innovation = turn - float(H @ ekf.x)
    if modulo_turn:
        innovation = float(wrap_angle(innovation))
    H[State.SCALE] = true_turn
    R = noise
    if not alone:
        cross = float(PM[State.SCALE])
        innovation -= cross
        R += float(ekf.P[State.SCALE, State.SCALE]) * max(float(M @ PM), 0.0) + cross**2
    PH = ekf.P @ H
    H_after = H.copy()
    H_after[State.SCALE] += float(M @ PH) / (float(H @ PH) + R) * innovation
    consider = (State.SCALE, State.GYRO_SCALE) if alone else (State.GYRO_SCALE,)
    return Measurement(innovation, H[None, :], R, H_after[None, :], consider)


def refer_tracks(ekf: YawEkf) -> None:
    """Make the present the reference of the tracks."""
    ekf.clone_yaw(State.TRACK_REF)
    ekf.renew(State.TRACK_ERROR, 0.0)


def note_slip(ekf: YawEkf, yaw_rate: float, speed: float) -> None:
    """Note what the tracks claim (rad/s, m/s): their slip grows with turning and with speed."""
    ekf.track_speed = speed
    ekf.slip_sigma = math.sqrt(
        ekf.slip_turn * (ekf.config.track_slip_turn * yaw_rate) ** 2
        + ekf.slip_speed * (ekf.config.track_slip_speed * speed) ** 2
    )


def learnt_slip(
    ekf: YawEkf, known: tuple[LearntNoise, LearntNoise], innovation: float, S: float, yaw_rate: float, seconds: float
) -> tuple[LearntNoise, LearntNoise]:
    """How the tracks slip by turning and by driving, after a turn over `seconds`, at most at `yaw_rate`, rad/s.

    `innovation` and its variance `S` are that turn's. What slip gives to the variance is split as it is configured, at
    the factors known so far.
    """
    config = ekf.config
    white = config.track_noise**2 * seconds
    lasting = config.slip_time * seconds  # of an integral over slip, but for a constant that cancels
    turning = (config.track_slip_turn * yaw_rate) ** 2 * lasting
    driving = (config.track_slip_speed * ekf.track_speed) ** 2 * lasting + white
    slipping = ekf.slip_turn * turning + ekf.slip_speed * driving
    slipped = float(ekf.P[State.TRACK_ERROR, State.TRACK_ERROR]) + ekf.slip_speed * white
    share = slipped / slipping if slipping > 0.0 else 0.0
    turning, driving = share * turning, share * driving
    others = max(S - slipped, LEAST_OTHERS * S)
    by_turn, by_speed = known
    return (
        by_turn.after(innovation, others + ekf.slip_speed * driving, math.sqrt(turning)),
        by_speed.after(innovation, others + ekf.slip_turn * turning, math.sqrt(driving)),
    )
