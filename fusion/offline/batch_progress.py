"""How a run over many recordings is going: bars on a terminal, lines elsewhere, failures at once."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from fusion.offline.bag_task import FAILED, BagOutcome, BagTask
from fusion.offline.console import LINE_EVERY_S, duration

log = logging.getLogger(__name__)


class BatchProgress(Protocol):
    """What is shown of a run."""

    def part(self, task: BagTask, part: float) -> None:
        """A recording is finished by this part, 0..1."""

    def end(self, outcome: BagOutcome) -> None:
        """A recording is done with."""


@contextmanager
def batch_progress(total: int) -> Iterator[BatchProgress]:
    """Show how far `total` recordings are; failures alone where only errors are to be shown."""
    if not log.isEnabledFor(logging.WARNING):
        yield Lines(total, every_s=float("inf"))
    elif not sys.stderr.isatty():
        yield Lines(total)
    else:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
            yield Bars(bars, total)


def _told(outcome: BagOutcome) -> list[str]:
    """What is shown of a recording at once: that it failed, or, for whoever wants it, how it ended."""
    if outcome.status == FAILED:
        trace = outcome.trace.splitlines() if log.isEnabledFor(logging.INFO) else []
        return [f"failed: {outcome.error}", *trace]
    if not log.isEnabledFor(logging.INFO):
        return []
    fused = outcome.summary.get("yaw", {}).get("fused", {})
    turned = "".join(f", turned {fused['turned_deg']:.2f} deg" for _ in range(fused.get("turned_deg") is not None))
    return [f"{outcome.status}: {outcome.bag} in {outcome.seconds:.1f} s{turned}"]


class Lines:
    """Lines on standard error: one now and then, and one for each failure.

    Parameters
    ----------
    total : int
        Number of recordings.
    every_s : float
        Between two lines of progress, s.
    clock : callable
        Gives seconds that only increase.
    """

    def __init__(self, total: int, every_s: float = LINE_EVERY_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._every_s, self._clock = total, every_s, clock
        self._start = self._last = clock()
        self._done = self._failed = 0
        self._parts: dict[str, float] = {}

    def part(self, task: BagTask, part: float) -> None:
        """Note it, and tell if it is time to."""
        self._parts[task.bag] = part
        self._tell()

    def _tell(self) -> None:
        now = self._clock()
        if now - self._last < self._every_s:
            return
        self._last = now
        done = (self._done + sum(self._parts.values())) / self._total
        left = f", {duration((now - self._start) * (1.0 / done - 1.0))} left" if done > 0.0 else ""
        failed = f", {self._failed} failed" if self._failed else ""
        print(f"{self._done} of {self._total} bags{failed}{left}", file=sys.stderr, flush=True)

    def end(self, outcome: BagOutcome) -> None:
        """Count it, and tell a failure."""
        self._parts.pop(outcome.bag, None)
        self._done += 1
        self._failed += outcome.status == FAILED
        for line in _told(outcome):
            print(line, file=sys.stderr, flush=True)
        self._tell()


class Bars:
    """A bar for all, and one for each recording that is being fused."""

    def __init__(self, bars: Any, total: int) -> None:
        self._bars = bars
        self._all = bars.add_task("bags", total=total)
        self._of: dict[str, Any] = {}

    def part(self, task: BagTask, part: float) -> None:
        """Move its bar."""
        if task.bag not in self._of:
            self._of[task.bag] = self._bars.add_task(task.folder.name, total=100)
        self._bars.update(self._of[task.bag], completed=round(100 * part))

    def end(self, outcome: BagOutcome) -> None:
        """Take its bar away."""
        if outcome.bag in self._of:
            self._bars.remove_task(self._of.pop(outcome.bag))
        self._bars.advance(self._all)
        for line in _told(outcome):
            self._bars.console.print(line, markup=False, highlight=False, soft_wrap=True)
