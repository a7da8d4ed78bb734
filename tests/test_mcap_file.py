"""MCAP and sqlite3 bags as other writers make them: what nobody needs of them is no reason to refuse one."""

import contextlib
import os
import random
import sqlite3
import struct
from pathlib import Path
from types import SimpleNamespace

import lz4.frame
import numpy as np
import pytest
from mcap.writer import Writer
from tiny_bags import START_NS, TinyBag

from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import IMU
from fusion.offline.mcap_file import McapFile
from fusion.offline.storage import zstd

MAGIC = b"\x89MCAP0\r\n"
PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": lambda content: zstd().compress(content)}
COUNT = 40


def text(value: str | bytes) -> bytes:
    content = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(content)) + content


def record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


@pytest.fixture(scope="module")
def imu(tmp_path_factory):
    """The definition of an Imu, and messages of it with their time: 1 ms apart."""
    path = tmp_path_factory.mktemp("imu") / "b"
    with TinyBag(path) as bag:
        for i in range(COUNT):
            bag.imu("/imu", START_NS + i * 10**6, 0.1)
    with Bag(path) as bag:
        found = [(message.stamp_ns, message.raw) for message in bag.messages("/imu")]
        definition = bag._files.connections[0].msgdef.data
    return SimpleNamespace(definition=definition, messages=found)


def write(
    path: Path,
    imu,
    *,
    per_chunk: int = 0,
    compression: str = "",
    indexed: bool = True,
    summary: str = "all",
    profile: str = "ros2",
    name: str = IMU,
    schema: tuple[str, str | bytes] | None = None,
    foreign: tuple[str, str, bytes, str] | None = None,
    order: list[int] | None = None,
    checksum: int = 0,
) -> Path:
    """An MCAP of one topic in one or (`per_chunk`: 0) no chunk, with a topic of a `foreign` schema beside it."""
    encoding, definition = schema or ("ros2msg", imu.definition)
    schemas = record(3, struct.pack("<H", 1) + text(name) + text(encoding) + text(definition))
    channels = record(4, struct.pack("<HH", 1, 1) + text("/imu") + text("cdr") + text(b""))
    if foreign:
        other, how, content, messages = foreign
        schemas += record(3, struct.pack("<H", 2) + text(other) + text(how) + text(content))
        channels += record(4, struct.pack("<HH", 2, 2) + text("/other") + text(messages) + text(b""))
    data, index = MAGIC + record(1, text(profile) + text("test")), b""
    written = [imu.messages[i] for i in order or range(COUNT)]
    queued = [record(5, struct.pack("<HIQQ", 1, 0, t_ns, 0) + raw) for t_ns, raw in written]
    stamps = [t_ns for t_ns, _ in written]
    if not per_chunk:
        data += schemas + channels + b"".join(queued)
    for first in range(0, COUNT if per_chunk else 0, per_chunk or 1):
        plain = (b"" if first else schemas + channels) + b"".join(queued[first : first + per_chunk])
        times = stamps[first : first + per_chunk]
        packed = PACK[compression](plain)
        size = struct.pack("<Q", len(packed))
        chunk = record(
            6, struct.pack("<QQQI", min(times), max(times), len(plain), checksum) + text(compression) + size + packed
        )
        which = struct.pack("<HQ", 1, len(data)) if indexed else b""
        spans = struct.pack("<QQQQ", min(times), max(times), len(data), len(chunk))
        index += record(8, spans + text(which) + struct.pack("<Q", 0) + text(compression) + struct.pack("<QQ", 1, 1))
        data += chunk
    data += record(15, bytes(4))
    counts = struct.pack("<HQ", 1, COUNT)
    head = struct.pack("<QHIIIIQQ", COUNT, 1, 1, 0, 0, 1, min(stamps), max(stamps))
    parts = {"schemas": schemas, "channels": channels, "counts": record(11, head + text(counts)), "index": index}
    start = len(data) if summary != "none" else 0
    data += b"".join(part for key, part in parts.items() if summary != "none" and key not in summary)
    path.write_bytes(data + record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC)
    return path


def numbers(path: Path) -> list[int]:
    """The numbers of the messages, as they come; with nothing wrong that is told."""
    with Bag(path, tell=False) as bag:
        assert {topic.name: topic.count for topic in bag.topics if topic.msgtype == IMU} == {"/imu": COUNT}
        assert (bag.start_ns, bag.end_ns) == (START_NS, START_NS + (COUNT - 1) * 10**6)
        found = [(bag.deserialize(message).header.stamp.nanosec) // 10**6 for message in bag.messages("/imu")]
        assert bag.faults == []
    return found


@pytest.mark.parametrize("summary", ["all", "none", "schemas", "schemas channels", "counts", "index"])
@pytest.mark.parametrize(
    ("per_chunk", "compression", "indexed"), [(0, "", True), (7, "", False), (7, "lz4", True), (7, "zstd", False)]
)
def test_mcap_is_read_whole_however_it_is_packed(tmp_path, imu, per_chunk, compression, indexed, summary):
    """`summary` names what is left out of it; the message index is optional, and chunks of large messages lack it."""
    packed = {"per_chunk": per_chunk, "compression": compression, "indexed": indexed}
    path = write(tmp_path / "x.mcap", imu, summary=summary, **packed)
    assert numbers(path) == list(range(COUNT))


def test_mcap_without_chunks_holds_messages_in_any_order(tmp_path, imu):
    """As ``ros2 bag record --storage-preset-profile fastwrite`` leaves them."""
    order = random.Random(1).sample(range(COUNT), COUNT)
    assert numbers(write(tmp_path / "x.mcap", imu, order=order)) == order


def test_mcap_whose_chunks_overlap_is_read_by_time(tmp_path, imu):
    order = [*range(0, COUNT, 2), *range(1, COUNT, 2)]
    assert numbers(write(tmp_path / "x.mcap", imu, per_chunk=20, order=order)) == list(range(COUNT))


def test_mcap_is_read_twice_at_once(tmp_path, imu):
    with Bag(write(tmp_path / "x.mcap", imu)) as bag:
        both = list(zip(bag.messages("/imu"), bag.messages("/imu"), strict=True))
    assert len(both) == COUNT
    assert all(one == other for one, other in both)


@pytest.mark.parametrize(
    "foreign",
    [
        ("foo.Bar", "protobuf", b"\x0a\xff\xfe", "protobuf"),
        ("foo.Bar", "jsonschema", b"{}", "json"),
        ("foo/msg/Bar", "ros2idl", b"garbage { garbage", "cdr"),
        ("foo/msg/Bar", "ros2msg", b"gar { bage\xff", "cdr"),
        ("foo/msg/Bar", "unknown", b"", "cdr"),
        ("sensor_msgs/msg/Imu", "ros2msg", b"int32 a\n", "cdr"),
        ("foo/msg/Bar", "ros2msg", b"foo/Missing a\n", "cdr"),
    ],
)
def test_mcap_beside_a_topic_of_any_schema_is_read(tmp_path, imu, foreign):
    path = write(tmp_path / "x.mcap", imu, foreign=foreign, per_chunk=7)
    if foreign[0] != IMU:
        assert numbers(path) == list(range(COUNT))
    with Bag(path) as bag:
        assert len(list(bag.messages("/imu"))) == len(list(bag.replay(["/imu"]))) == COUNT
        assert not bag.has_header("foo/msg/Bar")


@pytest.mark.parametrize(
    "schema", [("", ""), ("unknown", ""), ("ros2msg", ""), ("ros2msg", "of Windows"), ("ros2msg", "alone")]
)
@pytest.mark.parametrize(("name", "profile"), [(IMU, ""), ("sensor_msgs/Imu", "ros2")])
def test_mcap_of_standard_types_needs_no_definition_of_them(tmp_path, imu, schema, name, profile):
    if schema[1] == "of Windows":
        schema = "ros2msg", imu.definition.replace("\n", "\r\n")
    elif schema[1] == "alone":  # without the types that it is made of
        schema = "ros2msg", imu.definition.split("=" * 80)[0]
    assert numbers(write(tmp_path / "x.mcap", imu, name=name, profile=profile, schema=schema)) == list(range(COUNT))


def test_mcap_whose_own_definition_is_another_one_is_refused(tmp_path, imu):
    other = ("ros2msg", imu.definition.replace("angular_velocity\n", "turn_rate\n"))
    with pytest.raises(BagError, match=r"definition of sensor_msgs/Imu is not the standard one"):
        numbers(write(tmp_path / "x.mcap", imu, schema=other))


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE message_definitions SET encoding = 'unknown', encoded_message_definition = ''",
        "UPDATE message_definitions SET encoded_message_definition = 'gar { bage' WHERE topic_type LIKE '%Odometry'",
        "UPDATE topics SET type_description_hash = 'RIHS01_00'",
        "DELETE FROM message_definitions WHERE topic_type LIKE '%Imu'",
        "DROP TABLE message_definitions",
    ],
)
def test_sqlite_needs_no_definitions_of_standard_types(tmp_path, change):
    with TinyBag(tmp_path / "b", storage="sqlite3") as bag:
        bag.recorded_ns -= 1000
        for i in range(COUNT):
            bag.imu("/imu", START_NS + i * 10**6, 0.1)
            bag.recorded_ns += 10**6 - 2000
            bag.odometry("/odom", START_NS + i * 10**6, 0.0, 0.1)
    with contextlib.closing(sqlite3.connect(tmp_path / "b" / "b.db3")) as database:
        database.execute(change)
        database.commit()
    with Bag(tmp_path / "b", tell=False) as bag:
        assert len(list(bag.messages("/imu"))) == COUNT


def test_mcap_that_is_cut_while_it_is_read_is_refused(tmp_path, imu):
    path = write(tmp_path / "x.mcap", imu)
    with Bag(path) as bag:
        messages = bag.messages("/imu")
        next(messages)
        os.truncate(path, 4000)
        with pytest.raises(BagError, match="truncated"):
            list(messages)


@pytest.mark.parametrize("tail", [b"", bytes(5000)])
@pytest.mark.parametrize("kept", [0.4, 0.6, 0.8, 1.0])
@pytest.mark.parametrize(("per_chunk", "compression"), [(0, ""), (7, ""), (7, "lz4"), (7, "zstd")])
def test_mcap_without_its_end_is_read_up_to_the_cut_and_that_is_told(tmp_path, imu, per_chunk, compression, kept, tail):
    """As of a recorder that lost power, whose last blocks may be zeros. `kept` is the share of the messages' bytes."""
    path = write(tmp_path / "x.mcap", imu, per_chunk=per_chunk, compression=compression)
    sound = path.read_bytes()
    ends = sound.index(record(15, bytes(4)))
    path.write_bytes(sound[: int(kept * ends)] + tail)
    with Bag(path, tell=False) as bag:
        found = [(bag.deserialize(message).header.stamp.nanosec) // 10**6 for message in bag.messages("/imu")]
        assert [topic.count for topic in bag.topics] == [len(found)]
        assert bag.end_ns == START_NS + found[-1] * 10**6
        (fault,) = bag.faults
    assert "its end is missing" in fault
    assert found == list(range(len(found)))
    assert len(found) == COUNT if kept == 1.0 else 0 < len(found) < COUNT
    assert per_chunk == 0 or len(found) in (7, 14, 21, 28, 35, COUNT)


@pytest.mark.parametrize("per_chunk", [0, 7])
def test_mcap_without_its_end_holds_only_messages_that_are_whole(tmp_path, imu, per_chunk):
    """Cut at each byte of the last message, or in its chunk."""
    path = write(tmp_path / "x.mcap", imu, per_chunk=per_chunk)
    sound = path.read_bytes()
    ends, last = sound.index(record(15, bytes(4))), len(imu.messages[-1][1])
    for cut in range(ends - last, ends, 7):
        path.write_bytes(sound[:cut])
        with Bag(path, tell=False) as bag:
            assert [message.raw for message in bag.messages("/imu")] == [
                raw for _, raw in imu.messages[: 35 if per_chunk else COUNT - 1]
            ]


def test_mcap_without_its_end_and_any_message_is_refused(tmp_path, imu):
    path = write(tmp_path / "x.mcap", imu, per_chunk=7)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(BagError, match=r"truncated or damaged .*mcap recover"):
        numbers(path)


def test_mcap_that_grows_is_being_recorded(tmp_path, imu, monkeypatch):
    path = write(tmp_path / "x.mcap", imu, per_chunk=7)
    path.write_bytes(path.read_bytes()[:-8])
    count = McapFile._count

    def record_meanwhile(file, summary):
        count(file, summary)
        with path.open("ab") as recorder:
            recorder.write(b"\6")

    monkeypatch.setattr(McapFile, "_count", record_meanwhile)
    with pytest.raises(BagError, match=r"x\.mcap: is being recorded; stop the recorder first"):
        numbers(path)


@pytest.mark.parametrize("profile", ["ros1", ""])
def test_mcap_of_ros1_messages_is_read_as_the_bag_is(tmp_path, profile):
    """As ``mcap convert`` makes it of a .bag."""
    with TinyBag(tmp_path / "a.bag", storage="ros1") as tiny:
        for i in range(COUNT):
            tiny.imu("/imu", START_NS + i * 10**6, 0.1)
            tiny.compressed("/pano", START_NS + i * 10**6, np.full((4, 8), i, np.uint8))
    with Bag(tmp_path / "a.bag") as bag, (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile=profile, library="test")
        channels = {}
        for one in bag._files.connections:
            schema = writer.register_schema(one.msgtype.replace("/msg/", "/"), "ros1msg", one.msgdef.data.encode())
            channels[one.topic] = writer.register_channel(one.topic, "ros1", schema)
        beside = writer.register_channel("/status", "json", writer.register_schema("Status", "jsonschema", b"{}"))
        writer.add_message(beside, START_NS, b"{}", START_NS)
        for message in bag.messages("/imu", "/pano"):
            writer.add_message(channels[message.topic], message.record_ns, message.raw, message.record_ns)
        writer.finish()
    with Bag(tmp_path / "a.bag") as bag, Bag(tmp_path / "a.mcap") as packed:
        assert packed.topics == bag.topics
        for mine, theirs in zip(packed.messages("/imu", "/pano"), bag.messages("/imu", "/pano"), strict=True):
            assert mine == theirs
            assert packed.deserialize(mine).header.stamp == bag.deserialize(theirs).header.stamp
        assert list(packed.replay(["/imu"])) == list(bag.replay(["/imu"]))


@pytest.mark.parametrize("summary", ["all", "index"])
def test_mcap_whose_chunks_are_not_what_their_checksums_say_is_refused(tmp_path, imu, summary):
    with pytest.raises(BagError, match=r"damaged .*crc"):
        numbers(write(tmp_path / "x.mcap", imu, per_chunk=7, checksum=1, summary=summary))


def test_mcap_of_a_compression_that_is_not_read_names_it(tmp_path, imu):
    path = write(tmp_path / "x.mcap", imu, per_chunk=7, compression="zstd")
    path.write_bytes(path.read_bytes().replace(b"\4\0\0\0zstd", b"\4\0\0\0brot"))
    with pytest.raises(BagError, match=r"compressed by 'brot'; only lz4 and zstd are read"):
        numbers(path)


def test_mcap_damaged_anywhere_is_read_or_refused_in_words(tmp_path, imu):
    """With any four bytes of it overwritten."""
    draw = random.Random(2)
    sound = write(tmp_path / "x.mcap", imu, per_chunk=7).read_bytes()
    for _ in range(40):
        at = draw.randrange(len(sound) - 4)
        (tmp_path / "x.mcap").write_bytes(sound[:at] + draw.randbytes(4) + sound[at + 4 :])
        with contextlib.suppress(BagError), Bag(tmp_path / "x.mcap", tell=False) as bag:
            assert len(list(bag.messages("/imu"))) <= COUNT
