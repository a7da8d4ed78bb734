"""The fused yaw with the future known: a fixed-interval smoother over the filter's own model.

It is the Rauch-Tung-Striebel smoother in the form of Bryson and Frazier (Bierman 1973, "Fixed interval smoothing with
discrete measurements", doi:10.1080/00207177308932487): the same estimates, but no covariance has to be inverted, and
those with clones are singular. Backwards through the run go an adjoint ``l`` and its covariance ``L``; the smoothed
state is ``x - P l``, its covariance ``P - P L P``. Gates, standstill and recoveries are those of the filter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from compass import YawIncrement
from fusion.buffer.events import (
    CompassEvent,
    FusionEvent,
    Sample,
    Sensor,
    event_of,
    fault_of,
    needs_reference,
    reference_of,
    sensor_of,
)
from fusion.buffer.plain import plain
from fusion.checks.silence import SILENT_NS
from fusion.config import FusionConfig
from fusion.filter import YawFilter
from fusion.samples import YawEstimate
from fusion.state.ekf import DIM, Array, Correction, Transition
from fusion.state.estimate import estimate_of
from fusion.state.filter_state import FilterState

LINEAR = 1e-4  # of a variance; what the filter's second-order terms leave of it is not known better
SEGMENT = 1000  # events whose matrices are kept at a time; their states are filtered twice


@dataclass(slots=True)
class Adjoint:
    """What the measurements after a time say of the state at it.

    Attributes
    ----------
    l, L : numpy.ndarray
        (DIM,) and (DIM, DIM), see the module.
    confirmed : bool
        Whether two sensors agreed the next time that they were compared: then the yaw is not owed to one of them only.
    imaged : bool
        Whether an image that the gate accepts comes after: what one before it contradicted is then known.
    """

    l: Array  # noqa: E741 - the literature's lambda
    L: Array
    confirmed: bool = False
    imaged: bool = False

    @staticmethod
    def zero() -> Adjoint:
        """At the end nothing comes after."""
        return Adjoint(np.zeros(DIM), np.zeros((DIM, DIM)))

    def before(self, step: Transition | Correction) -> Adjoint:
        """The adjoint before a step of the filter, this one holding after it."""
        if isinstance(step, Transition):
            return replace(self, l=step.F.T @ self.l, L=step.F.T @ self.L @ step.F)
        H = step.H[0]
        A = np.eye(DIM) - np.outer(step.K[:, 0], step.H_after[0])
        weighted = H / step.S
        l = A.T @ self.l - weighted * step.innovation  # noqa: E741
        return replace(self, l=l, L=A.T @ self.L @ A + np.outer(H, weighted))

    def between(self, before: FilterState, after: FilterState) -> Adjoint:
        """The adjoint with what an event says of who agrees, by the states before and after it."""
        confirmed = self.confirmed
        if after.unconfirmed is not None and after.unconfirmed.since.t_ns == after.t_ns:
            confirmed = not after.isolation.undecided
        if not before.isolation.contradicting >= after.isolation.contradicting:
            confirmed = False
        accepted = after.gates[Sensor.COMPASS].accepted_ns == after.t_ns
        return replace(self, confirmed=confirmed, imaged=self.imaged or accepted)

    def smoothed(self, state: FilterState) -> FilterState:
        """A state of the filter with what comes after it taken in."""
        P, since = state.P, state.unconfirmed
        if since is not None and self.confirmed and (state.t_ns or 0) - since.since.t_ns <= SILENT_NS:
            since = None
        smoothed = P - P @ self.L @ P
        np.fill_diagonal(smoothed, np.maximum(np.diagonal(smoothed), LINEAR * np.diagonal(P)))
        excess = state.image_excess if state.refusal or not self.imaged else 0.0
        return replace(state.at(state.x - P @ self.l, smoothed), unconfirmed=since, image_excess=excess, yaw_lead=0.0)


def ordered_events(samples: Iterable[Sample], config: FusionConfig) -> list[FusionEvent]:
    """Usable samples, each once, and the references they need, in the filter's order."""
    events: dict[tuple[int | float, ...], FusionEvent] = {}
    for sample in samples:
        if sensor_of(sample) and fault_of(one := plain(sample)):
            continue
        event = event_of(one)
        events[event.order] = event
    before: dict[bool, YawIncrement] = {}
    first_order = min(events, default=())
    for event in sorted((e for e in events.values() if isinstance(e, CompassEvent)), key=attrgetter("order")):
        increment = event.sample
        first = event.order == first_order
        if first or needs_reference(increment, before.get(increment.long_baseline), config.reference_window * 1e9):
            reference = reference_of(increment)
            events[reference.order] = reference
        before[increment.long_baseline] = increment
    return [events[order] for order in sorted(events)]


def smooth(samples: Iterable[Sample], config: FusionConfig | None = None) -> list[YawEstimate]:
    """Estimate the yaw at every stamp from all samples, those before it and those after it.

    Parameters
    ----------
    samples : iterable of GyroSample, OdometrySample, YawIncrement
        In any order; unusable ones are left out.
    config : FusionConfig, optional
        Of the filter.

    Returns
    -------
    list of YawEstimate
        One per stamp at which anything was measured, in order; empty without samples.
    """
    config = config or FusionConfig()
    events = ordered_events(samples, config)
    filter_ = YawFilter(config)
    starts, state = [], filter_.start
    for number, event in enumerate(events):
        if number % SEGMENT == 0:
            starts.append(state)
        state = filter_.step(state, event)
    adjoint = Adjoint.zero()
    estimates: list[YawEstimate] = []
    for number in reversed(range(len(starts))):
        segment = events[number * SEGMENT : (number + 1) * SEGMENT]
        adjoint = _smooth_segment(filter_, starts[number], segment, adjoint, estimates)
    return estimates[::-1]


def _smooth_segment(
    filter_: YawFilter, state: FilterState, events: Sequence[FusionEvent], adjoint: Adjoint, out: list[YawEstimate]
) -> Adjoint:
    """Filter a segment again with all steps taped, go back through it, and append its estimates, last first."""
    taped = []
    for event in events:
        steps: list[Transition | Correction] = []
        before, state = state, filter_.step(state, event, steps)
        taped.append((before, state, steps))
    for before, after, steps in reversed(taped):
        if not out or out[-1].t_ns != after.t_ns:
            estimate = estimate_of(adjoint.smoothed(after))
            if estimate is not None:
                out.append(estimate)
        adjoint = adjoint.between(before, after)
        for step in reversed(steps):
            adjoint = adjoint.before(step)
    return adjoint
