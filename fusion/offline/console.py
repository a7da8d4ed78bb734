"""What people see: progress on a terminal, plain text elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from fusion.offline.streams import Progress

REFRESH_S = 0.1  # of a bar, at most so often


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Give a function that shows the finished part (0..1) with the time still needed, on a terminal only."""
    if not sys.stderr.isatty():
        yield lambda part: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    # without a thread of its own, which would leave no room for a fork (`compass_process`)
    with Progress(*columns, console=Console(stderr=True), transient=True, auto_refresh=False) as bar:
        task, due = bar.add_task(title, total=1.0), 0.0

        def show(part: float) -> None:
            nonlocal due
            now = time.monotonic()
            if now >= due or part >= 1.0:
                bar.update(task, completed=part, refresh=True)
                due = now + REFRESH_S

        yield show


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
