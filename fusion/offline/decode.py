"""Decode images ahead of the compass: OpenCV lets go of the interpreter's lock, so threads really work."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

Raw = TypeVar("Raw")
Decoded = TypeVar("Decoded")

# What is added to the nice value of a thread that decodes: two of them then weigh as much as one other thread (Linux
# weighs 526 against 1024). The compass has the most to do, and while it waits for a core that decodes ahead, all wait
# for it in the end (docs/lab-notes/speed-2026-11-30.md).
NICER = 3


def decode_ahead(items: Iterable[Raw], decode: Callable[[Raw], Decoded], threads: int = 0) -> Iterator[Decoded]:
    """Apply `decode` to every item in `threads` threads (0: one per core, at most 4), results in order.

    Only a few items are under way at any time, so memory stays bounded; an exception of `decode` reaches the caller
    in its item's place.
    """
    threads = threads or min(os.cpu_count() or 1, 4)
    with ThreadPoolExecutor(threads, thread_name_prefix="decode", initializer=_give_way) as pool:
        under_way: deque[Future[Decoded]] = deque()
        try:
            for item in items:
                under_way.append(pool.submit(decode, item))
                if len(under_way) > 2 * threads:
                    yield under_way.popleft().result()
            while under_way:
                yield under_way.popleft().result()
        finally:
            for future in under_way:
                future.cancel()


def _give_way() -> None:
    """In a thread: let others go first where cores are short."""
    if sys.platform == "linux":  # elsewhere it would be the whole process
        with suppress(OSError):  # a sandbox may forbid it
            os.nice(NICER)
