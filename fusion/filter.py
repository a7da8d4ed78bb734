"""One step of the filter: from the state after one event to the state after the next.

States are never changed, only succeeded; so a state is its own checkpoint and a replay is exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from fusion.config import FusionConfig
from fusion.ekf import CLONES, Array, Measurement, State, YawEkf
from fusion.events import CompassEvent, FusionEvent, GyroEvent, Sensor, TracksEvent
from fusion.gating import Gate
from fusion.samples import YawEstimate


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
        Whether an increment ever referred to it, or only might.
    """

    t_ns: int
    used_ns: int
    reference: bool


@dataclass(frozen=True, slots=True)
class FilterState:
    """All that the filter knows after an event; `t_ns` is None before the first."""

    x: Array
    P: Array
    t_ns: int | None = None
    clones: tuple[Clone | None, ...] = (None,) * CLONES
    gates: Mapping[Sensor, Gate] = field(default_factory=lambda: MappingProxyType({s: Gate() for s in Sensor}))
    references_lost: int = 0


class YawFilter:
    """Steps the EKF through events."""

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self._ekf = YawEkf(config)
        self.start = FilterState(self._ekf.x, self._ekf.P)

    def step(self, state: FilterState, event: FusionEvent) -> FilterState:
        """State after `event`, which must not be older than `state`."""
        ekf = self._ekf
        ekf.x, ekf.P = state.x, state.P
        if state.t_ns is not None and event.t_ns > state.t_ns:
            ekf.predict_for((event.t_ns - state.t_ns) * 1e-9)
        if isinstance(event, GyroEvent):
            measurement = ekf.gyro(event.sample.yaw_rate, event.sample.variance)
            state = self._fuse(state, event, Sensor.GYRO, measurement)
        elif isinstance(event, TracksEvent):
            state = self._fuse(state, event, Sensor.TRACKS, ekf.tracks(event.sample.yaw_rate))
        elif isinstance(event, CompassEvent):
            state = self._fuse_increment(state, event)
        else:
            state = self._remember(state, event.t_ns, reference=True)
        return replace(state, x=ekf.x, P=ekf.P, t_ns=event.t_ns)

    def _fuse(self, state: FilterState, event: FusionEvent, sensor: Sensor, measurement: Measurement) -> FilterState:
        S = self._ekf.innovation_variance(measurement)
        gate, noise = state.gates[sensor].judge(event.t_ns, measurement.innovation, S, measurement.R, self.config)
        if noise is not None:
            self._ekf.correct(measurement, noise)
        return replace(state, gates=MappingProxyType({**state.gates, sensor: gate}))

    def _fuse_increment(self, state: FilterState, event: CompassEvent) -> FilterState:
        increment = event.sample
        slot = next((i for i, c in enumerate(state.clones) if c and c.t_ns == increment.t_ref_ns), None)
        if slot is None:
            state = replace(state, references_lost=state.references_lost + 1)
        else:
            clones = list(state.clones)
            clones[slot] = Clone(increment.t_ref_ns, event.t_ns, reference=True)
            state = replace(state, clones=tuple(clones))
            measurement = self._ekf.compass(increment.yaw, increment.variance, slot)
            state = self._fuse(state, event, Sensor.COMPASS, measurement)
        return self._remember(state, event.t_ns, reference=False)

    def _remember(self, state: FilterState, t_ns: int, *, reference: bool) -> FilterState:
        """Clone the present yaw, as the reference of increments to come or as a candidate for it."""
        slots = range(CLONES)
        clones = list(state.clones)
        age = [clone.used_ns if clone else 0 for clone in clones]
        same = [i for i in slots if (c := clones[i]) and c.t_ns == t_ns]
        free = [i for i in slots if not (c := clones[i]) or not c.reference]
        slot = (same or free or [age.index(min(age))])[0]
        self._ekf.clone_yaw(slot)
        clones[slot] = Clone(t_ns, t_ns, reference)
        return replace(state, clones=tuple(clones))


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
