"""Ctrl-C and SIGTERM as an exception that unwinds the stack, so that temporary files go."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupted(BaseException):
    """Ctrl-C or SIGTERM; not `KeyboardInterrupt`, after which the interpreter may end by the signal all the same."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.left = "nothing was written"


@contextmanager
def interruptible() -> Iterator[None]:
    """Let both signals unwind the stack, so that temporary files go."""

    def interrupt(number: int, frame: object) -> None:
        raise Interrupted(number)

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
