"""The files of a bag: told apart by their first bytes, and made readable without touching them.

Names and metadata.yaml are only hints. What a recorder that was killed leaves behind (no metadata, a write-ahead log
or a journal beside the database) is put together in a temporary folder.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import shutil
import sqlite3
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from compass.errors import VisualCompassError
from compass.parameters import shown
from fusion.offline.metadata import Metadata, MetadataError, read_metadata

ROS1, MCAP, SQLITE, ZSTD = ".bag", ".mcap", ".db3", ".zstd"
KINDS = (ROS1, MCAP, SQLITE)
_MAGIC = {b"#ROSBAG V2.0": ROS1, b"\x89MCAP0\r\n": MCAP, b"SQLite format 3\0": SQLITE, b"\x28\xb5\x2f\xfd": ZSTD}
# first bytes of what SQLite may have beside a database, where it holds something; sqlite.org/fileformat.html
_COMPANIONS = {"-wal": (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83"), "-journal": (b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7",)}
EARLIEST_NS = -(1 << 63)  # record time; SQLite's whole numbers have a sign
WANTED = "give a .bag, an .mcap, a .db3 or a rosbag2 folder"


class BagError(VisualCompassError):
    """A bag that cannot be read, or has not what is asked of it."""


def kind_of(file: Path) -> str:
    """What a file is by its first bytes: `ROS1`, `MCAP`, `SQLITE`, `ZSTD`, or "" for none of these."""
    with file.open("rb") as opened:
        begin = opened.read(16)
    return next((kind for magic, kind in _MAGIC.items() if begin.startswith(magic)), "")


def _kind_or_suffix(file: Path) -> str:
    """As `kind_of`; of a file that may not be read what it is called."""
    try:
        return kind_of(file)
    except OSError:
        return file.suffix if file.suffix in _MAGIC.values() else ""


def find_files(path: Path) -> tuple[list[Path], Metadata | None, list[str]]:
    """The storage files of what the user named, the metadata beside them, and what is wrong there.

    Raises
    ------
    BagError
        There is nothing of that name, or no bag.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise BagError(f"{path}: no such file; {WANTED}") from None
    except OSError as error:
        raise BagError(f"{shown(str(path))}: cannot be read: {error.strerror}; {WANTED}") from None
    if stat.S_ISDIR(mode):
        return _files_in(path)
    if not stat.S_ISREG(mode):
        raise BagError(f"{path}: is a device or a pipe, not a file; {WANTED}")
    _check_is_bag(path)
    return [path], None, []


def _check_is_bag(path: Path) -> None:
    """Say what a file is that is no bag."""
    if _kind_or_suffix(path):
        return
    if path.name == "metadata.yaml":
        raise BagError(f"{path}: describes a bag; give its folder, {path.parent}")
    database = next(
        (path.name.removesuffix(end) for end in ("-wal", "-shm", "-journal") if path.name.endswith(end)), ""
    )
    if database:
        raise BagError(f"{path}: belongs to the database {database}; give that, it is read together with it")
    fault = "it begins as none does" if path.stat().st_size else "it is empty"
    raise BagError(f"{path}: not a bag ({fault}); {WANTED}")


# ---------------------------------------------------------------- folders


def _files_in(folder: Path) -> tuple[list[Path], Metadata | None, list[str]]:
    """The files of a rosbag2 folder: those that its metadata lists, or, where that is of no use, those in it."""
    try:
        names = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
        bags = {name: kind for name in names if (kind := _kind_or_suffix(folder / name))}
    except OSError as error:
        raise BagError(f"{folder}: cannot be read: {error.strerror}; {WANTED}") from None
    metadata, faults = None, []
    try:
        metadata = read_metadata(folder / "metadata.yaml")
    except MetadataError as error:
        faults.append(f"{error}; what the files beside it hold is taken")
    listed = [name for name in metadata.files if name in bags] if metadata else []
    if metadata and listed:
        missing = [name for name in metadata.files if name not in bags]
        if missing:
            raise BagError(
                f"{folder}: {', '.join(missing)} is in metadata.yaml, but missing or no bag; "
                "bring it, or give the files that are there one by one"
            )
        more = _in_order([name for name in bags if name not in listed and _series(name) == _series(listed[0])])
        if more:
            listed = _in_order([*listed, *more])
            faults.append(f"metadata.yaml does not list {', '.join(more)}; read all the same")
    elif metadata:
        faults.append(f"metadata.yaml lists files that are not there: {', '.join(metadata.files)[:200] or 'none'}")
    return [folder / name for name in listed or _one_recording(folder, bags)], metadata, faults


def _one_recording(folder: Path, bags: dict[str, str]) -> list[str]:
    """The files of a folder that nothing lists, if they are one recording: a single file, or its parts 0, 1, 2 ..."""
    ros2 = [name for name, kind in bags.items() if kind != ROS1]
    if len(bags) == len(ros2) == 1:
        return ros2
    parts = _in_order(ros2)
    counting = [_number(name) for name in parts] == list(range(len(parts)))
    if counting and len(bags) == len(parts) > 1 and len({_series(name) for name in parts}) == 1:
        return parts
    if not bags:
        raise BagError(f"{folder}: no bag: a rosbag2 folder has a metadata.yaml and .mcap or .db3 files; {WANTED}")
    found = ", ".join(list(bags)[:5]) + ", ..." * (len(bags) > 5)
    raise BagError(f"{folder}: no bag, but a folder with {found}; give one of these")


def _series(name: str) -> tuple[str, str]:
    """What the parts of a recording have in common: ``drive_0.db3``, ``drive_1.db3`` ..."""
    stem, _, end = name.partition(".")
    return re.sub(r"_(0|[1-9]\d{0,8})$", "", stem), end


def _number(name: str) -> int:
    found = re.search(r"_(0|[1-9]\d{0,8})\.", name)
    return int(found[1]) if found else -1


def _in_order(names: Sequence[str]) -> list[str]:
    return sorted(names, key=lambda name: (_series(name), _number(name)))


# ---------------------------------------------------------------- made readable


class Workshop:
    """Makes files readable in a temporary folder, which is made when the first one needs it.

    Parameters
    ----------
    folder : callable
        Gives the folder; called once at most.

    Attributes
    ----------
    faults : list of str
        What had to be mended.
    """

    def __init__(self, folder: Callable[[], Path]) -> None:
        self._make_folder = folder
        self._folder: Path | None = None
        self._count = 0
        self.faults: list[str] = []

    def readable(self, file: Path) -> Path:
        """The file itself, or one in the temporary folder, with the suffix of its kind.

        Raises
        ------
        BagError
            There is no room for what must be put together, or a recorder is still writing.
        """
        kind = kind_of(file)
        real = file.resolve()
        companions = [Path(f"{real}{end}") for end, magic in _COMPANIONS.items() if _begins(f"{real}{end}", magic)]
        if kind == ZSTD:
            return self.readable(self._decompressed(file))
        if kind == SQLITE and companions:
            return self._settled(file, [real, *companions])
        if kind == SQLITE and Path(f"{real}-shm").exists() and not Path(f"{real}-wal").exists():
            name = f"{real.name}-wal"
            self.faults.append(
                f"{name} was not copied with {real.name}: the recorder had messages in it, they are lost"
            )
        if file.suffix == kind:
            return file
        link = self._place(kind)
        link.symlink_to(real)
        return link

    def _place(self, kind: str) -> Path:
        """A path in the temporary folder that is not in use."""
        self._folder = self._folder or self._make_folder()
        self._count += 1
        return self._folder / f"{self._count}{kind}"

    def _settled(self, file: Path, parts: Sequence[Path]) -> Path:
        """A copy of a database into which SQLite has taken its write-ahead log, or from which its journal took back."""
        place = self._place(SQLITE)
        size = sum(part.stat().st_size for part in parts)
        name = parts[1].name
        cure = f"make room there, or run \"sqlite3 '{parts[0]}' 'PRAGMA wal_checkpoint(TRUNCATE)'\""
        if shutil.disk_usage(place.parent).free < size + (16 << 20):  # SQLite needs little more than what it merges
            raise BagError(
                f"{file}: {name} beside it holds messages, too, and {place.parent.parent} has no room for a copy of "
                f"both ({size >> 20} MB); {cure}"
            )
        before = [(part.stat().st_mtime_ns, part.stat().st_size) for part in parts]
        try:
            for part in parts:
                shutil.copyfile(part, f"{place}{part.name.removeprefix(parts[0].name)}")
        except OSError as error:
            raise BagError(f"{file}: {name} beside it cannot be taken in: {error.strerror}; {cure}") from None
        if not all(part.exists() for part in parts) or before != [
            (part.stat().st_mtime_ns, part.stat().st_size) for part in parts
        ]:
            raise BagError(f"{file}: is being recorded; stop the recorder first")
        with contextlib.closing(sqlite3.connect(place)) as database:
            database.execute("SELECT count(*) FROM sqlite_master").fetchall()
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        self.faults.append(f"the recorder was killed: {name} was read together with {file.name}")
        return place

    def _decompressed(self, file: Path) -> Path:
        place = self._place("")
        try:
            with zstd().open(file, "rb") as packed, place.open("wb") as plain:
                shutil.copyfileobj(packed, plain)
        except OSError as error:
            raise BagError(f"{file}: cannot be decompressed in {place.parent.parent}: {error.strerror}") from None
        return place


def _begins(name: str, magics: Sequence[bytes]) -> bool:
    try:
        with open(name, "rb") as file:
            return file.read(8).startswith(tuple(magics))
    except OSError:
        return False


def zstd() -> Any:
    """The module of Zstandard that the bag library has brought along: it differs with the versions of both."""
    for name in ("compression.zstd", "backports.zstd", "zstandard"):
        with contextlib.suppress(ImportError):
            return importlib.import_module(name)
    raise BagError("bags compressed by Zstandard need one of the Python packages backports.zstd and zstandard")


def unpacked(raw: Any) -> Any:
    """A serialised message, decompressed where the recorder compressed each one: CDR never begins like that."""
    return zstd().decompress(bytes(raw)) if bytes(raw[:4]) == b"\x28\xb5\x2f\xfd" else raw
