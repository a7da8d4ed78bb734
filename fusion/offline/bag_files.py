"""The files of a bag as one: what is in them, and their messages by the time of recording.

Those of ROS 1 are read by `rosbags`. Of ROS 2 it refuses a whole bag for a definition, a hash or an encoding of a topic
that nobody asked for, and an MCAP whose messages are not by time: hence `mcap`, and sqlite3 by statements of our own.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal, Protocol

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader

from fusion.offline.mcap_file import McapFile
from fusion.offline.sqlite_file import SqliteFile
from fusion.offline.storage import EARLIEST_NS, MCAP, ROS1, SQLITE

Recorded = tuple[Connection, int, bytes]


class _File(Protocol):
    """Read access to one file."""

    connections: list[Connection]
    start_ns: int
    end_ns: int
    ros: Literal[1, 2]
    fault: str

    def messages(self, connections: Collection[Connection], from_ns: int = EARLIEST_NS) -> Iterator[Recorded]: ...

    def close(self) -> None: ...


class _Ros1File:
    """As `_File`, by the bag library."""

    ros: Literal[1, 2] = 1
    fault = ""

    def __init__(self, path: Path) -> None:
        self._stack = ExitStack()
        self._reader = self._stack.enter_context(Reader(path))
        self.connections = self._reader.connections
        self.start_ns, self.end_ns = self._reader.start_time, self._reader.end_time - 1

    def messages(self, connections: Collection[Connection], from_ns: int = EARLIEST_NS) -> Iterator[Recorded]:
        yield from self._reader.messages(connections, start=max(from_ns, self.start_ns))

    def close(self) -> None:
        self._stack.close()


_KINDS: dict[str, Callable[[Path], _File]] = {ROS1: _Ros1File, MCAP: McapFile, SQLITE: SqliteFile}


class BagFiles:
    """Read access to the files of one recording.

    Parameters
    ----------
    paths : sequence of Path
        The files, each with the suffix of its kind.

    Attributes
    ----------
    connections : list of Connection
        Of all files; a topic may have several.
    start_ns, end_ns : int
        When the first and the last message were recorded, ns.
    ros : 1 or 2
        Whose messages they are.
    faults : list of (Path, str)
        Files that are read although something is wrong with them, and what.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        with ExitStack() as stack:
            self._files: list[_File] = []
            for path in paths:
                self._files.append(_KINDS[path.suffix](path))
                stack.callback(self._files[-1].close)
            self._stack = stack.pop_all()
        self.ros = self._files[0].ros
        self.faults = [(path, file.fault) for path, file in zip(paths, self._files, strict=True) if file.fault]
        self.connections = [one for file in self._files for one in file.connections]
        filled = [file for file in self._files if any(one.msgcount for one in file.connections)]
        self.start_ns = min((file.start_ns for file in filled), default=0)
        self.end_ns = max((file.end_ns for file in filled), default=0)

    def close(self) -> None:
        """Close all files."""
        self._stack.close()

    def messages(self, connections: Collection[Connection], from_ns: int = EARLIEST_NS) -> Iterator[Recorded]:
        """Messages of these connections recorded at `from_ns` or later, by time as far as each file has them so."""
        asked = [[one for one in file.connections if one in connections] for file in self._files]
        streams = [file.messages(mine, from_ns) for file, mine in zip(self._files, asked, strict=True) if mine]
        yield from heapq.merge(*streams, key=lambda recorded: recorded[1])
