"""Say once what is wrong, count how often."""

from __future__ import annotations

import re
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from typing import TypeVar

from rclpy.node import Node

from compass.errors import VisualCompassError
from fusion import Warning
from fusion.checks.warnings import WarningLog

Message = TypeVar("Message")

REPEAT_S = 30.0  # a fault that lasts is said again after this long
_LONGEST = 400  # characters of a line
_VARYING = r"'[^']*'|(?<!\w)-?\d[\d.e+-]*(?!\w)"  # quoted names and numbers, but not the 8 of bgr8
_MOST_KINDS = 50  # what a topic carries must not fill the memory


class ThrottledLog:
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
        Faults so far by kind: the message without its remedy, its numbers and quoted names taken out.
    """

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._say = say
        self._clock = clock
        self._said: dict[str, float] = {}
        self._lock = threading.Lock()
        self.counts: Counter[str] = Counter()

    def __call__(self, where: str, fault: Exception | str) -> None:
        """Count a fault of the stream `where`, and log it unless that was done lately."""
        kind = f"{where}: " + re.sub(_VARYING, "*", str(fault).split(";")[0])[:100]
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
            return {
                kind.replace(f"{where}: ", "fault: ", 1): str(count)
                for kind, count in self.counts.items()
                if kind.startswith(f"{where}: ")
            }


class WarningLogger:
    """Says each warning once, when it first comes up."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say
        self._log = WarningLog()

    def __call__(self, warnings: Iterable[Warning]) -> None:
        """Say those that are new."""
        for warning in self._log.note(warnings):
            self._say(f"{' '.join(warning.text.split())} [{warning.code}, {warning.sensor}]")

    def clear(self) -> None:
        """Forget what was said."""
        self._log.clear()


def surviving(
    node: Node, topic: str, log: ThrottledLog, receive: Callable[[Message], object]
) -> Callable[[Message], None]:
    """`receive`, such that nothing a message carries can end the node or the thread: it is a complaint instead."""

    def survive(message: Message) -> None:
        try:
            receive(message)
        except VisualCompassError as error:
            log(topic, error)
        except Exception as error:
            if node.context.ok():  # else a publisher lost its context: the node is about to end
                node.get_logger().debug(traceback.format_exc())
                log(topic, f"unexpected {error!r}")

    return survive
