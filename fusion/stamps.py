"""Which stamps to believe: a sample far ahead of all others waits until another one confirms it.

Believed at once, one wrong stamp would make everything after it too old.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from fusion.events import Sample, sensor_of

CONFIRMED_NS = 200_000_000  # a sensor that goes on for so long while no other objects needs no second one
MOST_WAITING = 1000


@dataclass(frozen=True, slots=True)
class Waiting:
    """A sample that waits; `until_ns` is how far the others may go on before it is given up.

    `contradicted` says that since it came another sample was no such way ahead.
    """

    sample: Sample
    until_ns: int
    contradicted: bool = False


class FarAhead:
    """The samples that wait.

    Parameters
    ----------
    reach_ns : int
        How far ahead of the newest sample another may be without waiting.
    patience_ns : int
        How far the others may go on before a sample is given up; those it waits for may come late.
    """

    def __init__(self, reach_ns: int, patience_ns: int) -> None:
        self._reach_ns = reach_ns
        self._patience_ns = patience_ns
        self._waiting: list[Waiting] = []

    def add(self, sample: Sample, newest_ns: int) -> list[Sample]:
        """Let a sample wait; if it and some before it confirm each other, they leave, in the order of their stamps."""
        self._waiting.append(Waiting(sample, newest_ns + self._patience_ns))
        del self._waiting[:-MOST_WAITING]
        unopposed = sorted((w.sample for w in self._waiting if not w.contradicted), key=lambda s: s.t_ns)
        group = self._neighbours(unopposed, sample)
        if not confirmed(group):
            return []
        return self._leave(group)

    def reached(self, newest_ns: int) -> list[Sample]:
        """Note that a sample came that was not far ahead; those it has caught up with leave."""
        if not self._waiting:
            return []
        caught = [w.sample for w in self._waiting if w.sample.t_ns <= newest_ns + self._reach_ns]
        self._waiting = [replace(w, contradicted=True) for w in self._waiting if w.until_ns >= newest_ns]
        return self._leave(sorted(caught, key=lambda s: s.t_ns))

    def _neighbours(self, ordered: Sequence[Sample], sample: Sample) -> list[Sample]:
        """Those joined with `sample` by gaps no longer than the reach."""
        group: list[Sample] = []
        for one in ordered:
            if group and one.t_ns - group[-1].t_ns > self._reach_ns:
                if group[-1].t_ns >= sample.t_ns:
                    break
                group = []
            group.append(one)
        return group

    def _leave(self, group: list[Sample]) -> list[Sample]:
        """Let a group go that need not wait any longer."""
        leaving = {id(sample) for sample in group}
        self._waiting = [w for w in self._waiting if id(w.sample) not in leaving]
        return group


def confirmed(samples: Iterable[Sample]) -> bool:
    """Whether samples near each other are of two sensors, or go on for long enough."""
    stamps = [(sample.t_ns, sensor_of(sample)) for sample in samples]
    span_ns = max(t for t, _ in stamps) - min(t for t, _ in stamps)
    return span_ns >= CONFIRMED_NS or len({sensor for _, sensor in stamps}) > 1
