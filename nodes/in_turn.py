"""One image at a time: what follows is played once the node is done with it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LONGEST_TURN_S = 60.0  # for one image: a node that needs longer has ended


class InTurn:
    """Lets what follows an image go once the node has told that it is done with it. Safe to use from any thread."""

    def __init__(self) -> None:
        self._free = threading.Event()
        self._free.set()

    def done(self) -> None:
        """The node is done with an image."""
        self._free.set()

    def begin(self) -> None:
        """An image is about to go."""
        self._free.clear()

    def wait(self, still: Callable[[], bool], longest: float = LONGEST_TURN_S) -> bool:
        """Wait until no image is under way, while `still`; False where the node does not tell for `longest` seconds."""
        end = time.monotonic() + longest
        while still() and not self._free.wait(0.1):
            if time.monotonic() > end:
                return False
        return True
