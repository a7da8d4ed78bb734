"""Recordings by URL: listed and brought here by fsspec, which knows S3, HTTP, SSH and many others."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fusion.offline.atomic_output import scratch_folder
from fusion.offline.source import Source, hash_samples
from fusion.offline.storage import BagError

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+(::[A-Za-z][A-Za-z0-9+.-]+)*://")


def is_url(name: str) -> bool:
    """Whether a bag is named by a URL such as ``s3://bucket/drive.mcap``."""
    return _URL.match(name) is not None


def find_urls(url: str, is_bag: Callable[[str], bool]) -> list[str]:
    """The recordings that a URL names: itself, those of a pattern, or those below a folder whose name `is_bag`.

    Raises
    ------
    BagError
        fsspec is missing, the place cannot be reached, or there is nothing.
    """
    with _one_line(url):
        files, path = _opened(url)
        if "*" in path:
            found = sorted(files.glob(path))
        elif files.isdir(path) and not files.exists(f"{path.rstrip('/')}/metadata.yaml"):
            found = sorted(name for name in files.find(path) if is_bag(name.rsplit("/", 1)[-1]))
        else:
            return [url]
        if not found:
            raise BagError(f"{url}: no bag there")
        return [files.unstrip_protocol(name) for name in found]


@contextmanager
def local_copy(url: str) -> Iterator[Path]:
    """Give a copy of a recording on this machine, gone afterwards.

    Raises
    ------
    BagError
        It cannot be brought.
    """
    with scratch_folder() as folder:
        with _one_line(url):
            files, path = _opened(url)
            copy = folder / (path.rstrip("/").rsplit("/", 1)[-1] or "bag")
            files.get(path, str(copy), recursive=files.isdir(path))
        yield copy


def remote_source(url: str) -> Source | None:
    """Identify a file without bringing it here; None where that cannot be done, or it is a folder."""
    try:
        files, path = _opened(url)
        size, content = files.size(path), hashlib.sha256()
        if size is None or files.isdir(path):
            return None
        with files.open(path, "rb", cache_type="none") as file:
            return Source(url, hash_samples(file, size, content), content.hexdigest())
    except Exception:  # a server that gives no parts of files, for one
        return None


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path on it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise BagError(f"{url}: URLs need fsspec; pip install 'visual-compass[cluster]'") from None
    files, path = url_to_fs(url)
    return files, str(path)


@contextmanager
def _one_line(url: str) -> Iterator[None]:
    """Faults of any of the many file systems, each with exceptions of its own, as one error."""
    try:
        yield
    except BagError:
        raise
    except FileNotFoundError:
        raise BagError(f"{url}: no such file") from None
    except Exception as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{url}: cannot be brought here: {words}") from error
