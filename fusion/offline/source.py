"""Which recording a result came from: its size and a hash of its content, wherever it lies and whatever its name.

Of large files a hash is taken of blocks at both ends and evenly between them: recognising a hundred thousand
recordings must not mean reading all of them. Both ends tell most of it, as the formats keep header and index there. Not
noticed is a change in place, of the same length and outside these blocks. `docs/recordings.md` has what it costs.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from compass.files import real
from fusion.offline.folder import PICTURES, TIMES, ImageFolder
from fusion.offline.storage import BagError, find_files

BLOCKS = 16  # of one file
BLOCK = 256 << 10  # bytes; files of up to BLOCKS * BLOCK are read as a whole
_COMPANIONS = ("-wal", "-journal")  # what a recorder that was killed leaves beside a database belongs to the recording


@dataclass(frozen=True, slots=True)
class Source:
    """A recording by what is in it.

    Attributes
    ----------
    path : str
        As it was found: an absolute path, or a URL.
    size_bytes : int
        Of all its files.
    content : str
        SHA-256 of samples of its files, hexadecimal.
    """

    path: str
    size_bytes: int
    content: str

    def same_as(self, other: Source) -> bool:
        """Whether both are the same recording; paths may differ."""
        return (self.size_bytes, self.content) == (other.size_bytes, other.content)


def source_of(path: Path, known_as: str = "") -> Source:
    """Identify a recording: a file, or the folder of one.

    Parameters
    ----------
    path : Path
        Where it is.
    known_as : str
        Where it came from if `path` is a copy.

    Raises
    ------
    BagError
        It is missing or cannot be read.
    """
    size, content = 0, hashlib.sha256()
    try:
        for file in _files(path):
            with file.open("rb") as opened:
                size += hash_samples(opened, file.stat().st_size, content)
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None
    return Source(known_as or str(real(path)), size, content.hexdigest())


def _files(path: Path) -> list[Path]:
    if ImageFolder.is_one(path):  # the times of all, and some of the images
        pictures = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES)
        return [path / TIMES, *pictures[:: max(1, len(pictures) // BLOCKS)]]
    files = [path] if path.is_file() else find_files(path)[0]
    more = [Path(f"{real(file)}{end}") for file in files for end in _COMPANIONS]
    return files + [file for file in more if file.is_file()]


def hash_samples(file: BinaryIO, size: int, content: hashlib._Hash) -> int:
    """Add a file's length and samples of it to a hash; returns the length, bytes."""
    content.update(size.to_bytes(8, "little"))
    if size <= BLOCKS * BLOCK:
        content.update(file.read())
        return size
    for block in range(BLOCKS):
        file.seek(block * (size - BLOCK) // (BLOCKS - 1))
        content.update(file.read(BLOCK))
    return size
