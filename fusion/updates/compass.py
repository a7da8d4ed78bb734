"""The compass: the model of its increments between cloned yaws, its gate, and its recovery."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from compass import YawIncrement, wrap_angle
from compass.tilt import Vector
from fusion.buffer.events import CompassEvent, ReferenceEvent, Sensor
from fusion.checks.gate import Verdict
from fusion.imu.tilt import heading_change
from fusion.record import replace
from fusion.state.clones import Clone
from fusion.state.ekf import DIM, Measurement, State, YawEkf
from fusion.state.gyro_trail import Exposure
from fusion.updates.gating import Gating
from fusion.updates.gyro_scale import tie_to_scale
from fusion.updates.image_timing import clone_exposure, exposure_of, mean_turning, told_of_delay

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState
    from fusion.updates.fault_isolation import FaultIsolation


class CompassUpdate:
    """Takes yaw increments into a state.

    Parameters
    ----------
    gating : Gating
        The gates of all sensors.
    isolation : FaultIsolation
        Ends a window at an image, and lets increments in again.
    """

    def __init__(self, gating: Gating, isolation: FaultIsolation) -> None:
        self._gating = gating
        self._isolation = isolation

    def fuse(self, before: FilterState, state: FilterState, event: CompassEvent) -> None:
        """Take in an increment; before the first after a gap the gyro's scale has turned the yaw."""
        ekf = state.ekf
        if before.scale_variance > 0.0 and not before.isolation.excludes(Sensor.COMPASS):
            tie_to_scale(state)
        self._fuse(before, state, event)
        scale, images = State.GYRO_SCALE, state.scale_conflict.images
        if not event.sample.long_baseline:
            known = state.gyro_scale_sigma if state.believes(Sensor.GYRO) else math.inf
            images = min(event.sample.factor_sigma, known)
        conflict, yaw = state.scale_conflict, float(ekf.x[State.YAW])
        learnt = float(ekf.x[scale]), float(ekf.P[scale, scale])
        state.scale_conflict = conflict.after(event.t_ns, yaw, *learnt, state.gyro_scale_sigma, images)
        if state.scale_conflict.since_ns is None and conflict.since_ns is not None:
            ekf.widen_frame(conflict.left(yaw))
        delay = float(ekf.x[State.CAMERA_DELAY]) - ekf.config.camera_delay
        spread = float(ekf.P[State.CAMERA_DELAY, State.CAMERA_DELAY])
        state.early_images = state.early_images.after(event.t_ns, delay, spread, ekf.config.camera_delay_sigma)
        if state.turns.start_ns == event.t_ns != before.turns.start_ns:
            state.turns = replace(state.turns, corrected=float(ekf.x[State.YAW]) - state.turns.start.yaw)

    def refer(self, state: FilterState, event: ReferenceEvent) -> None:
        """Remember the yaw at the capture time of a compass reference."""
        first = state.clones.slot_of(event.t_ns) is None and not state.hears(Sensor.COMPASS)
        slot = self.remember(state, event.t_ns, reference=True)
        if first:  # no image has confirmed what was turned before it
            state.clones = state.clones.doubted(event.t_ns, state.unconfirmed_variance())
        if event.long_baseline:
            state.clones = state.clones.kept(slot)

    def _fuse(self, before: FilterState, state: FilterState, event: CompassEvent) -> None:
        """Take in the turn since a remembered yaw, or place that yaw where the increment says."""
        ekf, slot = state.ekf, state.clones.slot_of(event.sample.t_ref_ns)
        known = slot is not None
        if slot is None:
            # the reference was never seen: place it where this increment says, so that those to come can use it
            state.references_lost += 1
            slot = self.remember(state, event.sample.t_ref_ns, reference=True)
        up = state.trail.up_at(event.t_ns - round(1e9 * float(ekf.x[State.CAMERA_DELAY])))
        increment = _levelled(event.sample, up)
        exposure, wrong_ns, kept = None, None, False
        if not increment.long_baseline:
            exposure = exposure_of(state)
            wrong_ns = self._isolation.take_turn(state, increment, slot if known else None, exposure)
            if state.turns.start_ns == event.t_ns:  # a window was judged: gyro and delay may be others now
                exposure = None
        moved = wrong_ns is not None
        if wrong_ns is not None:
            state.clones = state.clones.until(wrong_ns, but=slot)
            clone = state.clones[slot]
            kept = known and clone is not None and clone.placed_ns <= wrong_ns
        else:
            _allow_for_refused_gyro(state, event.t_ns)
        state.clones = state.clones.used(slot, event.t_ns)
        image = self.remember(state, event.t_ns, reference=False, exposure=exposure)
        if increment.long_baseline:
            state.clones = state.clones.kept(slot, image)
        since, until = State.CLONE + slot, State.CLONE + image
        measurement = compass_measurement(
            ekf, increment.yaw, increment.variance, since, until, long_baseline=increment.long_baseline
        )
        excluded = state.isolation.excludes(Sensor.COMPASS)
        rate = float(ekf.x[State.RATE])
        expected = ekf.expect(measurement)
        others = max(expected.S - ekf.jitter * rate**2, measurement.R)
        verdict = None
        if known and (kept or not moved):  # `kept`: a view of before what was taken back knows how far the robot turned
            seen_from = float(ekf.x[since])
            verdict = self._gating.judge(state, Sensor.COMPASS, measurement, expected)
            state.turns = state.turns.with_correction(float(ekf.x[since]) - seen_from)
        known_ns = before.gates[Sensor.COMPASS].accepted_ns
        if verdict is Verdict.ACCEPTED and state.paused_ns > (known_ns or event.sample.t_ref_ns):
            state.turn_count = state.turn_count.after(event.t_ns, measurement.innovation, expected.S)
        if not increment.long_baseline:
            judged = verdict is not None and not state.isolation.exclusions
            _learn_jitter(state, measurement.innovation, others, rate, judged=judged)
        if verdict is None or excluded:
            ekf.anchor(since, measurement)
            state.clones = state.clones.placed(slot, event.t_ns)
        if increment.long_baseline:
            return
        state.image_excess = 0.0
        if verdict is not None and not excluded:
            if verdict is not Verdict.RECOVERED:
                state.image_excess = max(measurement.innovation**2 - expected.S, 0.0)
            self._let_in_again(state, increment, measurement, verdict, slot, until, moved=moved)

    def _let_in_again(
        self,
        state: FilterState,
        increment: YawIncrement,
        measurement: Measurement,
        verdict: Verdict,
        slot: int,
        until: int,
        *,
        moved: bool,
    ) -> None:
        """Let an increment in that was refused for long, or twice while no gyro measured the turn; else note a refusal.

        `moved`: fault isolation has just moved the yaw, so that what is refused now comes from a view of before.
        """
        innovation, refusal = measurement.innovation, state.refusal
        witnessed = state.gyro_since_ns is not None and state.gyro_since_ns <= increment.t_ref_ns
        witnessed = witnessed and state.hears(Sensor.GYRO)
        again = refusal is not None and refusal.is_repeated_by(increment, innovation)
        if verdict is Verdict.RECOVERED or (verdict is Verdict.REJECTED and (moved or (again and not witnessed))):
            since = State.CLONE + slot
            self._isolation.recover(state, measurement, since, until, witnessed=witnessed and not moved)
            state.clones = state.clones.placed(slot, increment.t_ns)
        else:
            self._isolation.note_refusal(state, increment, measurement, verdict)

    def remember(self, state: FilterState, t_ns: int, *, reference: bool, exposure: Exposure | None = None) -> int:
        """Clone the yaw at the `exposure` of an image, as a reference or as a candidate for one; return the slot."""
        slot = state.clones.slot_of(t_ns)
        if slot is None:
            slot, exposure = state.clones.next_slot(), exposure or exposure_of(state)
            state.image_turning = mean_turning(state.image_turning, exposure)
            clone_exposure(state.ekf, State.CLONE + slot, exposure, told_of_delay(state.image_turning))
            state.clones = state.clones.put(slot, Clone(t_ns, t_ns, reference, exposure, state.t_ns or t_ns))
        elif reference:
            state.clones = state.clones.used(slot, t_ns)
        return slot


def compass_measurement(
    ekf: YawEkf, yaw: float, variance: float, since: int, until: int, *, long_baseline: bool = False
) -> Measurement:
    """What an increment (rad, variance rad^2) between the clones `since` and `until` says, modulo a turn.

    Part of its error lasts from image to image and beyond the reference (parallax keeps its sign while the robot
    passes the same things): a Gauss-Markov state, which is `compass_error_share` of the variance; of an increment from
    some seconds ago another one.
    """
    error = State.LONG_BASELINE_ERROR if long_baseline else State.COMPASS_ERROR
    lasting = ekf.config.compass_error_share * variance
    H = np.zeros((1, DIM))
    H[0, until], H[0, since] = 1.0, -1.0
    H[0, error] = math.sqrt(lasting)
    innovation = float(wrap_angle(yaw - float((H @ ekf.x)[0])))
    return Measurement(innovation, H, variance - lasting)


def _learn_jitter(state: FilterState, innovation: float, others: float, rate: float, *, judged: bool) -> None:
    """Learn the timestamp jitter of the images from an innovation less the one before, rad, at turn rates in rad/s.

    Jitter is white; what a drift or a wrong scale factor makes of innovations stays from image to image, and cancels.
    """
    before, state.image_innovation = state.image_innovation, (innovation, rate) if judged else None
    if before is not None and judged:
        change, gain = innovation - before[0], math.hypot(rate, before[1])
        state.jitter = state.jitter.after(change * math.sqrt(0.5), others, gain * math.sqrt(0.5))


def _allow_for_refused_gyro(state: FilterState, t_ns: int) -> None:
    """Let the yaw have gone on as the gyro's last sample says, if it was refused: the next one decides."""
    gate = state.gates[Sensor.GYRO]
    if gate.report and gate.rejecting_since_ns == gate.report.t_ns and state.hears(Sensor.GYRO):
        seconds = (t_ns - (gate.accepted_ns or t_ns)) * 1e-9
        state.ekf.widen(State.YAW, (gate.report.innovation * seconds) ** 2)


def _levelled(increment: YawIncrement, up: Vector | None) -> YawIncrement:
    """An increment of the heading, where the vertical in the robot's frame is known at its exposure."""
    if up is None or increment.turn is None:
        return increment
    return replace(increment, yaw=float(wrap_angle(heading_change(up, increment.turn, increment.tilt))))
