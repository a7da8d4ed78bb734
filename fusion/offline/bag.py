"""A bag of any format (ROS 1, rosbag2 sqlite3, MCAP), opened, listed and read, with its faults in plain words."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from compass.errors import VisualCompassError
from fusion.offline.to_ros2 import Ros2Converter

IMU = "sensor_msgs/msg/Imu"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
ODOMETRY = "nav_msgs/msg/Odometry"

_CUT = ("truncated", "end magic", "index", "could not read", "expected", "malformed", "footer", "seek")


class BagError(VisualCompassError):
    """A bag that cannot be read, or has not what is asked of it."""


@dataclass(frozen=True, slots=True)
class Topic:
    """What a bag's index says of a topic."""

    name: str
    msgtype: str
    count: int

    @property
    def short_type(self) -> str:
        """The type as people write it, ``sensor_msgs/Imu``."""
        return self.msgtype.replace("/msg/", "/")


@dataclass(frozen=True, slots=True)
class Message:
    """One recorded message, not deserialised yet.

    Attributes
    ----------
    topic, msgtype : str
        Where it was recorded and what it is.
    record_ns : int
        When the recorder wrote it, ns; never used as a time of measurement.
    stamp_ns : int
        ``header.stamp``, ns.
    raw : bytes
        As serialised in the bag.
    """

    topic: str
    msgtype: str
    record_ns: int
    stamp_ns: int
    raw: bytes


class Bag(AbstractContextManager["Bag"]):
    """Read access to a bag; use it in a ``with`` statement.

    Raises
    ------
    BagError
        On entry or while reading: no such file, not a bag, or a damaged one.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.topics: list[Topic] = []

    def __enter__(self) -> Bag:
        if not self.path.exists():
            raise BagError(f"{self.path}: no such file; give a .bag, an .mcap, a .db3 or a rosbag2 folder")
        if self.path.is_dir() and not (self.path / "metadata.yaml").exists():
            raise BagError(f"{self.path}: no bag: a rosbag2 folder has a metadata.yaml; give that, or the file in it")
        if self.path.is_dir() and self.path.suffix == ".bag":
            raise BagError(f"{self.path}: a rosbag2 folder with the name of a ROS 1 bag; rename it, without .bag")
        self._standard = get_typestore(Stores.ROS1_NOETIC if self.path.suffix == ".bag" else Stores.ROS2_JAZZY)
        self._guarded(_check_sqlite_size, self.path)
        self._reader = self._guarded(self._open)
        self.topics = [
            Topic(name, info.msgtype or "mixed types", info.msgcount) for name, info in self._reader.topics.items()
        ]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.close()

    def _open(self) -> AnyReader:
        reader = AnyReader([self.path], default_typestore=self._standard)
        reader.open()
        return reader

    def has_header(self, msgtype: str) -> bool:
        """Whether messages of this type begin with a ``std_msgs/Header``, and so have a stamp."""
        fields = self._reader.typestore.fielddefs.get(msgtype, ((), ()))[1]
        return bool(fields) and fields[0][0] == "header"

    def messages(self, *topics: str) -> Iterator[Message]:
        """Messages of the named topics, in the order of the bag."""
        connections = [c for c in self._reader.connections if c.topic in topics and self.has_header(c.msgtype)]
        if not connections:
            return
        for msgtype in {connection.msgtype for connection in connections}:
            self._guarded(self._check_definition, msgtype)
        recorded = self._reader.messages(connections)
        while (item := self._guarded(next, recorded, None)) is not None:
            connection, record_ns, raw = item
            stamp_ns = self._guarded(stamp_of, raw, self._reader.is2)
            yield Message(connection.topic, connection.msgtype, record_ns, stamp_ns, raw)

    @property
    def start_ns(self) -> int:
        """When the recorder wrote the first message, ns."""
        return int(self._reader.start_time)

    def replay(self, topics: Sequence[str], from_ns: int = 0) -> Iterator[Message]:
        """Messages of any type written at `from_ns` or later, as CDR: ready to be published in ROS 2.

        Topics whose ROS 1 type has other fields in ROS 2 are left out. `Message.stamp_ns` is 0, as not every type
        has a stamp.
        """
        converter = None if self._reader.is2 else Ros2Converter(self._reader.typestore)
        connections = [
            connection
            for connection in self._reader.connections
            if connection.topic in topics and (converter is None or converter.convertible(connection.msgtype))
        ]
        if not connections:
            return
        recorded = self._reader.messages(connections, start=max(from_ns, self.start_ns))
        while (item := self._guarded(next, recorded, None)) is not None:
            connection, record_ns, raw = item
            cdr = bytes(raw) if converter is None else self._guarded(converter.cdr, raw, connection.msgtype)
            yield Message(connection.topic, connection.msgtype, record_ns, 0, cdr)

    def deserialize(self, message: Message) -> Any:
        """The message as a record with the fields of its ROS type."""
        return self._guarded(self._reader.deserialize, message.raw, message.msgtype)

    def _check_definition(self, msgtype: str) -> None:
        """Refuse a bag whose own definition of a standard type is another one: its fields would mean something else."""
        ours, bags = self._standard, self._reader.typestore
        if msgtype in ours.fielddefs:
            version: Literal[1, 2] = 2 if self._reader.is2 else 1
            if ours.generate_msgdef(msgtype, ros_version=version) != bags.generate_msgdef(msgtype, ros_version=version):
                raise ValueError(f"its definition of {msgtype.replace('/msg/', '/')} is not the standard one")

    def _guarded(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call into the bag library, whose parsers meet hostile bytes with exceptions of every kind."""
        try:
            return call(*arguments)
        except Exception as error:
            raise BagError(f"{self.path}: {_explain(error, self.path)}") from error


def stamp_of(raw: bytes, is_ros2: bool) -> int:
    """``header.stamp`` from the first bytes of a message, ns.

    CDR has four bytes of encapsulation before the header, ROS 1 the four bytes of ``seq``: the stamp stands at the
    same place in both.
    """
    order = ">" if is_ros2 and not raw[1] & 1 else "<"
    sec, nanosec = struct.unpack_from(f"{order}iI", raw, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


def _check_sqlite_size(path: Path) -> None:
    """Compare a database's size with its header's: the library reads a missing end as zeros."""
    for file in path.glob("*.db3") if path.is_dir() else [path]:
        with file.open("rb") as opened:
            header = opened.read(100)
        if header.startswith(b"SQLite format 3\0") and len(header) == 100:
            page, pages = struct.unpack_from(">H", header, 16)[0], struct.unpack_from(">I", header, 28)[0]
            page = 65536 if page == 1 else page
            if file.stat().st_size < page * pages:
                raise ValueError(f"truncated: {file.stat().st_size} of {page * pages} bytes")


def _explain(error: Exception, path: Path) -> str:
    """Say whether the file is no bag at all, or one that ends too early, and what helps."""
    detail = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    if isinstance(error, OSError) and error.strerror:
        return f"cannot be read: {error.strerror}"
    if _looks_like_bag(path) and any(word in detail.lower() for word in _CUT):
        return f"bag is truncated or damaged ({detail}); {_remedy(path)}"
    if not _looks_like_bag(path):
        return f"not a bag ({detail}); give a .bag, an .mcap, a .db3 or a rosbag2 folder"
    return f"bag is damaged ({detail}); {_remedy(path)}"


def _looks_like_bag(path: Path) -> bool:
    """Whether the file begins as a bag does."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        begin = file.read(16)
    return begin.startswith((b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0"))


def _remedy(path: Path) -> str:
    """The tool that saves what can be saved of a bag."""
    if path.suffix == ".bag":
        return "'rosbag reindex' may save it"
    if path.suffix == ".mcap":
        return f"'mcap recover {path.name} -o saved.mcap' may save it"
    return f"'ros2 bag reindex {path.name}' may save it"
