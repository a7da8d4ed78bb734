"""Files that appear complete or not at all: written beside their place under a hidden name, then moved.

A process that is killed leaves its hidden folder. Each is locked as long as its process lives, so the next run for the
same place can tell what is left behind, and removes it.
"""

from __future__ import annotations

import logging
import os
import re
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from compass.errors import VisualCompassError

log = logging.getLogger(__name__)

_SCRATCH = "visual-compass"  # what bags are made readable in, in the folder for temporary files


class OutputError(VisualCompassError):
    """Results cannot be written where they are wanted."""


@contextmanager
def staged_folder(target: Path, ours: Sequence[str] = ()) -> Iterator[Path]:
    """Give a folder to write into; on success its content takes the place of `target`'s, else nothing changes.

    An existing `target` keeps what is not among the results: each file is replaced on its own, in one step. Files
    named in `ours` are results as well, of an earlier run, and go where this one has none of that name.

    Raises
    ------
    OutputError
        `target` is no folder, or its place cannot be written to.
    """
    if target.exists() and not target.is_dir():
        raise OutputError(f"{target}: is no folder; give another --out")
    with _staging(target) as staging:
        yield staging
        stale = [name for name in ours if not (staging / name).exists()]
        if target.exists():
            for file in sorted(staging.iterdir()):
                file.replace(target / file.name)
            for name in stale:
                (target / name).unlink(missing_ok=True)
        else:
            staging.replace(target)


@contextmanager
def staged_file(target: Path) -> Iterator[Path]:
    """Give a path to write a file (or a new folder) at; on success it moves to `target`, else nothing changes.

    Raises
    ------
    OutputError
        `target` is a folder, or its place cannot be written to.
    """
    if target.is_dir():
        raise OutputError(f"{target}: is a folder that exists already; give another --out")
    with _staging(target) as staging:
        yield staging / target.name
        (staging / target.name).replace(target)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Give a folder for temporary files that nobody else can read, gone afterwards."""
    parent = Path(tempfile.gettempdir())
    with _locked_folder(parent, _SCRATCH, 0o700) as folder:
        yield folder


@contextmanager
def _staging(target: Path) -> Iterator[Path]:
    """A hidden folder beside `target`, gone afterwards."""
    staging: Path | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _locked_folder(target.parent, target.name, 0o777) as staging:
            yield staging
    except OSError as error:
        if staging is None or error.filename is None or Path(error.filename).is_relative_to(staging):
            raise OutputError(
                f"{target}: cannot be written: {error.strerror}; make room or give another --out"
            ) from error
        raise


@contextmanager
def _locked_folder(parent: Path, name: str, mode: int) -> Iterator[Path]:
    """A new hidden folder in `parent`, locked and gone afterwards; what dead processes left of that name goes first."""
    _remove_leftovers(parent, name)
    while True:
        folder = parent / f".{name}.{secrets.token_hex(8)}.part"  # known before it is there, should one interrupt
        lock = None
        try:
            folder.mkdir(mode)
            lock = _lock(folder, wait=True)
            if folder.exists():  # else another process took it for a leftover before it was locked
                yield folder
                return
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            if lock is not None:
                os.close(lock)


def _remove_leftovers(parent: Path, name: str) -> None:
    """Remove the hidden folders of that name which no living process holds."""
    pattern = re.compile(rf"\.{re.escape(name)}\.[0-9a-f]{{16}}\.part")
    try:
        found = [entry for entry in parent.iterdir() if pattern.fullmatch(entry.name)]
    except OSError:
        return
    for folder in found:
        lock = _lock(folder, wait=False)
        if lock is not None:
            log.info("%s: left by a run that was killed; removed", folder)
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)


def _lock(folder: Path, *, wait: bool) -> int | None:
    """Lock a folder until the descriptor is closed or the process ends; None where that cannot be done.

    It cannot where another process holds the lock, and on file systems and operating systems without such locks:
    there nothing is ever taken for a leftover.
    """
    if sys.platform == "win32":
        return None
    import fcntl

    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor
