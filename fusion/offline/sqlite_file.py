"""Sqlite3 files of rosbag2, of all versions of their tables."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Literal
from urllib.parse import quote

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from fusion.offline.storage import EARLIEST_NS

_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_NONE = MessageDefinition(MessageDefinitionFormat.NONE, "")


class SqliteFile:
    """Read access to an sqlite3 file of rosbag2.

    Parameters
    ----------
    path : Path
        The file; nothing is written beside it.

    Attributes
    ----------
    connections : list of Connection
        Its topics, with the number of their messages.
    start_ns, end_ns : int
        When the first and the last message were recorded, ns; zero where there is none.

    Raises
    ------
    ValueError
        It is truncated, or a database of something else.
    sqlite3.DatabaseError
        It is damaged.
    """

    ros: Literal[1, 2] = 2
    fault = ""

    def __init__(self, path: Path) -> None:
        _check_size(path)
        name = quote(os.fsencode(path.absolute()))
        self._database = sqlite3.connect(f"file:{name}?immutable=1", uri=True, check_same_thread=False)
        self._database.text_factory = lambda text: text.decode(errors="replace")
        try:
            self.connections = self._connections()
            times = "SELECT MIN(timestamp), MAX(timestamp) FROM messages"
            self.start_ns, self.end_ns = (int(t_ns or 0) for t_ns in self._database.execute(times).fetchone())
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _connections(self) -> list[Connection]:
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"messages", "topics"} <= tables:
            raise ValueError("missing tables")
        definitions = {}
        if "message_definitions" in tables:
            rows = self._database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {name: MessageDefinition(_FORMATS[how], text) for name, how, text in rows if how in _FORMATS}
        counts = dict(self._database.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        topics = self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        return [
            Connection(key, topic, kind, definitions.get(kind, _NONE), "", counts.get(key, 0), _extension(how), self)
            for key, topic, kind, how in topics
        ]

    def messages(
        self, connections: Collection[Connection], from_ns: int = EARLIEST_NS
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages recorded at `from_ns` or later, by time."""
        wanted = {one.id: one for one in connections}
        marks = ",".join("?" * len(wanted))
        which = f"WHERE timestamp >= ? AND topic_id IN ({marks}) ORDER BY timestamp"
        found = self._database.execute(f"SELECT topic_id, timestamp, data FROM messages {which}", (from_ns, *wanted))
        for key, t_ns, data in found:
            yield wanted[key], t_ns, data


def _extension(serialization_format: str) -> ConnectionExtRosbag2:
    return ConnectionExtRosbag2(serialization_format, [])


def _check_size(path: Path) -> None:
    """Compare a database's size with its header's: SQLite reads a missing end of an immutable one as zeros."""
    with path.open("rb") as opened:
        header = opened.read(100)
    if len(header) < 100:
        raise ValueError("truncated: it ends in its header")
    page, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    page = 65536 if page == 1 else page
    if path.stat().st_size < page * pages:
        raise ValueError(f"truncated: {path.stat().st_size} of {page * pages} bytes")
