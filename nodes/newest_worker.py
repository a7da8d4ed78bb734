"""Images in a thread of their own: the newest is worked on, the rest is dropped and counted; or each in its turn."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class NewestWorker(Generic[Item]):
    """A thread that works on the newest items; one that is overtaken before its turn is dropped.

    Parameters
    ----------
    work : callable
        Called with one item at a time, in the worker's thread; must not raise.
    name : str
        Of the thread.
    room : int
        How many may wait; the oldest of more is dropped.

    Attributes
    ----------
    dropped : int
        Items overtaken so far.
    """

    def __init__(self, work: Callable[[Item], None], name: str, room: int = 1) -> None:
        self._work = work
        self._waiting: deque[Item] = deque(maxlen=room)
        self._open = True
        self._changed = threading.Condition()
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Hand over an item; returns at once."""
        with self._changed:
            self.dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(item)
            self._changed.notify()

    def close(self, timeout: float = 1.0) -> None:
        """Let the item in work be finished and end the thread; gives up after `timeout` seconds."""
        with self._changed:
            self._open = False
            self._changed.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or not self._open)
                if not self._open:
                    return
                item = self._waiting.popleft()
            self._work(item)
