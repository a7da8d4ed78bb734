"""One recording of many: fused unless it is already, whatever happens is in the outcome. Runs in any process."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from compass.errors import VisualCompassError
from compass.version import __version__
from fusion.offline.earlier_results import ALWAYS, EarlierResult, earlier_result, settings_hash
from fusion.offline.fuse_bag import fuse_bag, settings_as_used
from fusion.offline.remote import is_url, local_copy, remote_source
from fusion.offline.report.page import FILE as REPORT
from fusion.offline.rerun_export import FILE as RERUN
from fusion.offline.source import Source, source_of
from fusion.offline.streams import Progress
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings

FUSED, SKIPPED, FAILED, EARLIER = "fused", "skipped", "failed", "earlier"


@dataclass(frozen=True, slots=True)
class BagTask:
    """What is to be done with a recording.

    Attributes
    ----------
    bag : str
        Absolute path or URL.
    folder : Path
        For its results; absolute.
    settings, request
        How to fuse it.
    force : bool
        See `fuse_bag`.
    inputs, report, rerun
        See `fuse_bag`.
    version : str
        Of the package that made the task: another one would give other results.
    """

    bag: str
    folder: Path
    settings: Settings
    request: TopicRequest
    force: bool = False
    inputs: tuple[Path, ...] = ()
    report: bool = False
    rerun: bool = False
    version: str = __version__


@dataclass(frozen=True, slots=True)
class BagOutcome:
    """What became of a recording.

    Attributes
    ----------
    bag : str
        Absolute path or URL.
    folder : Path
        Of its results.
    status : str
        ``"fused"``, ``"skipped"`` (finished before), ``"failed"``, or ``"earlier"`` (results of another run).
    error : str
        Why it failed, in one line.
    seconds : float
        Wall clock that it took.
    summary : dict
        As in summary.json; empty where it failed.
    trace : str
        Of an error that nobody foresaw.
    """

    bag: str
    folder: Path
    status: str
    error: str = ""
    seconds: float = 0.0
    summary: dict[str, Any] = field(default_factory=dict)
    trace: str = ""


def run_task(task: BagTask, progress: Progress = lambda part: None) -> BagOutcome:
    """Fuse a recording; what goes wrong with it ends in its outcome, as others wait."""
    begin = time.monotonic()
    cv2.setNumThreads(1)  # as many processes as cores are at work

    def outcome(status: str, **facts: Any) -> BagOutcome:
        return BagOutcome(task.bag, task.folder, status, seconds=time.monotonic() - begin, **facts)

    try:
        if task.version != __version__:
            raise VisualCompassError(f"{task.bag}: the worker has visual-compass {__version__}, not {task.version}")
        done = _by_its_settings(task)
        if done and done.is_of(_source(task.bag)):
            return outcome(SKIPPED, summary=done.summary)
        with _on_disk(task.bag) as path:
            if done and is_url(task.bag) and done.is_of(source_of(path)):  # a folder, or of a server without parts
                return outcome(SKIPPED, summary=done.summary)
            fused = fuse_bag(
                path,
                task.folder,
                task.settings,
                task.request,
                force=task.force,
                inputs=task.inputs,
                known_as=task.bag,
                progress=progress,
                report=task.report,
                rerun=task.rerun,
                two_processes=False,  # the others have the other cores
            )
        return outcome(FUSED, summary=fused.summary)
    except VisualCompassError as error:
        return outcome(FAILED, error=" ".join(str(error).split()))
    except Exception as error:
        words = " ".join(str(error).split())
        return outcome(FAILED, error=f"{task.bag}: {type(error).__name__}: {words}", trace=traceback.format_exc())


def _by_its_settings(task: BagTask) -> EarlierResult | None:
    """The results of any recording in the folder, if they are complete and by these settings."""
    earlier = earlier_result(task.folder)
    if earlier is None or earlier.settings_hash != settings_hash(settings_as_used(task.settings, task.request)):
        return None
    wanted = [name for name, asked in ((REPORT, task.report), (RERUN, task.rerun)) if asked]
    return earlier if all((task.folder / name).is_file() for name in (*ALWAYS, *wanted)) else None


def _source(bag: str) -> Source | None:
    return remote_source(bag) if is_url(bag) else source_of(Path(bag))


@contextmanager
def _on_disk(bag: str) -> Iterator[Path]:
    if is_url(bag):
        with local_copy(bag) as copy:
            yield copy
    else:
        yield Path(bag)
