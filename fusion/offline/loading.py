"""Libraries loaded in a thread: a process that waits for another one need not wait for them as well."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from threading import Event, Thread


def load_in_turn(*modules: str) -> Callable[[], bool]:
    """Begin to import modules; gives a function that says whether the first one is still being imported.

    What fails is left to whoever imports it in earnest.
    """
    first_is_there = Event()

    def load() -> None:
        for name in modules:
            with suppress(Exception):
                import_module(name)
            first_is_there.set()

    Thread(target=load, name="loading").start()
    return lambda: not first_is_there.is_set()
