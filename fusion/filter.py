"""One step of the filter: from the state after one event to the state after the next.

A state is never changed once it is handed out; so it is its own checkpoint and a replay is exact.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np

from fusion.config import FusionConfig
from fusion.ekf import CLONES, DIM, Array, Measurement, State, YawEkf
from fusion.events import CompassEvent, FusionEvent, GyroEvent, HeadingEvent, Sensor, TracksEvent
from fusion.gating import Gate, Verdict, gate_limit
from fusion.samples import OdometrySample, YawEstimate

ALONE_NS = 500_000_000  # longer than the gap between two images of a slow camera


@dataclass(frozen=True, slots=True)
class Clone:
    """A remembered yaw.

    Attributes
    ----------
    t_ns : int
        Its time.
    used_ns : int
        When an increment last referred to it.
    reference : bool
        Whether an increment refers to it, or only might.
    """

    t_ns: int
    used_ns: int
    reference: bool


@dataclass(slots=True)
class FilterState:
    """All that the filter knows after an event; its members are replaced, never changed.

    Attributes
    ----------
    x, P : numpy.ndarray
        State and covariance, see `fusion.ekf.State`.
    t_ns : int or None
        Time they hold for, ns; None before the first event.
    clones : tuple of Clone or None
        What each clone slot holds.
    track_pose : OdometrySample or None
        The odometry sample at whose time the state TRACK_REF was cloned.
    gates : dict of Sensor to Gate
        Gate and last report of each sensor.
    references_lost : int
        Increments whose reference the filter had never seen or forgotten.
    reference_ns : int or None
        Reference of the last increment.
    """

    x: Array
    P: Array
    t_ns: int | None = None
    clones: tuple[Clone | None, ...] = (None,) * CLONES
    track_pose: OdometrySample | None = None
    gates: dict[Sensor, Gate] = field(default_factory=lambda: {sensor: Gate() for sensor in Sensor})
    references_lost: int = 0
    reference_ns: int | None = None


class YawFilter:
    """Steps the EKF through events."""

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self._ekf = YawEkf(config)
        self._limit = gate_limit(config)
        self._recovery_ns = round(config.recovery_time * 1e9)
        self.start = FilterState(self._ekf.x, self._ekf.P)

    def step(self, before: FilterState, event: FusionEvent) -> FilterState:
        """State after `event`, which must not be older than `before`."""
        state, ekf = copy.copy(before), self._ekf
        ekf.x, ekf.P = before.x, before.P
        if before.t_ns is not None and event.t_ns > before.t_ns:
            ekf.predict_for((event.t_ns - before.t_ns) * 1e-9)
        state.t_ns = event.t_ns
        if isinstance(event, GyroEvent):
            self._fuse_gyro(state, event)
        elif isinstance(event, TracksEvent):
            self._fuse_tracks(state, event)
        elif isinstance(event, CompassEvent):
            self._fuse_increment(state, event)
        elif isinstance(event, HeadingEvent):
            ekf.turn_frame(event.heading, event.variance)
        else:
            self._remember(state, event.t_ns, reference=True)
        state.x, state.P = ekf.x, ekf.P
        return state

    def _fuse_gyro(self, state: FilterState, event: GyroEvent) -> None:
        measurement = self._ekf.gyro(event.sample.yaw_rate, event.sample.variance)
        if self._judge(state, Sensor.GYRO, measurement) is Verdict.RECOVERED:
            # the bias has jumped: open it until the gate is met
            excess = measurement.innovation**2 / self._limit - self._ekf.innovation_variance(measurement)
            self._widen(State.BIAS, excess)
            self._ekf.correct(measurement)

    def _fuse_tracks(self, state: FilterState, event: TracksEvent) -> None:
        sample, before, alone = event.sample, state.track_pose, self._tracks_alone(state)
        if self.config.odometry == "twist" or sample.yaw is None:
            measurement = self._ekf.track_rate(sample.yaw_rate, sample.speed, alone=alone)
        else:
            state.track_pose = sample
            if before is None or before.yaw is None or sample.t_ns == before.t_ns:
                self._ekf.clone_yaw(State.TRACK_REF)
                return
            dt = (sample.t_ns - before.t_ns) * 1e-9
            turn = sample.yaw - before.yaw
            measurement = self._ekf.track_turn(turn, sample.speed, dt, alone=alone)
        if self._judge(state, Sensor.TRACKS, measurement) is Verdict.RECOVERED:
            # the ground has changed: open the scale as far as it can explain the claim
            self._widen(State.SCALE, self.config.initial_scale_sigma**2)
        if state.track_pose is sample:
            self._ekf.clone_yaw(State.TRACK_REF)

    def _fuse_increment(self, state: FilterState, event: CompassEvent) -> None:
        increment, ekf = event.sample, self._ekf
        slot = next((i for i, c in enumerate(state.clones) if c and c.t_ns == increment.t_ref_ns), None)
        if increment.t_ref_ns != state.reference_ns:
            ekf.renew(State.COMPASS_ERROR, 1.0)
            state.reference_ns = increment.t_ref_ns
        if slot is None:
            # the reference was never seen: place it where this increment says, so that those to come can use it
            state.references_lost += 1
            slot = self._remember(state, increment.t_ref_ns, reference=True)
            ekf.anchor(State.CLONE + slot, ekf.compass(increment.yaw, increment.variance, State.CLONE + slot))
        else:
            measurement = ekf.compass(increment.yaw, increment.variance, State.CLONE + slot)
            if self._judge(state, Sensor.COMPASS, measurement) is Verdict.RECOVERED:
                # whoever erred, what comes from now on counts; should it be the gyro's bias, let it move
                ekf.anchor(State.CLONE + slot, measurement)
                self._widen(State.BIAS, self.config.initial_bias_sigma**2)
        self._mark(state, slot, Clone(increment.t_ref_ns, event.t_ns, reference=True))
        self._remember(state, event.t_ns, reference=False)

    @staticmethod
    def _tracks_alone(state: FilterState) -> bool:
        """Whether nothing else has measured the turning lately."""
        heard = [state.gates[sensor].accepted_ns for sensor in (Sensor.GYRO, Sensor.COMPASS)]
        return all(t_ns is None or (state.t_ns or 0) - t_ns > ALONE_NS for t_ns in heard)

    def _judge(self, state: FilterState, sensor: Sensor, measurement: Measurement) -> Verdict:
        """Pass a measurement through its gate and fuse it if accepted."""
        S = self._ekf.innovation_variance(measurement)
        gate = state.gates[sensor].judge(state.t_ns or 0, measurement.innovation, S, self._limit, self._recovery_ns)
        state.gates = {**state.gates, sensor: gate}
        verdict = gate.report.verdict if gate.report else Verdict.REJECTED
        if verdict is Verdict.ACCEPTED:
            self._ekf.correct(measurement)
        return verdict

    def _widen(self, index: State, variance: float) -> None:
        spread = np.zeros(DIM)
        spread[index] = variance
        self._ekf.P = self._ekf.P + np.diag(spread)

    def _remember(self, state: FilterState, t_ns: int, *, reference: bool) -> int:
        """Clone the present yaw as a reference, or as a candidate for one; return the slot."""
        clones = state.clones
        slot = next((i for i, c in enumerate(clones) if c and c.t_ns == t_ns), None)
        if slot is None:
            slot = next((i for i, c in enumerate(clones) if not c or not c.reference), None)
        if slot is None:
            slot = min(range(CLONES), key=lambda i: c.used_ns if (c := clones[i]) else 0)
        self._ekf.clone_yaw(State.CLONE + slot)
        self._mark(state, slot, Clone(t_ns, t_ns, reference))
        return slot

    @staticmethod
    def _mark(state: FilterState, slot: int, clone: Clone) -> None:
        state.clones = (*state.clones[:slot], clone, *state.clones[slot + 1 :])


def estimate_of(state: FilterState) -> YawEstimate | None:
    """What a state says; None before the first event."""
    if state.t_ns is None:
        return None
    x, P = state.x, state.P
    return YawEstimate(
        t_ns=state.t_ns,
        yaw=float(x[State.YAW]),
        yaw_variance=float(P[State.YAW, State.YAW]),
        yaw_rate=float(x[State.RATE]),
        yaw_rate_variance=float(P[State.RATE, State.RATE]),
        gyro_bias=float(x[State.BIAS]),
        gyro_bias_variance=float(P[State.BIAS, State.BIAS]),
        track_scale=float(x[State.SCALE]),
        track_scale_variance=float(P[State.SCALE, State.SCALE]),
    )
