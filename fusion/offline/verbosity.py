"""How much the command says: ``-v`` and ``--quiet``, before or after the name of any command."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import click


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


def say(text: str) -> None:
    """Print what a command has to tell, unless ``--quiet``; plain results that were asked for are printed always."""
    if logging.getLogger().isEnabledFor(logging.WARNING):
        click.echo(text)
