"""When each warning of a run held."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fusion.checks.warnings import Warning, WarningLog

Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Warned:
    """A warning of a run.

    Attributes
    ----------
    warning : Warning
        As of the first time it came up, in its latest words.
    spans : tuple of (int, int)
        From when until when it held, ns; within the run, in the order of time.
    lasting : bool
        Whether it still held at the end.
    """

    warning: Warning
    spans: tuple[Span, ...]
    lasting: bool


class WarningHistory:
    """Takes down, time by time, what is wrong, and makes spans of it."""

    def __init__(self) -> None:
        self._log = WarningLog()
        self._open: dict[tuple[str, str], int] = {}  # since when those hold that hold at present
        self._closed: dict[tuple[str, str], list[Span]] = {}
        self._start_ns: int | None = None
        self._now_ns = 0

    def note(self, t_ns: int, warnings: Iterable[Warning]) -> tuple[Warning, ...]:
        """Take down what is wrong at `t_ns`, ns; returns that without what has yet to begin."""
        found = tuple(warnings)
        self._log.note(found)
        active = tuple(warning for warning in found if warning.since_ns <= t_ns)
        self._start_ns = t_ns if self._start_ns is None else self._start_ns
        self._now_ns = max(self._now_ns, t_ns)
        keys = {(warning.code, warning.sensor): warning.since_ns for warning in active}
        for key in self._open.keys() - keys.keys():
            self._closed.setdefault(key, []).append((self._open.pop(key), self._now_ns))
        for key in keys.keys() - self._open.keys():
            ended_ns = self._closed[key][-1][1] if key in self._closed else self._start_ns
            self._open[key] = max(keys[key], ended_ns)
        return active

    def finish(self, warnings: Iterable[Warning]) -> list[Warned]:
        """All of the run, most serious first, given what is wrong at its end.

        What never began within the run, because its time is that of another clock, held all the while.
        """
        self._log.note(warnings)
        start_ns = self._now_ns if self._start_ns is None else self._start_ns
        finished = []
        for warning in self._log.all():
            key = warning.code, warning.sensor
            spans = self._closed.get(key, []) + ([(self._open[key], self._now_ns)] if key in self._open else [])
            lasting = key in self._open or not spans
            finished.append(Warned(warning, tuple(spans or [(start_ns, self._now_ns)]), lasting))
        return finished
