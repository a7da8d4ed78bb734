"""Clean frames on disk: rendered once, lossless, complete or absent.

One ZIP file of PNG images per experiment and world; any tool can look inside. A file that cannot be read is made anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt
from platformdirs import user_cache_path

Frame = npt.NDArray[np.uint8]
Progress = Callable[[int, int], None]

log = logging.getLogger(__name__)

# For smooth images run lengths after prediction are smaller and faster than a search for repeats.
_PNG = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
_RENDERS: tuple[str, ...] = ("body", "builder", "camera", "fittings", "held_out", "materials", "painter")
_RENDERS += ("people", "places", "raster", "rays", "rendering", "surfaces", "world", "worlds", "yards")


class Frames(Protocol):
    """Frames by number."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`, uint8 (height, width)."""
        ...


def cache_directory() -> Path:
    """``$VISUAL_COMPASS_CACHE``, else ``visual-compass`` in the user's cache directory."""
    own = os.environ.get("VISUAL_COMPASS_CACHE")
    return Path(own) if own else user_cache_path("visual-compass")


@functools.cache
def code_version() -> str:
    """Digest of the code that renders: frames of other code are never taken from the cache."""
    digest = hashlib.sha256()
    for name in _RENDERS:
        digest.update((Path(__file__).parent / f"{name}.py").read_bytes())
    return digest.hexdigest()


def cached_frames(
    label: str,
    key: bytes,
    count: int,
    start: Callable[[], Callable[[int], Frame]],
    directory: Path | None = None,
    workers: int = 2,
    progress: Progress | None = None,
    *,
    keep: bool = True,
) -> Frames:
    """Frames from the cache, or rendered and put there.

    Parameters
    ----------
    label : str
        Start of the file's name. Older files of the same label are removed.
    key : bytes
        All that the frames depend on, beside the code.
    count : int
        Number of frames.
    start : callable
        Called when frames have to be made; returns what makes frame number i, from `workers` threads.
    directory : Path or None
        None: `cache_directory()`.
    progress : callable or None
        Called with (frames done, count) while rendering.
    keep : bool
        False: what the cache does not have is rendered when it is asked for, each time anew, and not put there.
    """
    directory = cache_directory() if directory is None else directory
    digest = hashlib.sha256(code_version().encode() + key).hexdigest()[:16]
    path = directory / f"{label}-{digest}.zip"
    with contextlib.suppress(OSError, zipfile.BadZipFile, ValueError):
        return _ZippedFrames(path, count)
    if not keep:
        return _RenderedFrames(count, start())
    images = list(_rendered(count, start(), workers, progress))
    try:
        directory.mkdir(parents=True, exist_ok=True)
        _write(path, images)
    except OSError as error:
        log.warning("frames are not kept: %s; set VISUAL_COMPASS_CACHE to a writable directory", error)
        return _FramesInMemory(images)
    for stale in directory.glob(f"{label}-{'?' * 16}.zip"):
        if stale != path:
            stale.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # another process may have put frames of the same label in their place
        return _ZippedFrames(path, count)
    return _FramesInMemory(images)


class _RenderedFrames:
    def __init__(self, count: int, render: Callable[[int], Frame]) -> None:
        self._count = count
        self._render = render

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Frame:
        return self._render(index)


class _FramesInMemory:
    def __init__(self, images: list[bytes]) -> None:
        self._images = images

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, index: int) -> Frame:
        return _decode(self._images[index])


class _ZippedFrames:
    """Frames in a file; opening checks that it is whole, reading checks each frame's sum."""

    def __init__(self, path: Path, count: int) -> None:
        self._archive = zipfile.ZipFile(path)
        if len(self._archive.namelist()) != count or self._archive.testzip() is not None:
            self._archive.close()
            raise ValueError(f"{path} is not complete")
        self._count = count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Frame:
        return _decode(self._archive.read(f"{index:05d}.png"))


def _decode(png: bytes) -> Frame:
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE), np.uint8)


def _rendered(count: int, render: Callable[[int], Frame], workers: int, progress: Progress | None) -> Iterator[bytes]:
    """PNG files of all frames in order, rendered by threads (numpy and OpenCV let go of the interpreter's lock)."""

    def make(index: int) -> bytes:
        return bytes(cv2.imencode(".png", render(index), _PNG)[1])

    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        for done, image in enumerate(pool.map(make, range(count)), start=1):
            yield image
            if progress is not None:
                progress(done, count)


def _write(path: Path, images: Iterable[bytes]) -> None:
    """Write the archive under another name first, so that `path` is complete or absent."""
    handle, partial = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for index, image in enumerate(images):
                archive.writestr(zipfile.ZipInfo(f"{index:05d}.png"), image)
        os.replace(partial, path)
    finally:
        Path(partial).unlink(missing_ok=True)
