"""MCAP files of any writer: chunked and compressed or neither, indexed or not, beside messages of other systems.

The format is that of https://mcap.dev/spec. Not asked for is what reading can do without: an order by time, message
indexes, definitions of types.
"""

from __future__ import annotations

import heapq
import io
import os
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from fusion.offline.storage import EARLIEST_NS, BagError, lz4, zstd

_MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX, _STATISTICS = 1, 2, 3, 4, 5, 6, 8, 11
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, record time, publish time
_FOOTER_SIZE = 1 + 8 + 20 + len(_MAGIC)
_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_FORMATS["omgidl"] = MessageDefinitionFormat.IDL
_UNDEFINED = ("", "unknown")  # what rosbag2 says of a type whose definition it did not find


class _Schema(NamedTuple):
    name: str
    encoding: str
    text: str


class _Channel(NamedTuple):
    schema: int  # 0: none
    topic: str
    encoding: str


class _Chunk(NamedTuple):
    first_ns: int
    last_ns: int
    at: int
    channels: frozenset[int]  # empty where the writer did not index the messages


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
        It was made by another system.
    ValueError
        It is truncated or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._schemas: dict[int, _Schema] = {}
        self._channels: dict[int, _Channel] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[_Chunk] = []
        self.start_ns = self.end_ns = 0
        try:
            self._read_ends()
        except BaseException:
            self.close()
            raise
        self.connections = [self._connection(key, channel) for key, channel in self._channels.items()]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_ends(self) -> None:
        """Profile, and index where there is one; else the messages are counted."""
        file = self._file
        size = file.seek(0, os.SEEK_END)
        code, header = next(_records(file, len(_MAGIC), size), (0, b""))
        if code != _HEADER:
            raise ValueError("truncated: it ends in its header")
        _check_profile(_Fields(header).text())
        self._first = len(_MAGIC) + 9 + len(header)
        file.seek(max(size - _FOOTER_SIZE, self._first))
        footer = file.read()
        if len(footer) != _FOOTER_SIZE or footer[0] != _FOOTER or not footer.endswith(_MAGIC):
            raise ValueError("truncated: its end magic is missing")
        self._end = size - _FOOTER_SIZE
        (summary,) = struct.unpack_from("<Q", footer, 9)
        if summary:
            if not self._first <= summary <= self._end:
                raise ValueError("its footer names an index outside of the file")
            for code, content in _records(file, summary, self._end):
                self._note(code, _Fields(content))
            self._end = summary
        known = self._channels and {one.schema for one in self._channels.values()} <= {0, *self._schemas}
        if not known or not self._counts.total():
            self._count()

    def _note(self, code: int, fields: _Fields) -> None:
        """What a record says of the file."""
        if code == _SCHEMA:
            (key,) = fields.numbers("<H")
            self._schemas[key] = _Schema(fields.text(), fields.text(), fields.text())
        elif code == _CHANNEL:
            key, schema = fields.numbers("<HH")
            self._channels[key] = _Channel(schema, fields.text(), fields.text())
        elif code == _CHUNK_INDEX:
            first_ns, last_ns, at, _, size = fields.numbers("<QQQQI")
            indexed = frozenset(key for key, _ in struct.iter_unpack("<HQ", fields.take(size)))
            self._chunks.append(_Chunk(first_ns, last_ns, at, indexed))
        elif code == _STATISTICS:
            _, _, _, _, _, _, self.start_ns, self.end_ns, size = fields.numbers("<QHIIIIQQI")
            self._counts = Counter(dict(struct.iter_unpack("<HQ", fields.take(size))))

    def _connection(self, key: int, channel: _Channel) -> Connection:
        schema = self._schemas.get(channel.schema, _Schema("", "", ""))
        ours = schema.encoding in _FORMATS or schema.encoding in _UNDEFINED
        extension = ConnectionExtRosbag2(channel.encoding if ours else schema.encoding, [])
        package, _, name = schema.name.partition("/")
        msgtype = f"{package}/msg/{name}" if name and "/" not in name else schema.name
        definition = MessageDefinition(_FORMATS.get(schema.encoding, MessageDefinitionFormat.NONE), schema.text)
        return Connection(key, channel.topic, msgtype, definition, "", self._counts[key], extension, self)

    def _count(self) -> None:
        """Count all messages, one by one."""
        counts: Counter[int] = Counter()
        first_ns, last_ns = 1 << 64, 0
        for code, content in self._data(EARLIEST_NS):
            if code == _MESSAGE:
                channel, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(content)
                counts[channel] += 1
                first_ns, last_ns = min(first_ns, t_ns), max(last_ns, t_ns)
            else:
                self._note(code, _Fields(content))
        self._counts = counts
        self.start_ns, self.end_ns = min(first_ns, last_ns), last_ns

    def _data(self, from_ns: int, wanted: Collection[int] | None = None) -> Iterator[tuple[int, bytes]]:
        """Schemas, channels and messages in the order of the file, chunks unpacked."""
        for code, content in _records(self._file, self._first, self._end, wanted):
            if code != _CHUNK:
                yield code, content
            elif struct.unpack_from("<Q", content, 8)[0] >= from_ns:
                yield from _of_chunk(content, wanted)

    def messages(
        self, connections: Collection[Connection], from_ns: int = EARLIEST_NS
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages recorded at `from_ns` or later: by time where chunks are indexed, else as they lie in the file."""
        wanted = {one.id: one for one in connections}
        records = self._by_time(wanted, from_ns) if self._chunks else _messages(self._data(from_ns, wanted))
        for t_ns, channel, content in records:
            if channel in wanted and t_ns >= from_ns:
                yield wanted[channel], t_ns, content[_MESSAGE_HEAD.size :]

    def _by_time(self, wanted: Collection[int], from_ns: int) -> Iterator[tuple[int, int, bytes]]:
        """Messages of the chunks that may hold any; one waits while a chunk that begins earlier has not been read."""
        waiting: list[tuple[int, int, int, bytes]] = []
        place = 0
        for chunk in sorted(self._chunks):
            if chunk.last_ns < from_ns or (chunk.channels and chunk.channels.isdisjoint(wanted)):
                continue
            while waiting and waiting[0][0] < chunk.first_ns:
                t_ns, _, channel, content = heapq.heappop(waiting)
                yield t_ns, channel, content
            code, packed = next(_records(self._file, chunk.at, self._end), (0, b""))
            if code != _CHUNK:
                raise ValueError("its index names a chunk where there is none")
            for t_ns, channel, content in _messages(_of_chunk(packed, wanted)):
                place += 1
                heapq.heappush(waiting, (t_ns, place, channel, content))
        while waiting:
            t_ns, _, channel, content = heapq.heappop(waiting)
            yield t_ns, channel, content


class _Fields:
    """The fields of a record, one after another."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def take(self, size: int) -> bytes:
        if self._at + size > len(self._content):
            raise ValueError(f"truncated record: {size} bytes expected, {len(self._content) - self._at} are left")
        self._at += size
        return self._content[self._at - size : self._at]

    def numbers(self, form: str) -> tuple[int, ...]:
        return struct.unpack(form, self.take(struct.calcsize(form)))

    def text(self) -> str:
        """Text; that of another system may be bytes of any kind."""
        return self.take(self.numbers("<I")[0]).decode(errors="replace")


def _records(file: BinaryIO, at: int, end: int, wanted: Collection[int] | None = None) -> Iterator[tuple[int, bytes]]:
    """Code and content of each record from `at` to `end`; messages of channels not `wanted` are passed over."""
    while at < end:
        file.seek(at)
        head = file.read(9 + 2)
        code, size = struct.unpack_from("<BQ", head) if len(head) >= 9 else (0, end)
        if at + 9 + size > end or (code == _MESSAGE and size < _MESSAGE_HEAD.size):
            raise ValueError(f"truncated or malformed record at byte {at}")
        if code != _MESSAGE or wanted is None or int.from_bytes(head[9:], "little") in wanted:
            file.seek(at + 9)
            content = file.read(size)
            if len(content) < size:
                raise ValueError(f"truncated while it is read: {size} bytes expected at byte {at}")
            yield code, content
        at += 9 + size


def _messages(records: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, int, bytes]]:
    """Record time, channel and content of each message."""
    for code, content in records:
        if code == _MESSAGE:
            channel, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(content)
            yield t_ns, channel, content


def _of_chunk(content: bytes, wanted: Collection[int] | None) -> Iterator[tuple[int, bytes]]:
    unpacked = _unpacked(content)
    yield from _records(io.BytesIO(unpacked), 0, len(unpacked), wanted)


def _unpacked(content: bytes) -> bytes:
    """The records of a chunk.

    Raises
    ------
    ValueError
        They are not what was written.
    """
    fields = _Fields(content)
    _, _, size, checksum = fields.numbers("<QQQI")
    compression = fields.text()
    packed = fields.take(*fields.numbers("<Q"))
    if compression == "zstd":
        packed = zstd().decompress(packed)
    elif compression == "lz4":
        packed = lz4().decompress(packed)
    elif compression:
        raise ValueError(f"its chunks are compressed by {compression!r}; only lz4 and zstd are read")
    if len(packed) != size or (checksum and zlib.crc32(packed) != checksum):
        raise ValueError("a chunk's checksum is not that of its content")
    return packed


def _check_profile(profile: str) -> None:
    """Refuse what was not made by ROS 2; a writer may say nothing about itself."""
    if profile == "ros1":
        raise BagError("an MCAP of ROS 1 messages (profile 'ros1'); only those of ROS 2 are read: give the .bag itself")
    if profile not in ("ros2", ""):
        raise BagError(f"an MCAP of another system (profile {profile!r}); only those of ROS 2 are read")
