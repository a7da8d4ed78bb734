"""Files that a user names, read within bounds: no device, no pipe, no folder, and none too large for what it is."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from compass.errors import ConfigError


def read_bounded(path: Path, most_bytes: int, remedy: str) -> bytes:
    """The content of a regular file.

    Parameters
    ----------
    path : Path
        What the user named.
    most_bytes : int
        Size above which it cannot be what was asked for, bytes.
    remedy : str
        What to do instead, for the error: ``"give a readable YAML file"``.

    Raises
    ------
    ConfigError
        It is missing, larger, no regular file (which may never end, or wait for ever), or cannot be read.
    """
    if "\0" in str(path):
        raise ConfigError(f"{str(path)!r}: no name of a file; {remedy}")
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise ConfigError(f"{path}: is {_kind(found.st_mode)}, not a regular file; {remedy}")
        if found.st_size > most_bytes:
            raise ConfigError(f"{path}: has {found.st_size} bytes, more than the {most_bytes} allowed; {remedy}")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)  # files of /proc say that they have no bytes
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; {remedy}") from None
    if len(data) > most_bytes:
        raise ConfigError(f"{path}: has more than the {most_bytes} bytes allowed; {remedy}")
    return data


def real(path: Path) -> Path:
    """The absolute path without links; of links in a circle as far as they can be followed."""
    return Path(os.path.realpath(path))


def is_folder(path: Path) -> bool:
    """Whether it is a folder; a name that no file can have, as it is too long or holds a NUL, is none's."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def _kind(mode: int) -> str:
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    return next((name for test, name in kinds if test(mode)), "a device")
