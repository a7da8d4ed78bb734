"""Files that appear complete or not at all: written beside their place under a hidden name, then moved.

A process that is killed leaves its hidden folder. Each is locked as long as its process lives, so the next run for the
same place can tell what is left behind, and removes it. A folder is replaced as a whole, by two renames.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from compass.errors import VisualCompassError
from compass.files import is_folder, real

log = logging.getLogger(__name__)

_PART, _OLD = ".part", ".old"  # what is being written, and what it replaces for the moment
_SCRATCH = "visual-compass"  # what bags are made readable in, in the folder for temporary files


class OutputError(VisualCompassError):
    """Results cannot be written where they are wanted."""


@contextmanager
def staged_folder(target: Path, ours: Sequence[str] = ()) -> Iterator[Path]:
    """Give a folder to write into; on success it takes the place of `target` as a whole, else nothing changes.

    What is in an existing `target` and has no successor among the results is kept. Files named in `ours` are results
    as well, of an earlier run, and go where this one has none of that name.

    Raises
    ------
    OutputError
        `target` is no folder, or its place cannot be written to.
    """
    if os.path.exists(target) and not is_folder(target):
        raise OutputError(f"{target}: is no folder; give another --out")
    target = real(target)  # not a link is replaced, but what it leads to
    with _staging(target) as staging:
        yield staging
        if target.exists():
            try:
                _keep_others(target, staging, ours)
            except (OSError, shutil.Error) as error:
                why = getattr(error, "strerror", None) or str(error)
                raise OutputError(f"{target}: what else is in it cannot be kept: {why}; give another --out") from error
            _exchange(target, staging)
        else:
            staging.replace(target)


def _keep_others(target: Path, staging: Path, ours: Sequence[str]) -> None:
    """Bring all else that is in `target` into `staging`, too: by links, which cost nothing and lose nothing."""
    for entry in target.iterdir():
        successor = staging / entry.name
        if entry.name in ours or (successor.exists() and entry.is_file()):
            continue
        if successor.exists():
            raise OutputError(f"{entry}: is a folder where a result has to go; move it, or give another --out")
        if entry.is_dir() and not entry.is_symlink():
            shutil.copytree(entry, successor, symlinks=True, copy_function=_link)
        else:
            _link(str(entry), str(successor))


def _link(file: str, copy: str) -> None:
    """A further name for a file; a copy where the file system knows but one."""
    try:
        os.link(file, copy, follow_symlinks=False)
    except OSError:
        shutil.copy2(file, copy, follow_symlinks=False)


def _exchange(target: Path, staging: Path) -> None:
    """Put `staging` in the place of `target`, whose content it has or replaces; undone by whatever interrupts it."""
    old = staging.with_suffix(_OLD)
    lock = _lock(target, wait=True)  # held over the moment in which there is no `target`
    try:
        shutil.copymode(target, staging)
        target.rename(old)
        staging.rename(target)
    except OSError as error:
        raise OutputError(f"{target}: cannot be replaced: {error.strerror}; give another --out") from error
    finally:
        if not target.exists():
            old.rename(target)
        else:
            shutil.rmtree(old, ignore_errors=True)
        if lock is not None:
            os.close(lock)


@contextmanager
def staged_file(target: Path) -> Iterator[Path]:
    """Give a path to write a file (or a new folder) at; on success it moves to `target`, else nothing changes.

    Raises
    ------
    OutputError
        `target` is a folder, or its place cannot be written to.
    """
    if is_folder(target):
        raise OutputError(f"{target}: is a folder that exists already; give another --out")
    with _staging(target) as staging:
        yield staging / target.name
        (staging / target.name).replace(target)


def refuse_existing(
    target: Path | None, *, force: bool = False, begins: bytes | None = None, inputs: Iterable[Path | None] = ()
) -> None:
    """Refuse to replace a file that may be its user's own work.

    Parameters
    ----------
    target : Path or None
        Where to write; None: nowhere.
    force : bool
        Whether its user gave leave.
    begins : bytes, optional
        How such a file of an earlier run begins: that is replaced.
    inputs : iterable of Path or None
        What the run reads, files and folders: not replaced even by `force`.

    Raises
    ------
    OutputError
        There is another one.
    """
    if target is None or not os.path.lexists(target):
        return
    if any(real(read) in (real(target), real(target).parent) for read in inputs if read is not None):
        raise OutputError(f"{target}: is read by this command, and would be lost; give another name")
    if force:
        return
    if begins is not None and target.is_file():
        with contextlib.suppress(OSError), target.open("rb") as file:
            if file.read(len(begins)) == begins:
                return
    raise OutputError(f"{target}: exists already; give another name, or --force to replace it")


def refuse_unusable(folder: Path) -> None:
    """Refuse a folder for many results in which nothing can be written, before anything is done.

    Raises
    ------
    OutputError
        It is no folder, or cannot be made or written to.
    """
    if os.path.exists(folder) and not is_folder(folder):
        raise OutputError(f"{folder}: is no folder; give another --out")
    with _staging(folder.absolute() / "results"):
        pass


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
        folder = parent / f".{name}.{secrets.token_hex(8)}{_PART}"  # known before it is there, should one interrupt
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
    """Remove the hidden folders of that name which no living process holds.

    One that was about to be replaced when its process was killed returns to its place.
    """
    pattern = re.compile(rf"\.{re.escape(name)}\.[0-9a-f]{{16}}\.(part|old)")
    try:
        with os.scandir(parent) as entries:
            found = [parent / entry.name for entry in entries if pattern.fullmatch(entry.name)]
    except OSError:
        return
    for folder in found:
        lock = _lock(folder, wait=False)
        if lock is None:
            continue
        if folder.suffix == _OLD and not (parent / name).exists():
            log.info("%s: brought back, a run was killed while it replaced it", parent / name)
            folder.rename(parent / name)
        else:
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
