"""A bag of any format (ROS 1, rosbag2 sqlite3, MCAP), opened, listed and read, with its faults in plain words."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from fusion.messages import MessageError
from fusion.offline.atomic_output import scratch_folder
from fusion.offline.bag_errors import OURS, explain, remedy
from fusion.offline.bag_files import BagFiles
from fusion.offline.bag_messages import CDR, IMAGES, IMU, ODOMETRY, ROS1, VIDEOS, Message, Topic, stamp_of
from fusion.offline.bag_types import BagTypes
from fusion.offline.metadata import contradictions
from fusion.offline.storage import KINDS, WANTED, BagError, Workshop, find_files, unpacked
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
            self._files: BagFiles = self._guarded(BagFiles, readable)
            stack.callback(self._files.close)
            self._is_ros2, self._serialised = (False, ROS1) if self._files.ros == 1 else (True, CDR)
            self._types = BagTypes(self._files.connections, self._files.ros)
            self.topics = self._guarded(self._count_topics)
            self._stack = stack.pop_all()
        of_files = [(f"{self._names[str(file)]}: " * (len(files) > 1)) + fault for file, fault in self._files.faults]
        for fault in (*faults, *workshop.faults, *of_files):
            self._note(fault)
        if metadata is not None:
            counts = {topic.name: topic.count for topic in self.topics}
            types = {topic.name: topic.msgtype for topic in self.topics}
            for fault in contradictions(metadata, counts, types, self.start_ns, self.end_ns - self.start_ns):
                self._note(fault)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _made_readable(self, workshop: Workshop, file: Path) -> Path:
        readable = workshop.readable(file)
        self._names[str(readable)] = file.name
        if readable.suffix not in KINDS:
            raise BagError(f"{file.name} holds no bag; {WANTED}")
        return readable

    def _count_topics(self) -> list[Topic]:
        """Topics with the number of their messages; of those in a foreign encoding only what was looked for is told."""
        found = self._files.connections
        foreign = {c.topic: _encoding(c) for c in found if _encoding(c) != self._serialised}
        if foreign and len(foreign) == len({c.topic for c in found}):
            raise BagError(f"its messages are encoded as {next(iter(foreign.values()))!r}; {OURS}")
        topics = []
        for name in sorted({c.topic for c in found}):
            kinds = {c.msgtype for c in found if c.topic == name}
            if name not in foreign:
                count = sum(c.msgcount for c in found if c.topic == name)
                topics.append(Topic(name, kinds.pop() if len(kinds) == 1 else "mixed types", count))
            elif kinds & {IMU, ODOMETRY, *IMAGES}:
                self._note(f"{name} is encoded as {foreign[name]!r}, which is not read")
        return topics

    def _note(self, fault: str) -> None:
        """Remember what is wrong, and tell it once."""
        if fault not in self.faults:
            self.faults.append(fault)
            if self._tell:
                log.warning("%s: %s", self.path, fault)

    def has_header(self, msgtype: str) -> bool:
        """Whether messages of this type begin with a ``std_msgs/Header``, or a stamp alone, and so have one."""
        return self._types.has_header(msgtype)

    def messages(self, *topics: str) -> Iterator[Message]:
        """Messages of the named topics, in the order of the bag."""
        connections = [
            c
            for c in self._files.connections
            if c.topic in topics and self.has_header(c.msgtype) and _encoding(c) == self._serialised
        ]
        if not connections:
            return
        for connection in connections:
            self._guarded(self._types.check, connection)
        recorded, seen, last_ns = self._files.messages(connections), 0, self.start_ns
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
            has_seq = not self._is_ros2 and "timestamp" in VIDEOS.get(connection.msgtype, "")
            stamp_ns = stamp_of(b"\0\0\0\0" + bytes(raw[:8]) if has_seq else raw, self._is_ros2)
        except BagError:
            raise
        except Exception:  # bytes that are none of a message
            raw, stamp_ns = b"", 0
        return Message(connection.topic, connection.msgtype, int(record_ns), stamp_ns, raw)

    @property
    def end_ns(self) -> int:
        """When the last message was recorded, ns."""
        return self._files.end_ns

    @property
    def start_ns(self) -> int:
        """When the recorder wrote the first message, ns."""
        return self._files.start_ns

    def replay(self, topics: Sequence[str], from_ns: int = 0) -> Iterator[Message]:
        """Messages of any type written at `from_ns` or later, as CDR: ready to be published in ROS 2.

        Topics whose ROS 1 type has other fields in ROS 2 are left out. `Message.stamp_ns` is 0, as not every type
        has a stamp.
        """
        converter = None if self._is_ros2 else Ros2Converter(self._types.all)
        connections = [
            connection
            for connection in self._files.connections
            if connection.topic in topics and (converter is None or converter.convertible(connection.msgtype))
        ]
        if not connections:
            return
        recorded = self._files.messages(connections, from_ns)
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
            standard = self._types.standard
            read = standard.deserialize_cdr if self._is_ros2 else standard.deserialize_ros1
            return read(message.raw, message.msgtype)
        except Exception as error:  # hostile bytes are met with exceptions of every kind
            raise MessageError(f"damaged: no {message.msgtype.replace('/msg/', '/')} by its bytes") from error

    def _guarded(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call into the bag library, whose parsers meet hostile bytes with exceptions of every kind."""
        try:
            return call(*arguments)
        except BagError as error:
            text = str(error)
            raise BagError(text if text.startswith(str(self.path)) else f"{self.path}: {text}") from None
        except Exception as error:
            raise BagError(f"{self.path}: {explain(error, self.path, self._names)}") from error


def _encoding(connection: Any) -> str:
    """How the messages are serialised; in bags of ROS 1 there is one way."""
    return str(getattr(connection.ext, "serialization_format", ROS1))
