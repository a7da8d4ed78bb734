"""What people see: progress on a terminal, plain text elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fusion.offline.streams import Progress

log = logging.getLogger(__name__)

LINE_EVERY_S = 60.0  # where there is no terminal
REFRESH_S = 0.1  # of a bar, at most so often


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Give a function that shows the finished part (0..1) and the time still needed; nothing where only errors show.

    A bar on a terminal; elsewhere, in a pipe or a log, a line once a minute.
    """
    if not log.isEnabledFor(logging.WARNING):
        yield lambda part: None
        return
    if not sys.stderr.isatty():
        yield MinuteLines(title)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    # without a thread of its own, which takes its turns from the work
    with Progress(*columns, console=Console(stderr=True), transient=True, auto_refresh=False) as bar:
        task, due = bar.add_task(title, total=1.0), 0.0

        def show(part: float) -> None:
            nonlocal due
            now = time.monotonic()
            if now >= due or part >= 1.0:
                bar.update(task, completed=part, refresh=True)
                due = now + REFRESH_S

        yield show


def shown_name(path: Path) -> str:
    """The name of a file for a line of text, whatever characters and bytes it is made of."""
    return "".join(letter if letter.isprintable() else "?" for letter in path.name)


class MinuteLines:
    """Progress in lines, one a minute, the first after one minute.

    Parameters
    ----------
    title : str
        How a line begins.
    clock : callable
        Gives seconds that only increase.
    """

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._title, self._clock = title, clock
        self._start = self._told = clock()

    def __call__(self, part: float) -> None:
        """Say what part is finished, 0..1, if it is time to."""
        now = self._clock()
        if now - self._told >= LINE_EVERY_S:
            self._told = now
            left = f", {duration((now - self._start) * (1.0 / part - 1.0))} left" if part > 0.0 else ""
            print(f"{self._title}: {100.0 * part:.0f} %{left}", file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """A time in its unit: s, min or h."""
    minutes, hours = round(seconds / 60.0), round(seconds / 3600.0)
    return f"{seconds:.0f} s" if seconds < 100 else f"{minutes} min" if minutes < 100 else f"{hours} h"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Text in columns: the first `left` ones flush left, the others flush right."""
    lines = [list(header), *(list(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(_line(line, widths, left) for line in lines)


def _line(cells: Sequence[str], widths: Sequence[int], left: int) -> str:
    padded = [
        cell.ljust(width) if column < left else cell.rjust(width)
        for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
    ]
    return "  ".join(padded).rstrip()
