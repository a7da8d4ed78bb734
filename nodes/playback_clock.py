"""When a recorded message is due: bag time against wall time, at any rate, with pauses. No ROS in here."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class PlaybackClock:
    """Maps wall time to bag time. Safe to use from any thread.

    Parameters
    ----------
    rate : float
        Seconds of the bag per second of wall time.
    clock : callable
        Monotonic seconds.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._rate = rate
        self._paused = False
        self._changed = threading.Condition()
        self._anchor = (clock(), 0)  # wall time, s, and the bag time then, ns

    @property
    def paused(self) -> bool:
        """Whether bag time stands still."""
        return self._paused

    def start(self, bag_ns: int) -> None:
        """Let bag time be `bag_ns` now."""
        with self._changed:
            self._anchor = (self._clock(), bag_ns)

    def now_ns(self) -> int:
        """Bag time, ns."""
        with self._changed:
            return self._now_ns()

    def set_rate(self, rate: float) -> None:
        """Go on from here at another rate."""
        with self._changed:
            self._anchor = (self._clock(), self._now_ns())
            self._rate = rate
            self._changed.notify_all()

    def pause(self, paused: bool) -> None:
        """Stop bag time, or let it go on."""
        with self._changed:
            self._anchor = (self._clock(), self._now_ns())
            self._paused = paused
            self._changed.notify_all()

    def wait(self, bag_ns: int, at_most: float) -> bool:
        """Wait until bag time reaches `bag_ns`, but no longer than `at_most` seconds; True if it was reached."""
        with self._changed:
            missing_ns = bag_ns - self._now_ns()
            if missing_ns <= 0 and not self._paused:
                return True
            wall = at_most if self._paused else min(at_most, missing_ns * 1e-9 / self._rate)
            self._changed.wait(wall)
            return not self._paused and self._now_ns() >= bag_ns

    def _now_ns(self) -> int:
        since, bag_ns = self._anchor
        return bag_ns if self._paused else bag_ns + round((self._clock() - since) * 1e9 * self._rate)
