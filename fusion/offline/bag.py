"""A bag of any format (ROS 1, rosbag2 sqlite3, MCAP), opened, listed and read, with its faults in plain words."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fusion.messages import MessageError
from fusion.offline.atomic_output import scratch_folder
from fusion.offline.bag_errors import OURS, explain, remedy
from fusion.offline.bag_messages import VIDEOS, Message, Topic, stamp_of
from fusion.offline.metadata import contradictions
from fusion.offline.storage import (
    MCAP,
    ROS1,
    SQLITE,
    WANTED,
    BagError,
    Workshop,
    check_mcap,
    check_sqlite,
    find_files,
    unpacked,
)
from fusion.offline.to_ros2 import Ros2Converter

__all__ = ["Bag", "BagError"]

log = logging.getLogger(__name__)

NEGLIGIBLE = 0.01  # of messages and of a bag's time; single messages are lost by any link
PAUSE = 5  # periods of the messages; a longer one is a gap


class Bag(AbstractContextManager["Bag"]):
    """Read access to a bag; use it in a ``with`` statement.

    Parameters
    ----------
    path : path
        A ROS 1 bag, an MCAP, an sqlite3 file or a rosbag2 folder, whatever its name.
    tell : bool
        Whether to log `faults` as warnings.

    Attributes
    ----------
    topics : list of Topic
        What is in it, by what the files themselves say.
    faults : list of str
        What is wrong with it and yet no reason not to read it, a sentence each: metadata that contradicts the files, a
        recorder that was killed. More may come up while messages are read.

    Raises
    ------
    BagError
        On entry or while reading: no such file, not a bag, or a damaged one.
    """

    def __init__(self, path: Path | str, *, tell: bool = True) -> None:
        self.path = Path(path)
        self.topics: list[Topic] = []
        self.faults: list[str] = []
        self._tell = tell
        self._names: dict[str, str] = {}

    def __enter__(self) -> Bag:
        files, metadata, faults = find_files(self.path)
        if self.path.is_dir() and self.path.suffix == ".bag":
            raise BagError(f"{self.path}: a rosbag2 folder with the name of a ROS 1 bag; rename it, without .bag")
        with ExitStack() as stack:
            workshop = Workshop(lambda: stack.enter_context(scratch_folder()))
            readable = [self._guarded(self._made_readable, workshop, file) for file in files]
            self._standard = get_typestore(Stores.ROS1_NOETIC if readable[0].suffix == ROS1 else Stores.ROS2_JAZZY)
            for msgtype, fields in VIDEOS.items():
                self._standard.register(get_types_from_msg(fields, msgtype))
            self._reader = self._guarded(self._open, readable)
            stack.callback(self._reader.close)
            self.topics = self._guarded(self._count_topics)
            self._stack = stack.pop_all()
        for fault in (*faults, *workshop.faults):
            self._note(fault)
        if metadata is not None:
            counts = {topic.name: topic.count for topic in self.topics}
            types = {topic.name: topic.msgtype for topic in self.topics}
            for fault in contradictions(metadata, counts, types, self.start_ns, int(self._reader.duration) - 1):
                self._note(fault)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _made_readable(self, workshop: Workshop, file: Path) -> Path:
        readable = workshop.readable(file)
        self._names[str(readable)] = file.name
        if readable.suffix not in (ROS1, MCAP, SQLITE):
            raise BagError(f"{file.name} holds no bag; {WANTED}")
        if readable.suffix == SQLITE:
            check_sqlite(readable)
        elif readable.suffix == MCAP:
            check_mcap(readable)
        return readable

    def _open(self, files: Sequence[Path]) -> AnyReader:
        reader = AnyReader(files, default_typestore=self._standard)
        reader.open()
        return reader

    def _count_topics(self) -> list[Topic]:
        """Topics with the counts of the index, or, where it has none, of the messages."""
        found = self._reader.topics
        counts = {name: info.msgcount for name, info in found.items()}
        if not any(counts.values()) and self._reader.message_count:
            counts = Counter(connection.topic for connection, _, _ in self._reader.messages())
        foreign = {c.topic: c.ext.serialization_format for c in self._reader.connections if not _is_cdr(c)}
        if foreign and len(foreign) == len(found):
            raise BagError(f"its messages are encoded as {next(iter(foreign.values()))!r}; {OURS}")
        for topic, encoding in foreign.items():
            self._note(f"{topic} is encoded as {encoding!r}, which is not read")
        return [
            Topic(name, info.msgtype or "mixed types", counts.get(name, 0))
            for name, info in found.items()
            if name not in foreign
        ]

    def _note(self, fault: str) -> None:
        """Remember what is wrong, and tell it once."""
        if fault not in self.faults:
            self.faults.append(fault)
            if self._tell:
                log.warning("%s: %s", self.path, fault)

    def has_header(self, msgtype: str) -> bool:
        """Whether messages of this type begin with a ``std_msgs/Header``, or a stamp alone, and so have one."""
        fields = self._reader.typestore.fielddefs.get(msgtype, ((), ()))[1]
        return bool(fields) and (fields[0][0] == "header" or msgtype in VIDEOS)

    def messages(self, *topics: str) -> Iterator[Message]:
        """Messages of the named topics, in the order of the bag."""
        connections = [
            c for c in self._reader.connections if c.topic in topics and self.has_header(c.msgtype) and _is_cdr(c)
        ]
        if not connections:
            return
        for msgtype in {connection.msgtype for connection in connections}:
            self._guarded(self._check_definition, msgtype)
        recorded, seen, last_ns = self._reader.messages(connections), 0, self.start_ns
        while (item := self._guarded(next, recorded, None)) is not None:
            yield self._guarded(self._message, *item)
            seen, last_ns = seen + 1, max(last_ns, int(item[1]))
        counted = sum(c.msgcount for c in connections)
        if seen != counted:
            names = ", ".join(sorted({connection.topic for connection in connections}))
            if self._ends_early(seen, counted, last_ns):
                raise BagError(
                    f"{self.path}: bag is damaged (of {counted} messages of {names} {seen} were found, none near its "
                    f"end); {remedy(self.path)}"
                )
            self._note(f"{names}: {counted} messages by the index, {seen} were found")

    def _ends_early(self, seen: int, counted: int, last_ns: int) -> bool:
        """Whether messages are missing, and at the end: what comes after a place that is damaged."""
        lasts, left = self.end_ns - self.start_ns, self.end_ns - last_ns
        usual = PAUSE * (last_ns - self.start_ns) / max(seen, 1)
        return seen < (1.0 - NEGLIGIBLE) * counted and left > max(NEGLIGIBLE * lasts, usual)

    def _message(self, connection: Any, record_ns: Any, raw: Any) -> Message:
        """The message; without content and stamp where it is too short or cannot be decompressed."""
        try:
            raw = unpacked(raw)
            has_seq = not self._reader.is2 and "timestamp" in VIDEOS.get(connection.msgtype, "")
            stamp_ns = stamp_of(b"\0\0\0\0" + bytes(raw[:8]) if has_seq else raw, self._reader.is2)
        except BagError:
            raise
        except Exception:  # bytes that are none of a message
            raw, stamp_ns = b"", 0
        return Message(connection.topic, connection.msgtype, int(record_ns), stamp_ns, raw)

    @property
    def end_ns(self) -> int:
        """When the last message was recorded, ns."""
        return self.start_ns + int(self._reader.duration)

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
            raw = self._guarded(unpacked, raw)
            cdr = bytes(raw) if converter is None else self._guarded(converter.cdr, raw, connection.msgtype)
            yield Message(connection.topic, connection.msgtype, record_ns, 0, cdr)

    def deserialize(self, message: Message) -> Any:
        """The message as a record with the fields of its ROS type.

        Raises
        ------
        MessageError
            Its bytes are none of that type: damaged, empty or cut. The messages beside it may be sound.
        """
        try:
            return self._reader.deserialize(message.raw, message.msgtype)
        except Exception as error:  # hostile bytes are met with exceptions of every kind
            raise MessageError(f"damaged: no {message.msgtype.replace('/msg/', '/')} by its bytes") from error

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
        except BagError as error:
            text = str(error)
            raise BagError(text if text.startswith(str(self.path)) else f"{self.path}: {text}") from None
        except Exception as error:
            raise BagError(f"{self.path}: {explain(error, self.path, self._names)}") from error


def _is_cdr(connection: Any) -> bool:
    """Whether the messages are serialised as this system does it; in ROS 1 they all are."""
    return getattr(connection.ext, "serialization_format", "cdr") == "cdr"
