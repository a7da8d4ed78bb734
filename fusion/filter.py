"""One step of the filter: from the state after one event to the state after the next.

A state is never changed once it is handed out; so it is its own checkpoint and a replay is exact.
"""

from __future__ import annotations

import math

import numpy as np

from fusion.buffer.events import (
    CompassEvent,
    FusionEvent,
    GyroEvent,
    HeadingEvent,
    ReferenceEvent,
    Sensor,
    TracksEvent,
)
from fusion.checks.diagnosis import adds_up
from fusion.checks.scale_conflict import ScaleConflict
from fusion.checks.silence import RATE_SILENT_NS
from fusion.checks.stillness import Stillness
from fusion.checks.unwatched import Unwatched
from fusion.config import FusionConfig
from fusion.imu.tilt import TiltedTurn
from fusion.record import replace
from fusion.state.bias_prior import BiasPrior
from fusion.state.bias_walk import BiasWalk
from fusion.state.ekf import YAWS, Correction, State, Transition, YawEkf
from fusion.state.filter_state import FilterState, believed
from fusion.state.gyro_noise import GyroNoise
from fusion.state.learnt_noise import LearntNoise
from fusion.updates.compass import CompassUpdate
from fusion.updates.fault_isolation import FaultIsolation
from fusion.updates.gating import Gating
from fusion.updates.gyro import WATCHED_NS, GyroUpdate
from fusion.updates.odometry import TRACK_MEMORY, OdometryUpdate
from fusion.updates.standstill import StandstillUpdate

GYRO_MEMORY = 3000.0  # gyro samples; half a minute of them, legs of straight driving and turns
PAUSED = 0.2  # s; in which a gyro that was heard just before says nothing, nor anybody else; not derived
CLOCK_SET_PROBABILITY = 0.25  # that no time has passed in such a pause: it stays within two deviations; not derived
SETTLING = 3.0  # s, over which is published what a standing robot finds out of its yaw


class YawFilter:
    """Steps the EKF through events.

    Parameters
    ----------
    config : FusionConfig
        Of all models.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        gating, isolation = Gating(config), FaultIsolation(config)
        self._gyro = GyroUpdate(config, gating)
        self._odometry = OdometryUpdate(config, gating, isolation)
        self._compass = CompassUpdate(gating, isolation)
        self._standstill = StandstillUpdate(config, self._gyro)
        sigmas = config.initial_bias_sigma, config.veer_sigma
        least = config.least_bias_sigma, config.least_veer_sigma
        closed = sigmas[0] <= least[0] and sigmas[1] <= least[1]
        slip = LearntNoise.factor(config.slip_factor, TRACK_MEMORY)
        self.start = FilterState(
            YawEkf(config),
            scale_conflict=ScaleConflict(config.initial_yaw),
            aided_yaw=config.initial_yaw,
            unwatched=Unwatched(config.initial_yaw),
            agreement=BiasPrior(sigmas, least) if min(sigmas) > 0.0 and not closed else None,
            bias_walk=BiasWalk.about(config.bias_walk, config.bias_walk_factor),
            jitter=LearntNoise.jitter(config.compass_timing, config.compass_timing_factor),
            rate_walk_scale=LearntNoise.factor(config.rate_walk_factor, GYRO_MEMORY),
            slip_turn=slip,
            slip_speed=slip,
            gyro_noise=GyroNoise.prior(config.gyro_sigma_factor),
        )

    def step(
        self, before: FilterState, event: FusionEvent, tape: list[Transition | Correction] | None = None
    ) -> FilterState:
        """State after `event`, which must not be older than `before`; `tape` takes down how it came about."""
        state = before.fork(tape)
        if isinstance(event, ReferenceEvent) and before.t_ns == event.t_ns:  # all is known of that time already
            self._compass.refer(state, event)
            return state
        if isinstance(event, TracksEvent):
            state.odometry_fields, sample = before.odometry_fields.after(event.sample, before.trail.up_at(event.t_ns))
            event = TracksEvent(sample, event.t_ns, event.order)
        if before.t_ns is None:
            state.unwatched = replace(before.unwatched, t_ns=event.t_ns)
            state.stillness = Stillness(event.t_ns, reference_ns=event.t_ns)
        elif event.t_ns - before.t_ns > (WATCHED_NS if isinstance(event, ReferenceEvent) else RATE_SILENT_NS):
            state.stillness = state.stillness.moved(event.t_ns)  # nobody would have seen it start
        if before.t_ns is not None and event.t_ns - before.t_ns > RATE_SILENT_NS:
            state.paused_ns = event.t_ns
        started = self._standstill.watch(state, event)
        self._predict(state, event.t_ns, still=state.stillness.standing)
        if started and before.t_ns is not None:
            self._standstill.start(state, event, (event.t_ns - before.t_ns) * 1e-9)
        if isinstance(event, GyroEvent):
            self._gyro.fuse(state, event)
        elif isinstance(event, TracksEvent):
            self._odometry.fuse(state, event)
        elif isinstance(event, CompassEvent):
            self._compass.fuse(before, state, event)
        elif isinstance(event, HeadingEvent):
            state.ekf.turn_frame(event.heading, event.variance)
            state.scale_conflict = replace(state.scale_conflict, yaw=float(state.x[State.YAW]))
            state.tilted_turn = TiltedTurn()
        else:
            self._compass.refer(state, event)
        self._standstill.settle(state)
        if state.hears(Sensor.COMPASS) or isinstance(event, HeadingEvent):
            state.aided_yaw, state.aided_ns = float(state.x[State.YAW]), event.t_ns
            if isinstance(event, HeadingEvent):
                state.unwatched = Unwatched(state.aided_yaw, event.t_ns)
            else:
                heard = before.hears(Sensor.COMPASS)
                yaw = None if heard else float(before.x[State.YAW])
                state.unwatched = state.unwatched.heard(event.t_ns, state.aided_yaw, yaw)
        self._lead(before, state, event)
        contradicted = before.unconfirmed is not None and before.unconfirmed.tracks is not None
        if contradicted and not state.believes(Sensor.TRACKS) and before.believes(Sensor.TRACKS):
            if not state.isolation.excludes(Sensor.TRACKS):  # else two others refute what they said
                # who contradicted says no more: it is known for good how little is known
                state.ekf.widen_frame(before.unconfirmed_variance())
            state.unconfirmed = state.confirmed(self.config.initial_rate_sigma)
        if before.t_ns is None:
            state.unconfirmed = state.begun(float(before.x[State.YAW]), self.config.initial_rate_sigma)
        self._confirm(before, state, event)
        return state

    @staticmethod
    def _lead(before: FilterState, state: FilterState, event: FusionEvent) -> None:
        """Let the published yaw of a standing robot not jump by what it finds out of the turns before."""
        state.standing_yaw = None
        if isinstance(event, HeadingEvent):
            state.yaw_lead = 0.0
        elif state.stillness.standing and before.t_ns is not None:
            known = before.standing_yaw
            if known is None:
                known = float(believed(before)[0][State.YAW])
            # kept for the next step: what is done to this state from here on changes no yaw
            state.standing_yaw = float(believed(state)[0][State.YAW])
            state.yaw_lead -= state.standing_yaw - known

    def _confirm(self, before: FilterState, state: FilterState, event: FusionEvent) -> None:
        """Note whether two sensors agree on the yaw, or who has spoken since they did."""
        gate, unconfirmed, agreed = state.gates[Sensor.COMPASS], state.unconfirmed, isinstance(event, HeadingEvent)
        older = 0.0  # of what is in doubt, than the view that an image is compared with
        refused = gate.rejecting_since_ns is not None
        window_over = state.turns.start_ns == event.t_ns and before.turns.start_ns is not None
        if unconfirmed is not None and window_over:
            unconfirmed = unconfirmed.with_window(state.isolation.last, state.belief, images=state.only_tracks_watch)
            beyond = unconfirmed.contradiction(state.belief) if state.only_tracks_watch else None
            if beyond is not None and not state.warnings:
                state.warnings = (adds_up(Sensor.COMPASS, unconfirmed.since.t_ns, beyond),)
        if (window_over or isinstance(event, CompassEvent)) and unconfirmed is not None and state.only_tracks_watch:
            agreed = agreed or (window_over and not refused and unconfirmed.agrees(state.belief))
        elif isinstance(event, CompassEvent) and gate.accepted_ns == event.t_ns and gate.report:
            off, variance = gate.report.innovation, event.sample.variance
            agreed = unconfirmed is None or unconfirmed.confirmed_by(off, variance, state.belief)
            if not (window_over and state.isolation.gyro_shown_right):
                older = before.clones.doubt(event.sample.t_ref_ns)
        elif window_over:
            agreed = not refused or state.isolation.contradicted
            if unconfirmed and not state.hears(Sensor.COMPASS):
                # tracks that have said nothing yet but zero may be right as long as nobody has agreed with anybody
                witness = state.speaks(Sensor.TRACKS) if unconfirmed.beginning else state.believes(Sensor.TRACKS)
                agreed = unconfirmed.agrees(state.belief) or not witness
        known = agreed and unconfirmed is not None and not unconfirmed.beginning
        if known or (agreed and sum(map(state.hears, Sensor)) > 1):
            doubt, error = before.unconfirmed_variance(), 0.0
            if isinstance(event, CompassEvent):  # it confirms to within its own error
                error = event.sample.variance + state.jitter.variance * float(state.x[State.RATE]) ** 2
            older = min(older, doubt)
            left = older + ((doubt - older) * error / (doubt - older + error) if error > 0.0 else 0.0)
            unconfirmed = replace(state.confirmed(self.config.initial_rate_sigma), left=left)
            if not older:
                state.clones = state.clones.confirmed()
        elif unconfirmed is not None and unconfirmed.is_alone(event.t_ns) and sum(map(state.hears, Sensor)) < 2:
            unconfirmed = None
        elif unconfirmed is not None and isinstance(event, TracksEvent):
            unconfirmed = unconfirmed.with_tracks(event.sample)
        if unconfirmed is not None and isinstance(event, CompassEvent):
            unconfirmed = unconfirmed.with_image(state.belief, accepted=gate.accepted_ns == event.t_ns)
        if unconfirmed is not None and state.is_blind(refused=refused):
            unconfirmed = unconfirmed.blind(event.t_ns)
        state.unconfirmed = unconfirmed
        if isinstance(event, CompassEvent):
            state.clones = state.clones.doubted(event.t_ns, state.unconfirmed_variance() if refused else older)

    def lost(self, state: FilterState, variance: float) -> FilterState:
        """A start from the yaw of a state, to which `variance`, rad^2, is added: it may have turned unseen."""
        x, P = self.start.x.copy(), self.start.P.copy()
        yaw = float(believed(state)[0][State.YAW]) + state.yaw_lead
        x[YAWS] = yaw
        variance += state.scale_conflict.variance(yaw) + state.tilted_turn.variance
        P[np.ix_(YAWS, YAWS)] = float(state.P[State.YAW, State.YAW]) + variance
        conflict = ScaleConflict(yaw)
        return replace(
            self.start.at(x, P),
            scale_conflict=conflict,
            aided_yaw=yaw,
            unwatched=Unwatched(yaw),
            turn_count=state.turn_count,
        )

    def predicted(self, state: FilterState, t_ns: int) -> FilterState:
        """State at `t_ns`, ns, given that nothing was measured since; `state` itself where that is no later.

        A robot that stood may have started since: nobody would have seen it.
        """
        if state.t_ns is None or t_ns <= state.t_ns:
            return state
        moved = state.fork()
        if t_ns - state.t_ns > RATE_SILENT_NS:
            moved.stillness = state.stillness.moved(t_ns)
        self._predict(moved, t_ns, still=False)
        return moved

    def _predict(self, state: FilterState, t_ns: int, *, still: bool) -> None:
        """Move on to `t_ns`, ns; `still`: somebody who has spoken by then would have seen the robot start."""
        if state.t_ns is not None and t_ns > state.t_ns:
            heard_ns = state.gates[Sensor.GYRO].accepted_ns
            watched = heard_ns is not None and t_ns - heard_ns <= WATCHED_NS and not state.gyro_vague
            seconds = (t_ns - state.t_ns) * 1e-9
            rate, unheard = float(state.x[State.RATE]), seconds - RATE_SILENT_NS * 1e-9
            state.ekf.predict_for(seconds, still=still, watched=watched)
            if seconds > PAUSED and heard_ns is not None and state.t_ns - heard_ns <= WATCHED_NS:
                # a pause of all, or a clock that was set forward: then it has not turned meanwhile
                state.ekf.widen(State.YAW, CLOCK_SET_PROBABILITY * (rate * seconds) ** 2)
            if unheard > 0.0:  # it may have stopped at any time since, at once
                state.ekf.widen(State.YAW, (rate * unheard) ** 2 / 3.0)
            if state.yaw_lead:
                state.yaw_lead *= math.exp(-seconds / SETTLING)
        state.t_ns = t_ns
