"""Ctrl-C and SIGTERM as an exception that unwinds the stack, so that temporary files go."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_AGAIN_S = 0.01  # longer than a callback takes, shorter than a user notices


class Interrupted(BaseException):
    """Ctrl-C or SIGTERM; not `KeyboardInterrupt`, after which the interpreter may end by the signal all the same."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.left = "nothing was written"


@contextmanager
def interruptible() -> Iterator[None]:
    """Let both signals unwind the stack, so that temporary files go.

    Python ignores what is raised in a destructor or in the callback of a weak reference, also where a signal raised it:
    while a library is imported, such a callback runs for every module. What it ignores is raised again soon after, by
    the timer of SIGALRM.
    """

    def interrupt(number: int, frame: object) -> None:
        raise Interrupted(number)

    def ignored(what: UnraisableHookArgs) -> None:
        if not isinstance(what.exc_value, Interrupted):
            hook_before(what)
            return
        number = what.exc_value.number
        signal.signal(signal.SIGALRM, lambda _, frame: interrupt(number, frame))
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)

    hook_before = sys.unraisablehook
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    sys.unraisablehook = ignored
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = hook_before
        for number, handler in before.items():
            signal.signal(number, handler)
