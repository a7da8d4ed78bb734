"""MCAP files of any writer, by the MCAP library; ours is what it does not do.

Which channels are read, and what reading can do without: definitions of types, and a summary or parts of it. Where no
chunk is indexed the records are read one after another: the library would sort all of them in memory.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from fusion.offline.storage import EARLIEST_NS, BagError

_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_FORMATS["omgidl"] = MessageDefinitionFormat.IDL
_UNDEFINED = ("", "unknown")  # what rosbag2 says of a type whose definition it did not find


class McapFile:
    """Read access to an MCAP file whose messages are serialised as in ROS 2.

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

    Raises
    ------
    BagError
        It was made by another system, or compressed otherwise than the library reads.
    McapError, ValueError
        It is truncated or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._size = path.stat().st_size
        self._counts: Counter[int] = Counter()
        try:
            self._reader = SeekingReader(self._file, validate_crcs=True, record_size_limit=self._size)
            _check_profile(self._reader.get_header().profile)
            self._file.seek(-MAGIC_SIZE, os.SEEK_END)
            if self._file.read() != MCAP0_MAGIC:
                raise ValueError("truncated: its end magic is missing")
            self._summary = self._reader.get_summary() or Summary()
            _check_compression({chunk.compression for chunk in self._summary.chunk_indexes})
            self._complete(self._summary)
        except BaseException:
            self.close()
            raise
        self.connections = [self._connection(channel) for channel in self._summary.channels.values()]

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

    def _connection(self, channel: Channel) -> Connection:
        schema = self._summary.schemas[channel.schema_id]
        ours = schema.encoding in _FORMATS or schema.encoding in _UNDEFINED
        extension = ConnectionExtRosbag2(channel.message_encoding if ours else schema.encoding, [])
        package, _, name = schema.name.partition("/")
        msgtype = f"{package}/msg/{name}" if name and "/" not in name else schema.name
        form = _FORMATS.get(schema.encoding, MessageDefinitionFormat.NONE)
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
        """All records in the order of the file, chunks unpacked; several may read them by turns."""
        records, at = StreamReader(self._file, emit_chunks=True, record_size_limit=self._size).records, 0
        while True:
            self._file.seek(at)
            record = next(records, None)
            if record is None:
                return
            at = self._file.tell()
            yield from breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]


def _check_profile(profile: str) -> None:
    """Refuse what was not made by ROS 2; a writer may say nothing about itself."""
    if profile == "ros1":
        raise BagError("an MCAP of ROS 1 messages (profile 'ros1'); only those of ROS 2 are read: give the .bag itself")
    if profile not in ("ros2", ""):
        raise BagError(f"an MCAP of another system (profile {profile!r}); only those of ROS 2 are read")


def _check_compression(compressions: set[str]) -> None:
    """Refuse what the library would take for damaged."""
    if unread := compressions - {"", "lz4", "zstd"}:
        raise BagError(f"an MCAP whose chunks are compressed by {min(unread)!r}; only lz4 and zstd are read")
