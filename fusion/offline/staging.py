"""Files that appear complete or not at all: written beside their place under a hidden name, then moved."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from compass.errors import VisualCompassError


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
def _staging(target: Path) -> Iterator[Path]:
    """A hidden folder beside `target`, gone afterwards; its name is known before it is there, should one interrupt."""
    staging = target.parent / f".{target.name}.{secrets.token_hex(8)}.part"
    try:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            staging.mkdir()
        except OSError as error:
            raise OutputError(f"{target}: cannot be written: {error.strerror}; give another --out") from None
        yield staging
    except OSError as error:
        if error.filename is None or Path(error.filename).is_relative_to(staging):
            raise OutputError(
                f"{target}: cannot be written: {error.strerror}; make room or give another --out"
            ) from error
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)
