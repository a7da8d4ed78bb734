"""Say once what is wrong, count how often."""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable

REPEAT_S = 30.0  # a fault that lasts is said again after this long
_LONGEST = 400  # characters of a line
_MOST_KINDS = 50  # what a topic carries must not fill the memory


class Complaints:
    """Counts faults by kind and logs each kind at most every `REPEAT_S` seconds. Safe to use from any thread.

    Parameters
    ----------
    say : callable
        Takes the line to log.
    clock : callable
        Monotonic seconds.

    Attributes
    ----------
    counts : Counter of str
        Faults so far by kind: the message with its numbers and quoted names taken out.
    """

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._say = say
        self._clock = clock
        self._said: dict[str, float] = {}
        self._lock = threading.Lock()
        self.counts: Counter[str] = Counter()

    def __call__(self, where: str, fault: Exception | str) -> None:
        """Count a fault of the stream `where`, and log it unless that was done lately."""
        kind = f"{where}: " + re.sub(r"'[^']*'|-?\d[\d.e+-]*", "*", str(fault))[:100]
        with self._lock:
            if kind not in self.counts and len(self.counts) >= _MOST_KINDS:
                kind = f"{where}: other faults"
            self.counts[kind] += 1
            now = self._clock()
            silent = now - self._said.get(kind, -REPEAT_S) < REPEAT_S
            if not silent:
                self._said[kind] = now
            times = f" ({self.counts[kind]} times so far)" if self.counts[kind] > 1 else ""
        if not silent:
            self._say(f"{where}: {fault}"[:_LONGEST] + times)

    def figures(self, where: str) -> dict[str, str]:
        """Counts of the stream `where`, for the diagnostics."""
        with self._lock:
            return {f"fault: {kind}": str(n) for kind, n in self.counts.items() if kind.startswith(f"{where}: ")}
