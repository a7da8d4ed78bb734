"""Replay buffer: events in the order of their stamps, whatever the order of their arrival.

It keeps the events of the last `window`, and states between them. An event that comes late is put in its place, and
what followed is replayed from the last state kept before it: exact for any delay within the window, unlike one-step
formulas for out-of-sequence measurements (Bar-Shalom 2002, doi:10.1109/TAES.2002.1039398).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from enum import Enum
from typing import Generic, Protocol, TypeVar


class Event(Protocol):
    """Anything with a stamp and a place in a total order."""

    @property
    def t_ns(self) -> int:
        """Stamp, ns."""

    @property
    def order(self) -> tuple[int | float, ...]:
        """Sorts events, first by stamp; equal only for duplicates."""


# Not derived: `RECENT`, `SPACING`. States are what fills a processor's cache.
RECENT = 32  # of the newest events the state after each is kept: 0.1 s of a robot's sensors, by which images come late
SPACING = 8  # of those before, the state after every eighth
BATCH = 72  # events at least that are forgotten together: deleting from the front moves the rest

E = TypeVar("E", bound=Event)
S = TypeVar("S")


class Arrival(Enum):
    """What became of an event on arrival."""

    APPENDED = "newest"
    LATE = "put in its place, what followed replayed"
    DUPLICATE = "known already"
    TOO_OLD = "older than the window"


class Timeline(Generic[E, S]):
    """Applies events in the order of their stamps.

    Parameters
    ----------
    start : S
        State before any event.
    step : callable
        ``step(state, event) -> state``; must leave the state it is given unchanged.
    window_ns : int
        How far behind the newest event another may come.
    """

    def __init__(self, start: S, step: Callable[[S, E], S], window_ns: int) -> None:
        self._base = start
        self._step = step
        self._window_ns = window_ns
        self._orders: list[tuple[int | float, ...]] = []
        self._events: list[E] = []
        self._states: list[S | None] = []  # after each event, where it is kept
        self._newest_ns: int | None = None

    @property
    def state(self) -> S:
        """State after the newest event."""
        newest = self._states[-1] if self._states else None
        return self._base if newest is None else newest

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest event, ns; None before the first."""
        return self._newest_ns

    def __len__(self) -> int:
        return len(self._events)

    def holds(self, event: E) -> bool:
        """Whether the very same event is in it already."""
        if self._newest_ns is None or event.t_ns > self._newest_ns:
            return False
        place = bisect_left(self._orders, event.order)
        return place < len(self._orders) and self._orders[place] == event.order

    def after(self, t_ns: int) -> list[E]:
        """The events later than `t_ns`, ns."""
        return self._events[bisect_left(self._orders, (t_ns + 1,)) :]

    def add(self, event: E, *others: E) -> Arrival:
        """Apply an event at its own time, and others at theirs; what follows is replayed once.

        What became of the event is returned; `others` are put in their places before it, where they fit.
        """
        arrivals = [self._insert(one) for one in (*others, event)]
        changed = [place for place in arrivals if isinstance(place, int)]
        if changed:
            self._replay(min(changed))
            self._newest_ns = self._events[-1].t_ns
        last = arrivals[-1]
        if isinstance(last, int):
            last = Arrival.LATE if last < len(self._events) - 1 else Arrival.APPENDED
        if changed:
            self._forget()
        return last

    def _insert(self, event: E) -> int | Arrival:
        """Put an event in its place, which is returned; or why it has none."""
        if self._newest_ns is not None and event.t_ns < self._newest_ns - self._window_ns:
            return Arrival.TOO_OLD
        order, place = event.order, len(self._orders)
        if place and order <= self._orders[-1]:
            place = bisect_left(self._orders, order)
            if self._orders[place] == order:
                return Arrival.DUPLICATE
        self._orders.insert(place, order)
        self._events.insert(place, event)
        return place

    def _replay(self, place: int) -> None:
        """Step anew through the events from a place on."""
        states = self._states
        while place and states[place - 1] is None:
            place -= 1
        del states[place:]
        state = self.state
        for event in self._events[place:]:
            state = self._step(state, event)
            states.append(state)
            if len(states) > RECENT and (len(states) - RECENT) % SPACING:
                states[-RECENT - 1] = None

    def _forget(self) -> None:
        """Drop events that have left the window; the state after them is what a replay starts from."""
        first_ns = self._events[-1].t_ns - self._window_ns
        if len(self._events) < BATCH or self._events[BATCH - 1].t_ns >= first_ns:
            return
        count = bisect_left(self._orders, (first_ns,))
        count -= count % SPACING
        base = self._states[count - 1]
        if base is not None:
            self._base = base
            del self._orders[:count], self._events[:count], self._states[:count]
