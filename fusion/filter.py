"""One step of the filter: from the state after one event to the state after the next.

A state is never changed once it is handed out; so it is its own checkpoint and a replay is exact.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from compass import YawIncrement, wrap_angle
from compass.tilt import beyond_error
from fusion.buffer.events import CompassEvent, FusionEvent, GyroEvent, HeadingEvent, ReferenceEvent, Sensor, TracksEvent
from fusion.checks.diagnosis import adds_up
from fusion.checks.gate import Verdict, gate_limit
from fusion.checks.windows import FASTEST, SILENT_NS, WINDOW_NS
from fusion.config import FusionConfig
from fusion.imu.tilt import LEAN_ERROR, BiasGain, heading_change
from fusion.samples import GyroSample
from fusion.state.bias_prior import Agreement
from fusion.state.clones import Clone
from fusion.state.ekf import YAWS, Correction, Measurement, State, Transition, YawEkf
from fusion.state.filter_state import FilterState, believed, exposure_of
from fusion.state.learnt_noise import LearntNoise
from fusion.updates.fault_isolation import Comparison
from fusion.updates.odometry_source import TrackClaim
from fusion.updates.standstill import Stillness

GYRO_MEMORY = 3000.0  # gyro samples; half a minute of them, legs of straight driving and turns
TRACK_MEMORY = 300.0  # turns of the tracks; some minutes
FOREVER_NS = 2**63
WATCHED_NS = 50_000_000  # since the last gyro sample: a slower gyro does not see how the robot starts to turn
SETTLING = 3.0  # s, over which is published what a standing robot finds out of its yaw
STAMPS_APART = 4.0  # times by how much they may be off, between odometry samples whose difference in yaw is a turn rate
VAGUE = 100.0  # times the noise of a gyro sample; from one of that a turn of 1 rad/s would not stand out


class YawFilter:
    """Steps the EKF through events.

    Parameters
    ----------
    config : FusionConfig
        Of all models.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self._ekf = YawEkf(config)
        self._comparison = Comparison(self._ekf, config)
        self._limit = gate_limit(config)
        seconds = dict.fromkeys(Sensor, config.recovery_time) | {Sensor.TRACKS: config.slip_recovery_time}
        self._recovery_ns = {sensor: round(time * 1e9) for sensor, time in seconds.items()}
        sigmas = config.initial_bias_sigma, config.veer_sigma
        least = config.least_bias_sigma, config.least_veer_sigma
        closed = sigmas[0] <= least[0] and sigmas[1] <= least[1]
        slip = LearntNoise.factor(config.slip_factor, TRACK_MEMORY)
        self.start = FilterState(
            self._ekf.x,
            self._ekf.P,
            told_yaw=config.initial_yaw,
            agreement=Agreement(sigmas, least) if min(sigmas) > 0.0 and not closed else None,
            stray=LearntNoise.stray(config.compass_timing, config.compass_timing_factor),
            agility=LearntNoise.factor(config.rate_walk_factor, GYRO_MEMORY),
            slip_turn=slip,
            slip_speed=slip,
        )

    def step(
        self, before: FilterState, event: FusionEvent, tape: list[Transition | Correction] | None = None
    ) -> FilterState:
        """State after `event`, which must not be older than `before`; `tape` takes down how it came about."""
        state, ekf = copy.copy(before), self._ekf
        self._load(before)
        ekf.tape = tape
        if isinstance(event, TracksEvent):
            state.track_voice, sample = before.track_voice.hear(event.sample, before.trail.up_at(event.t_ns))
            event = replace(event, sample=sample)
        if before.t_ns is None:
            state.stillness = Stillness(event.t_ns, reference_ns=event.t_ns)
        elif event.t_ns - before.t_ns > (WATCHED_NS if isinstance(event, ReferenceEvent) else SILENT_NS):
            state.stillness = state.stillness.moved(event.t_ns)  # nobody would have seen it start
        stood = state.stillness.standing
        self._watch(state, event)
        self._predict(state, event.t_ns, still=state.stillness.standing)
        if before.t_ns is not None and stood and not state.stillness.standing:
            prior = seen = self.config.initial_rate_sigma
            if isinstance(event, GyroEvent):
                seen = event.sample.yaw_rate - float(ekf.x[State.BIAS])
            ekf.open_rate(prior, (event.t_ns - before.t_ns) * 1e-9, seen)
        if isinstance(event, GyroEvent):
            self._fuse_gyro(state, event)
        elif isinstance(event, TracksEvent):
            self._fuse_tracks(state, event)
        elif isinstance(event, CompassEvent):
            if before.scale_variance > 0.0 and not before.isolation.excludes(Sensor.COMPASS):
                ekf.widen(State.YAW, before.scale_variance)
                state.told_yaw = float(ekf.x[State.YAW])
            self._fuse_increment(state, event)
            if state.turns.start_ns == event.t_ns != before.turns.start_ns:
                state.turns = replace(state.turns, corrected=float(ekf.x[State.YAW]) - state.turns.start.yaw)
        elif isinstance(event, HeadingEvent):
            ekf.turn_frame(event.heading, event.variance)
            state.told_yaw = float(ekf.x[State.YAW])
        else:
            slot = self._remember(state, event.t_ns, reference=True)
            if event.far:
                state.clones = state.clones.kept(slot)
        self._settle(state)
        state.x, state.P = ekf.x, ekf.P
        if state.hears(Sensor.COMPASS):
            state.told_yaw = float(ekf.x[State.YAW])
        if isinstance(event, HeadingEvent):
            state.held_back = 0.0
        elif state.stillness.standing and before.t_ns is not None:
            state.held_back -= float(believed(state)[0][State.YAW] - believed(before)[0][State.YAW])
        left = before.believes(Sensor.TRACKS) and not state.believes(Sensor.TRACKS)
        if before.unconfirmed is not None and before.unconfirmed.tracks is not None and left:
            # who contradicted says no more: it is known for good how little is known
            ekf.widen_frame(before.unconfirmed_variance)
            state.P, state.unconfirmed = ekf.P, state.confirmed(self.config.initial_rate_sigma)
        self._confirm(state, event)
        return state

    def _confirm(self, state: FilterState, event: FusionEvent) -> None:
        """Note whether two sensors agree on the yaw, or who has spoken since they did."""
        gate, unconfirmed, agreed = state.gates[Sensor.COMPASS], state.unconfirmed, isinstance(event, HeadingEvent)
        refused = gate.rejecting_since_ns is not None
        window_over = state.turns.start_ns == event.t_ns
        if unconfirmed is not None and window_over:
            unconfirmed = unconfirmed.with_window(state.isolation.last)
            beyond = unconfirmed.contradiction(state.belief) if state.only_tracks_watch else None
            if beyond is not None and not state.warnings:
                state.warnings = (adds_up(Sensor.COMPASS, unconfirmed.since.t_ns, beyond),)
        if state.only_tracks_watch and unconfirmed is not None:
            agreed = agreed or (window_over and not refused and unconfirmed.agrees(state.belief))
        elif isinstance(event, CompassEvent) and gate.accepted_ns == event.t_ns and gate.report:
            off, variance = gate.report.innovation, event.sample.variance
            agreed = unconfirmed is None or unconfirmed.confirmed_by(off, variance, state.belief)
        elif window_over:
            agreed = not refused or state.isolation.contradicted
            if unconfirmed and not state.hears(Sensor.COMPASS):
                agreed = unconfirmed.agrees(state.belief)
        if agreed and (unconfirmed is not None or sum(map(state.hears, Sensor)) > 1):
            unconfirmed = state.confirmed(self.config.initial_rate_sigma)
        elif unconfirmed is not None and isinstance(event, TracksEvent):
            unconfirmed = unconfirmed.with_tracks(event.sample)
        if unconfirmed is not None and isinstance(event, CompassEvent):
            unconfirmed = unconfirmed.with_image(state.belief, accepted=gate.accepted_ns == event.t_ns)
        if unconfirmed is not None and state.is_blind(refused=refused):
            unconfirmed = unconfirmed.blind(event.t_ns)
        state.unconfirmed = unconfirmed

    def lost(self, state: FilterState, variance: float) -> FilterState:
        """A start from the yaw of a state, to which `variance`, rad^2, is added: it may have turned unseen."""
        x, P = self.start.x.copy(), self.start.P.copy()
        yaw = float(believed(state)[0][State.YAW]) + state.held_back
        x[YAWS] = yaw
        P[np.ix_(YAWS, YAWS)] = float(state.P[State.YAW, State.YAW]) + variance
        return replace(self.start, x=x, P=P, told_yaw=yaw)

    def predicted(self, state: FilterState, t_ns: int) -> FilterState:
        """State at `t_ns`, ns, given that nothing was measured since; `state` itself where that is no later.

        A robot that stood may have started since: nobody would have seen it.
        """
        if state.t_ns is None or t_ns <= state.t_ns:
            return state
        moved, ekf = copy.copy(state), self._ekf
        if t_ns - state.t_ns > SILENT_NS:
            moved.stillness = state.stillness.moved(t_ns)
        self._load(state)
        ekf.tape = None
        self._predict(moved, t_ns, still=False)
        moved.x, moved.P = ekf.x, ekf.P
        return moved

    def _load(self, state: FilterState) -> None:
        """Put a state into the EKF."""
        ekf = self._ekf
        ekf.x, ekf.P = state.x, state.P
        ekf.track_speed, ekf.track_stray = state.track_speed, state.track_stray
        ekf.stray, ekf.agility = state.stray.variance, state.agility.variance
        ekf.slip_turn, ekf.slip_speed = state.slip_turn.variance, state.slip_speed.variance

    def _predict(self, state: FilterState, t_ns: int, *, still: bool) -> None:
        """Move on to `t_ns`, ns; `still`: somebody who has spoken by then would have seen the robot start."""
        if state.t_ns is not None and t_ns > state.t_ns:
            heard_ns = state.gates[Sensor.GYRO].accepted_ns
            watched = heard_ns is not None and t_ns - heard_ns <= WATCHED_NS and not state.gyro_vague
            seconds = (t_ns - state.t_ns) * 1e-9
            self._ekf.predict_for(seconds, still=still, watched=watched)
            if state.held_back:
                state.held_back *= math.exp(-seconds / SETTLING)
        state.t_ns = t_ns

    def _watch(self, state: FilterState, event: FusionEvent) -> None:
        """Note what an event says of standing; at the first sign of motion the turn rate is open again.

        Tracks show a start at once. Without them it may have hidden in the gyro's noise for a while, and what the robot
        turned meanwhile went into the bias and is missing in the yaw.
        """
        stillness = state.stillness
        if isinstance(event, GyroEvent) and event.sample.variance is not None and self._is_vague(event.sample.variance):
            stillness = stillness.moved(event.t_ns)
        elif isinstance(event, GyroEvent):
            stillness = stillness.with_gyro(event.t_ns, event.sample.yaw_rate, self._gyro_sigma(state, event.sample))
        elif isinstance(event, TracksEvent):
            stillness = stillness.with_tracks(event.sample)
        elif isinstance(event, CompassEvent) and not event.sample.far:
            stillness = stillness.with_increment(event.sample)
        if state.stillness.standing and not stillness.standing and not state.hears(Sensor.TRACKS):
            bias, turn = state.stillness.hidden_start()
            self._ekf.widen(State.BIAS, bias**2)
            self._ekf.widen(State.YAW, turn**2)
        state.stillness = stillness

    def _is_vague(self, variance: float) -> bool:
        """Whether a gyro sample of this variance, (rad/s)^2, says next to nothing."""
        return variance > (VAGUE * self.config.gyro_sigma) ** 2

    def _gyro_sigma(self, state: FilterState, sample: GyroSample) -> float:
        """Standard deviation of a sample's noise, rad/s; at rest, where nothing shakes the gyro, as it is seen."""
        if sample.variance is not None:
            return math.sqrt(sample.variance)
        return state.stillness.gyro_noise(self.config.gyro_sigma)

    def _settle(self, state: FilterState) -> None:
        """Pin the turn rate once the robot is found to stand."""
        bias, variance = float(self._ekf.x[State.BIAS]), float(self._ekf.P[State.BIAS, State.BIAS])
        stillness = state.stillness.judged(state.t_ns or 0, bias, variance**0.5)
        if stillness.reference_ns is not None and state.stillness.reference_ns is None:
            self._ekf.clone_yaw(State.STILL_REF)
        if stillness.standing and not state.stillness.standing:
            self._ekf.stand_still(((state.t_ns or 0) - (stillness.reference_ns or 0)) * 1e-9)
        state.stillness = stillness

    def _fuse_gyro(self, state: FilterState, event: GyroEvent) -> None:
        """Take in a gyro sample, or find that the robot or the bias has made a jump."""
        sample, refused = event.sample, state.gates[Sensor.GYRO]
        if refused.report is None or event.t_ns - refused.report.t_ns > SILENT_NS:
            state.gyro_since_ns = event.t_ns
        if sample.up:
            sample = replace(sample, up=beyond_error(sample.up, LEAN_ERROR))
        gain = BiasGain.leaning(sample.up) if sample.up else state.bias_gain
        if gain.differs(state.bias_gain):
            self._ekf.lean(state.bias_gain, gain)
            state.bias_gain = gain
        if state.stillness.standing and sample.cross_rate is not None:
            self._ekf.correct(self._ekf.cross_rate_at_rest(sample.cross_rate))
        vague = sample.variance is not None and self._is_vague(sample.variance)
        if vague and sample.variance is not None and not state.gyro_vague:
            self._ekf.widen(State.RATE, sample.variance)  # it may be beyond what was said so far
        state.gyro_vague = vague
        if vague:
            return
        state.turns = state.turns.with_gyro(sample)
        variance = self._gyro_sigma(state, sample) ** 2
        if abs(sample.yaw_rate) > FASTEST:
            return
        measurement = self._ekf.gyro(sample.yaw_rate, variance, scale_told=state.hears(Sensor.COMPASS))
        S = self._ekf.innovation_variance(measurement)
        prior, accepted_ns = S - measurement.R, refused.accepted_ns
        if accepted_ns is not None and measurement.innovation**2 > self._limit * S:
            self._ekf.allow_start((event.t_ns - accepted_ns) * 1e-9)
        verdict = self._judge(state, Sensor.GYRO, measurement)
        if not state.stillness.standing and verdict is Verdict.ACCEPTED:
            walked = math.sqrt(max(prior, 0.0) / self._ekf.agility)
            state.agility = state.agility.after(measurement.innovation, measurement.R, walked)
        if verdict is not Verdict.REJECTED:
            state.trail = state.trail.add(sample)
        if verdict is Verdict.RECOVERED:
            # the bias has jumped: open it until the gate is met
            excess = measurement.innovation**2 / self._limit - self._ekf.innovation_variance(measurement)
            self._ekf.widen(State.BIAS, excess)
            state.agreement = None
            self._ekf.correct(measurement)
        elif (
            verdict is Verdict.REJECTED
            and refused.refused_like(measurement.innovation)
            and not state.isolation.excludes(Sensor.GYRO)
        ):
            # twice on the same side: the robot turns harder than was to be expected, since the last sample accepted
            seconds = (event.t_ns - (refused.accepted_ns or event.t_ns)) * 1e-9
            if seconds > 0.0:
                self._ekf.widen(State.ACCELERATION, (measurement.innovation / seconds) ** 2)
            self._ekf.widen(State.RATE, measurement.innovation**2)
            self._ekf.widen(State.YAW, (measurement.innovation * seconds) ** 2)

    def _fuse_tracks(self, state: FilterState, event: TracksEvent) -> None:
        """Take in what the tracks claim since their reference, once `track_interval` is over."""
        sample, ekf = event.sample, self._ekf
        state.turns = state.turns.with_tracks(sample)
        if state.turns.ends_at_odometry(event.t_ns):
            self._comparison.compare(state, None)
        tracks = state.tracks
        alone = not (state.hears(Sensor.GYRO) or state.hears(Sensor.COMPASS))
        # seldom enough that a slip meets what the others have settled; alone, that stamps that are off do not matter
        interval = self.config.track_interval
        if alone:
            interval = min(interval, STAMPS_APART * self.config.track_timing)
        turn, modulo_turn = tracks.turn_until(sample, self.config.odometry) if tracks else (None, False)
        seconds = (sample.t_ns - tracks.reference.t_ns) * 1e-9 if tracks else 0.0
        if tracks is None or turn is None:
            state.tracks = TrackClaim(sample, sample, 0.0)
            ekf.refer_tracks()
        elif seconds > 0.0 and seconds >= interval - 1e-6:
            jerk = (sample.yaw_rate - tracks.reference.yaw_rate) * self.config.track_timing
            noise = ekf.slip_speed * self.config.track_noise**2 * seconds + jerk**2
            measurement = ekf.tracks(turn, noise, modulo_turn=modulo_turn, alone=alone)
            fastest = max(sample.yaw_rate, turn / seconds, key=abs)
            learnt = ekf.learnt_slip((state.slip_turn, state.slip_speed), measurement, fastest, seconds)
            verdict = self._judge(state, Sensor.TRACKS, measurement)
            if not alone and verdict is Verdict.ACCEPTED:
                state.slip_turn, state.slip_speed = learnt
            elif verdict is Verdict.RECOVERED:
                # the ground has changed: learn the scale anew, and how the tracks slip on it
                state.slip_turn, state.slip_speed = self.start.slip_turn, self.start.slip_speed
                ekf.renew(State.SCALE, self.config.initial_scale_sigma**2, self.config.initial_scale)
            state.tracks = TrackClaim(sample, sample, 0.0)
            ekf.refer_tracks()
        else:
            gap = (sample.t_ns - tracks.last.t_ns) * 1e-9
            state.tracks = TrackClaim(tracks.reference, sample, tracks.turn + sample.yaw_rate * gap)
        ekf.hear_tracks(sample.yaw_rate, sample.speed)
        state.track_speed, state.track_stray = ekf.track_speed, ekf.track_stray

    def _fuse_increment(self, state: FilterState, event: CompassEvent) -> None:
        """Take in the turn since a remembered yaw, or place that yaw where the increment says."""
        ekf, slot = self._ekf, state.clones.slot_of(event.sample.t_ref_ns)
        known = slot is not None
        if slot is None:
            # the reference was never seen: place it where this increment says, so that those to come can use it
            state.references_lost += 1
            slot = self._remember(state, event.sample.t_ref_ns, reference=True)
        increment = self._levelled(event.sample, state.clones[slot])
        began_ns = state.turns.start_ns
        moved = not increment.far and self._comparison.take_turn(state, increment, slot if known else None)
        if moved and began_ns is not None:  # yaws of the window that was taken back, or of the one before, are wrong
            state.clones = state.clones.until(began_ns - WINDOW_NS, but=slot)
        elif not moved:
            self._allow_for_refused_gyro(state, event.t_ns)
        state.clones = state.clones.used(slot, event.t_ns)
        image = self._remember(state, event.t_ns, reference=False)
        if increment.far:
            state.clones = state.clones.kept(slot, image)
        since, until = State.CLONE + slot, State.CLONE + image
        measurement = ekf.compass(increment.yaw, increment.variance, since, until, far=increment.far)
        excluded = state.isolation.excludes(Sensor.COMPASS)
        witnessed = state.gyro_since_ns is not None and state.gyro_since_ns <= event.sample.t_ref_ns
        witnessed = witnessed and state.hears(Sensor.GYRO)
        rate = float(ekf.x[State.RATE])
        others = max(ekf.innovation_variance(measurement) - ekf.stray * rate**2, measurement.R)
        verdict = self._judge(state, Sensor.COMPASS, measurement) if known and not moved else None
        if known and not state.isolation.exclusions and not increment.far and not moved:
            state.stray = state.stray.after(measurement.innovation, others, rate)
        if verdict is None or excluded:
            ekf.anchor(since, measurement)
        if verdict is None or excluded or increment.far:
            return
        again = state.refusal is not None and state.refusal.is_repeated_by(increment, measurement.innovation)
        if verdict is Verdict.RECOVERED or (verdict is Verdict.REJECTED and again and not witnessed):
            self._comparison.recover(state, measurement, since, until, witnessed=witnessed)
        else:
            self._comparison.note_refusal(state, increment, measurement, verdict)

    def _allow_for_refused_gyro(self, state: FilterState, t_ns: int) -> None:
        """Let the yaw have gone on as the gyro's last sample says, if it was refused: the next one will tell."""
        gate = state.gates[Sensor.GYRO]
        if gate.report and gate.rejecting_since_ns == gate.report.t_ns and state.hears(Sensor.GYRO):
            seconds = (t_ns - (gate.accepted_ns or t_ns)) * 1e-9
            self._ekf.widen(State.YAW, (gate.report.innovation * seconds) ** 2)

    @staticmethod
    def _levelled(increment: YawIncrement, clone: Clone | None) -> YawIncrement:
        """What an increment says of the heading, where it is known how the robot leant at its reference."""
        if clone is None or clone.up is None or increment.turn is None:
            return increment
        return replace(increment, yaw=float(wrap_angle(heading_change(clone.up, increment.turn, increment.tilt))))

    def _judge(self, state: FilterState, sensor: Sensor, measurement: Measurement) -> Verdict:
        """Pass a measurement through its gate and fuse it if accepted."""
        S = self._ekf.innovation_variance(measurement)
        limit, recovery_ns = self._limit, self._recovery_ns[sensor]
        if state.isolation.excludes(sensor) or (sensor is Sensor.TRACKS and state.isolation.doubt(sensor)):
            limit, recovery_ns = -1.0, FOREVER_NS
        gate = state.gates[sensor].judge(state.t_ns or 0, measurement.innovation, S, limit, recovery_ns)
        state.gates = {**state.gates, sensor: gate}
        verdict = gate.report.verdict if gate.report else Verdict.REJECTED
        if verdict is Verdict.ACCEPTED:
            self._ekf.correct(measurement)
        return verdict

    def _remember(self, state: FilterState, t_ns: int, *, reference: bool) -> int:
        """Clone the yaw at the exposure of an image, as a reference or as a candidate for one; return the slot."""
        slot = state.clones.slot_of(t_ns)
        if slot is None:
            slot, exposure = state.clones.next_slot(), exposure_of(state, self._ekf)
            self._ekf.clone_exposure(State.CLONE + slot, exposure)
            up = state.trail.up_at(t_ns - round(exposure.delay * 1e9))
            state.clones = state.clones.put(slot, Clone(t_ns, t_ns, reference, exposure, up))
        elif reference:
            state.clones = state.clones.used(slot, t_ns)
        return slot
