"""How much the command says: ``-v`` and ``--quiet``, before or after the name of any command."""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import click

from fusion.offline.atomic_output import OutputError


def _speak(level: int) -> Callable[[click.Context, click.Parameter, bool], None]:
    """What an option does that sets how much is said."""

    def choose(_context: click.Context, _option: click.Parameter, given: bool) -> None:
        if given:
            logging.getLogger().setLevel(level)

    return choose


class QuietCommand(click.Command):
    """A command that takes ``-v`` and ``--quiet``, as the group before it does."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for names, level, text in (
            (("-v", "--verbose"), logging.INFO, "Say what is being done."),
            (("-q", "--quiet"), logging.ERROR, "Say nothing but errors: no progress, no warnings, no tables."),
        ):
            callback = _speak(level)
            self.params.append(click.Option(names, is_flag=True, expose_value=False, callback=callback, help=text))


class QuietGroup(QuietCommand, click.Group):
    """Commands that all take them."""

    command_class = QuietCommand


@contextmanager
def anything_printable() -> Iterator[None]:
    """Let names be printed that the terminal's encoding does not have, as escapes, and all where nothing is open."""
    with ExitStack() as stack:
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:  # closed by who started the process
                setattr(sys, name, stack.enter_context(open(os.devnull, "w", encoding="utf-8")))
                stack.callback(setattr, sys, name, None)
            stream = getattr(sys, name)
            if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
                stream.reconfigure(errors="backslashreplace")
                stack.callback(_strict_again, stream)
        yield


def _strict_again(stream: io.TextIOWrapper) -> None:
    if not stream.closed:
        stream.reconfigure(errors="strict")


@contextmanager
def output_checked() -> Iterator[None]:
    """Tell in words that standard output takes nothing more: its disk is full. What it did not take is dropped.

    Raises
    ------
    OutputError
        It is so.
    """
    try:
        yield
    except OSError as error:
        if not _while_printing(error):
            raise
        with open(os.devnull, "w", encoding="utf-8") as nowhere, suppress(OSError, ValueError):
            os.dup2(nowhere.fileno(), sys.stdout.fileno())  # else the interpreter tries again as it ends, and complains
        why = error.strerror or type(error).__name__
        raise OutputError(f"standard output cannot be written: {why}; make room, or print elsewhere") from None


def _while_printing(error: OSError) -> bool:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and str(trace.tb_frame.f_globals.get("__name__")).startswith("click.")


def say(text: str) -> None:
    """Print what a command has to tell, unless ``--quiet``; plain results that were asked for are printed always."""
    if logging.getLogger().isEnabledFor(logging.WARNING):
        click.echo(text)
