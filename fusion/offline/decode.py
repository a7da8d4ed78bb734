"""Decode images ahead of the compass: OpenCV lets go of the interpreter's lock, so threads really work."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Raw = TypeVar("Raw")
Decoded = TypeVar("Decoded")


def decode_ahead(items: Iterable[Raw], decode: Callable[[Raw], Decoded], threads: int = 0) -> Iterator[Decoded]:
    """Apply `decode` to every item in `threads` threads (0: one per core, at most 4), results in order.

    Only a few items are under way at any time, so memory stays bounded; an exception of `decode` reaches the caller
    in its item's place.
    """
    threads = threads or min(os.cpu_count() or 1, 4)
    with ThreadPoolExecutor(threads, thread_name_prefix="decode") as pool:
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
