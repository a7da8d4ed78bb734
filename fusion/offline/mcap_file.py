"""MCAP files of any writer, by the MCAP library; ours is what it does not do.

Which channels are read, and what reading can do without: definitions of types, a summary or parts of it, and the end of
a file. Where no chunk is indexed the records are read one after another: the library would sort all of them in memory.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Literal

from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from fusion.offline.bag_messages import ROS1
from fusion.offline.storage import EARLIEST_NS, BagError

_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_FORMATS["omgidl"] = MessageDefinitionFormat.IDL
_FORMATS_1 = {"ros1msg": MessageDefinitionFormat.MSG}
_UNDEFINED = ("", "unknown")  # what rosbag2 says of a type whose definition it did not find
_HEAD = struct.Struct("<BQ")  # of a record: its kind, none of which is zero, and the length of its content


class McapFile:
    """Read access to an MCAP file whose messages are serialised as in ROS 1 or 2.

    Parameters
    ----------
    path : Path
        The file.

    Attributes
    ----------
    connections : list of Connection
        Its channels, with the number of their messages. Of a channel in another encoding `ext` tells which.
    start_ns, end_ns : int
        When the first and the last message were recorded, ns; zero where there is none.
    ros : 1 or 2
        Whose messages they are.
    fault : str
        What is wrong with it and yet no reason not to read it: that its end is missing.

    Raises
    ------
    BagError
        It was made by another system, compressed otherwise than the library reads, or is being recorded.
    McapError, ValueError
        It is damaged, or its end is missing with all messages.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._size = path.stat().st_size
        self._counts: Counter[int] = Counter()
        try:
            self._reader = SeekingReader(self._file, validate_crcs=True, record_size_limit=self._size)
            _check_profile(self._reader.get_header().profile)
            self._file.seek(-MAGIC_SIZE, os.SEEK_END)
            self._is_cut, self._end = self._file.read() != MCAP0_MAGIC, self._size
            self._summary = Summary() if self._is_cut else self._reader.get_summary() or Summary()
            _check_compression({chunk.compression for chunk in self._summary.chunk_indexes})
            self._complete(self._summary)
            self.fault = self._cut_fault(path) if self._is_cut else ""
        except BaseException:
            self.close()
            raise
        channels = self._summary.channels.values()
        self.ros: Literal[1, 2] = 1 if any(one.message_encoding == ROS1 for one in channels) else 2
        self.connections = [self._connection(channel) for channel in channels]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _complete(self, summary: Summary) -> None:
        """Add what the summary does not say of channels and counts; a schema that is nowhere is an empty one."""
        channels, statistics = summary.channels, summary.statistics
        counts = statistics.channel_message_counts if statistics else {}
        defined = {channel.schema_id for channel in channels.values()} <= {0, *summary.schemas}
        if statistics and any(counts.values()) and counts.keys() <= channels.keys() and defined:
            self._counts.update(counts)
            self.start_ns, self.end_ns = statistics.message_start_time, statistics.message_end_time
        else:
            self._count(summary)
        for channel in channels.values():
            summary.schemas.setdefault(channel.schema_id, Schema(channel.schema_id, b"", "", ""))

    def _count(self, summary: Summary) -> None:
        first_ns, last_ns = 1 << 64, 0
        for record in self._records():
            if isinstance(record, Schema):
                summary.schemas[record.id] = record
            elif isinstance(record, Channel):
                summary.channels[record.id] = record
            elif isinstance(record, Message):
                self._counts[record.channel_id] += 1
                first_ns, last_ns = min(first_ns, record.log_time), max(last_ns, record.log_time)
        self.start_ns, self.end_ns = min(first_ns, last_ns), last_ns

    def _cut_fault(self, path: Path) -> str:
        """What is missing of a file without an end, after its records were counted."""
        if path.stat().st_size != self._size:
            raise BagError("is being recorded; stop the recorder first")
        if not self._counts:
            raise ValueError("truncated: its end magic is missing, and no message is before that")
        left = (self._size - self._end) / 1000
        return f"its end is missing, as of a recorder that lost power: all but its last {left:.0f} kB was read"

    def _connection(self, channel: Channel) -> Connection:
        schema = self._summary.schemas[channel.schema_id]
        formats = _FORMATS_1 if self.ros == 1 else _FORMATS
        ours = schema.encoding in formats or schema.encoding in _UNDEFINED
        extension = ConnectionExtRosbag2(channel.message_encoding if ours else schema.encoding, [])
        package, _, name = schema.name.partition("/")
        msgtype = f"{package}/msg/{name}" if name and "/" not in name else schema.name
        form = formats.get(schema.encoding, MessageDefinitionFormat.NONE)
        definition = MessageDefinition(form, schema.data.decode(errors="replace"))
        return Connection(channel.id, channel.topic, msgtype, definition, "", self._counts[channel.id], extension, self)

    def messages(
        self, connections: Collection[Connection], from_ns: int = EARLIEST_NS
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages recorded at `from_ns` or later: by time where chunks are indexed, else as they lie in the file."""
        wanted = {one.id: one for one in connections}
        found: Iterator[McapRecord] = self._records()
        if self._summary.chunk_indexes:
            topics = {one.topic for one in connections}
            found = (message for _, _, message in self._reader.iter_messages(topics, starting_at=from_ns))
        for record in found:
            if isinstance(record, Message) and record.channel_id in wanted and record.log_time >= from_ns:
                yield wanted[record.channel_id], record.log_time, record.data

    def _records(self) -> Iterator[McapRecord]:
        """All records in the order of the file, chunks unpacked; several may read them by turns.

        Of a file whose end is missing those before the first that is not whole.
        """
        reader = StreamReader(self._file, skip_magic=True, emit_chunks=True, record_size_limit=self._size)
        records, at = reader.records, MAGIC_SIZE
        while at < self._end:
            try:
                if self._is_cut:
                    self._check_whole(at)
                self._file.seek(at)
                record = next(records, None)
                if record is None:
                    return
                after = self._file.tell()
                found = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
            except Exception:  # what is left of a record is met with exceptions of every kind
                if not self._is_cut:
                    raise
                self._end = at
                return
            at = after
            yield from found

    def _check_whole(self, at: int) -> None:
        """Refuse a record of which the file holds a part, or zeros: the library takes what there is for all of it."""
        self._file.seek(at)
        kind, length = _HEAD.unpack(self._file.read(_HEAD.size))
        if not kind or at + _HEAD.size + length > self._size:
            raise ValueError("truncated")


def _check_profile(profile: str) -> None:
    """Refuse what was not made by ROS; a writer may say nothing about itself."""
    if profile not in ("ros1", "ros2", ""):
        raise BagError(f"an MCAP of another system (profile {profile!r}); only those of ROS 1 and 2 are read")


def _check_compression(compressions: set[str]) -> None:
    """Refuse what the library would take for damaged."""
    if unread := compressions - {"", "lz4", "zstd"}:
        raise BagError(f"an MCAP whose chunks are compressed by {min(unread)!r}; only lz4 and zstd are read")
