"""``visual-compass fuse`` of many recordings: each into its own folder, all in one table, one's fault no other's."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compass.files import is_folder, real
from fusion.offline.atomic_output import OutputError, refuse_unusable
from fusion.offline.bag_task import EARLIER, FAILED, FUSED, SKIPPED, BagOutcome, BagTask
from fusion.offline.batch_progress import BatchProgress, batch_progress
from fusion.offline.batch_table import CSV, PARQUET, check_tables, row_of, write_tables
from fusion.offline.earlier_results import EarlierResult, earlier_result
from fusion.offline.find_bags import name_folders, names_in, results_in
from fusion.offline.report.page import FILE as REPORT
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BatchResult:
    """What became of all: outcomes in the order of the recordings, summaries left out, and the tables of them."""

    outcomes: list[BagOutcome]
    tables: list[Path]

    @property
    def failed(self) -> int:
        """How many failed."""
        return sum(one.status == FAILED for one in self.outcomes)

    def __str__(self) -> str:
        """One line: how many fared how, and where all of it is."""
        return f"{counted(self.outcomes)}; {', '.join(map(str, self.tables))}"


def fuse_bags(
    bags: Sequence[str],
    out: Path,
    settings: Settings,
    request: TopicRequest | None = None,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    force: bool = False,
    inputs: Sequence[Path] = (),
    report: bool = False,
    rerun: bool = False,
) -> BatchResult:
    """Fuse many recordings; those that are finished, by content and settings, are skipped.

    Parameters
    ----------
    bags : sequence of str
        Absolute paths and URLs, see `find_bags`.
    out : Path
        Where the folders of the results and the tables go.
    settings, request, force, inputs, report, rerun
        See `fuse_bag`.
    jobs : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do it instead.

    Raises
    ------
    VisualCompassError
        `out` cannot be used, or no scheduler answers. What is wrong with one recording is in its outcome.
    """
    existed = is_folder(out)
    there = results_in(out) if existed else {}
    _check_out(out, there, force=force)
    check_tables(out, force=force)
    refuse_unusable(out)
    place = real(out)
    names = name_folders(bags, there)
    given = settings, request or TopicRequest(), force, tuple(map(real, inputs)), report, rerun
    tasks = [BagTask(bag, place / names[bag], *given) for bag in bags]
    outcomes: dict[str, BagOutcome] = {}
    rows: dict[str, dict[str, Any]] = {}
    try:
        with batch_progress(len(tasks)) as progress:
            for outcome in _run(tasks, jobs, scheduler, progress):
                progress.end(outcome)
                rows[outcome.bag] = row_of(outcome, place)
                outcomes[outcome.bag] = replace(outcome, summary={})  # of a hundred thousand that would be a lot
        tables = _write(place, bags, rows)
    except BaseException as error:
        if any(one.status != FAILED for one in outcomes.values()):
            _write(place, bags, rows)
            error.left = "what is finished stays, the same command goes on with the rest"  # type: ignore[attr-defined]
        elif not existed:
            with suppress(OSError):  # not empty
                place.rmdir()
        raise
    return BatchResult([outcomes[bag] for bag in bags], [out / table.name for table in tables])


def _run(tasks: Sequence[BagTask], jobs: int, scheduler: str | None, progress: BatchProgress) -> Iterator[BagOutcome]:
    if scheduler is not None:
        from fusion.offline.cluster import run_on_cluster

        return run_on_cluster(tasks, scheduler)
    from fusion.offline.worker_pool import run_in_processes

    return run_in_processes(tasks, jobs, progress.part)


def _check_out(out: Path, there: dict[str, EarlierResult | None], *, force: bool) -> None:
    """Refuse a folder that is full of other things, in which nobody wants hundreds; unless one stands in it."""
    others = there.keys() - {CSV, PARQUET, REPORT}
    if others and not force and not any(there.values()) and real(out) != Path.cwd():
        raise OutputError(f"{out}: is not empty and holds no earlier results; give another --out, or --force")


def _write(place: Path, bags: Sequence[str], rows: dict[str, dict[str, Any]]) -> list[Path]:
    """The tables of all results that are there: of these recordings, in their order, and of others of earlier runs."""
    ours = {row["folder"] for row in rows.values()}
    others = (name for name in names_in(place) if name not in ours)
    earlier = [
        row_of(BagOutcome(one.source.path, place / name, EARLIER, summary=one.summary), place)
        for name in others
        if (one := earlier_result(place / name)) is not None
    ]
    return write_tables(place, [rows[bag] for bag in bags if bag in rows] + earlier)


def counted(outcomes: Sequence[BagOutcome]) -> str:
    """``20 bags: 17 fused, 2 skipped, 1 failed``."""
    counts = Counter(outcome.status for outcome in outcomes)
    parts = [f"{counts[status]} {status}" for status in (FUSED, SKIPPED, FAILED) if counts[status]]
    return f"{len(outcomes)} bag{'s' * (len(outcomes) != 1)}: {', '.join(parts) or 'none finished'}"
