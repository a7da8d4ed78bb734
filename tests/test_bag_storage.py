"""What recorders, copying and editing do to the files of a bag: read whole, with what is wrong told, or refused."""

import contextlib
import logging
import os
import re
import shutil
import sqlite3
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

from fusion.offline import fuse, storage
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import IMU
from fusion.offline.inspect import inspect_bag
from fusion.settings import Settings

MESSAGES = 40
FOREIGN = "only those of ROS are read"


def numbers(path: Path) -> list[int]:
    """The numbers of the messages of /imu, as they come."""
    with Bag(path, tell=False) as bag:
        return [(message.stamp_ns - START_NS) // 10**6 for message in bag.messages("/imu")]


def faults(path: Path) -> list[str]:
    with Bag(path, tell=False) as bag:
        list(bag.messages("/imu"))
        return bag.faults


def write(path: Path, storage: str = "mcap", first: int = 0, count: int = MESSAGES) -> Path:
    with TinyBag(path, storage=storage) as bag:
        bag.recorded_ns += 2000 * first
        for i in range(first, first + count):
            bag.imu("/imu", START_NS + i * 10**6, 0.1)
            bag.odometry("/odom", START_NS + i * 10**6, 0.0, 0.1)
    return path


def content(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture(autouse=True)
def scratch(tmp_path, monkeypatch):
    """Temporary files go where the test can see them; nothing may be left there."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


# ---------------------------------------------------------------- recorders that were killed


def kill_with_log(folder: Path, kept: int = 10) -> Path:
    """Move the messages after the first `kept` of each topic into a write-ahead log that nobody checkpointed."""
    database = next(folder.glob("*.db3"))
    with contextlib.closing(sqlite3.connect(database)) as connection:
        rows = connection.execute("SELECT * FROM messages WHERE id > ?", (2 * kept,)).fetchall()
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA wal_autocheckpoint=0")
        connection.execute("DELETE FROM messages WHERE id > ?", (2 * kept,))
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        connection.commit()
        killed = folder.with_name(f"{folder.name}_killed")
        shutil.copytree(folder, killed)
    return killed


@pytest.mark.parametrize("shm", [True, False])
@pytest.mark.parametrize("metadata", [True, False])
@pytest.mark.parametrize("given", ["folder", "file", "link"])
def test_sqlite_write_ahead_log_is_read_whole_and_untouched(tmp_path, given, metadata, shm):
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    if not metadata:
        (killed / "metadata.yaml").unlink()
    if not shm:
        next(killed.glob("*-shm")).unlink()
    path = {"folder": killed, "file": killed / "drive.db3", "link": tmp_path / "elsewhere.db3"}[given]
    if given == "link":
        path.symlink_to(killed / "drive.db3")
    before = content(killed)
    assert numbers(path) == list(range(MESSAGES))
    assert content(killed) == before
    assert any("drive.db3-wal" in fault and "killed" in fault for fault in faults(path))
    assert any("metadata.yaml is missing" in fault for fault in faults(path)) == (given == "folder" and not metadata)


def test_sqlite_write_ahead_log_torn_at_its_end_gives_what_was_committed(tmp_path):
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    log = killed / "drive.db3-wal"
    log.write_bytes(log.read_bytes()[:-100])
    assert numbers(killed) == list(range(10))  # all after the tenth were one transaction
    assert any("counts 80 messages, the files hold 20; messages are lost" in fault for fault in faults(killed))


def test_sqlite_write_ahead_log_that_was_not_copied_is_missed(tmp_path):
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    (killed / "drive.db3-wal").unlink()
    assert numbers(killed / "drive.db3") == list(range(10))
    assert any("drive.db3-wal was not copied" in fault for fault in faults(killed / "drive.db3"))


def test_sqlite_stale_write_ahead_log_changes_nothing(tmp_path):
    write(tmp_path / "drive", "sqlite3")
    for junk in (b"", b"\0" * 5000, b"\x37\x7f\x06\x82" + bytes(5000)):
        (tmp_path / "drive" / "drive.db3-wal").write_bytes(junk)
        assert numbers(tmp_path / "drive") == list(range(MESSAGES))


def test_sqlite_hot_journal_is_rolled_back(tmp_path):
    """Killed in the middle of a transaction: pages are overwritten in the file, their old content is in the journal."""
    folder = write(tmp_path / "drive", "sqlite3")
    with contextlib.closing(sqlite3.connect(folder / "drive.db3")) as connection:
        connection.execute("PRAGMA cache_size=1")  # so that pages of an open transaction go to the file
        connection.execute("BEGIN")
        connection.execute("DELETE FROM messages WHERE id > 5")
        connection.execute("UPDATE messages SET data = zeroblob(5000)")
        connection.executemany(
            "INSERT INTO messages VALUES (?, 1, ?, zeroblob(3000))", [(i, START_NS) for i in range(900, 1100)]
        )
        killed = folder.with_name("killed")
        shutil.copytree(folder, killed)
        connection.rollback()
    assert (killed / "drive.db3-journal").read_bytes()[:4] == b"\xd9\xd5\x05\xf9"
    assert (killed / "drive.db3").read_bytes() != (folder / "drive.db3").read_bytes()
    before = content(killed)
    assert numbers(killed) == list(range(MESSAGES))
    assert content(killed) == before


@pytest.mark.parametrize("listed", ["all", "first two", "none"])
def test_sqlite_parts_of_which_the_last_has_a_log_are_read_whole(tmp_path, listed):
    folder = tmp_path / "drive"
    folder.mkdir()
    # more than ten parts: by their names, part 10 would come before part 2
    for part in range(12):
        one = write(tmp_path / f"part{part}", "sqlite3", 10 * part, 10)
        (one / f"part{part}.db3").rename(one / f"drive_{part}.db3")
        one = kill_with_log(one, 4) if part == 11 else one
        for file in one.glob("drive*"):
            shutil.copy(file, folder)
    names = [f"drive_{part}.db3" for part in range(12)]
    if listed != "none":
        text = (tmp_path / "part0" / "metadata.yaml").read_text()
        some = names if listed == "all" else names[:2]
        (folder / "metadata.yaml").write_text(text.replace("- part0.db3", "\n  - ".join(["", *some]).strip()))
    assert numbers(folder) == list(range(120))
    assert any("drive_11.db3-wal" in fault for fault in faults(folder))
    if listed == "first two":
        assert any("does not list drive_2.db3, " in fault for fault in faults(folder))


def test_sqlite_log_without_room_for_a_copy_is_refused_with_its_cure(tmp_path, monkeypatch):
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=100_000))
    with pytest.raises(BagError, match=r"drive\.db3-wal beside it.* no room .*sqlite3 '.*drive\.db3' 'PRAGMA wal_chec"):
        numbers(killed)
    monkeypatch.undo()
    tempfile.tempdir = str(tmp_path / "scratch")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(BagError, match=r"No space left on device; .*PRAGMA wal_checkpoint\(TRUNCATE\)"):
        numbers(killed)
    tempfile.tempdir = None


def test_sqlite_that_is_still_recorded_is_refused(tmp_path, monkeypatch):
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    copy = shutil.copyfile

    def while_it_grows(source, target):
        copy(source, target)
        with (killed / "drive.db3-wal").open("ab") as log:
            log.write(b"more")

    monkeypatch.setattr(shutil, "copyfile", while_it_grows)
    with pytest.raises(BagError, match="is being recorded; stop the recorder first"):
        numbers(killed)


def test_companions_of_a_database_given_alone_name_it(tmp_path):
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    for end in ("-wal", "-shm"):
        with pytest.raises(BagError, match=r"belongs to the database drive\.db3; give that"):
            numbers(killed / f"drive.db3{end}")
    with pytest.raises(BagError, match=r"describes a bag; give its folder"):
        numbers(killed / "metadata.yaml")


# ---------------------------------------------------------------- metadata.yaml


def edited(folder: Path, *changes: tuple[str, str]) -> Path:
    file = folder / "metadata.yaml"
    text = file.read_text()
    for pattern, replacement in changes:
        text, count = re.subn(pattern, replacement, text, flags=re.DOTALL)
        assert count, pattern
    file.write_text(text)
    return folder


QOS = [
    "'nonsense: ]['",
    "garbage",
    "17",
    "[1, text, {history: best_of_all}]",
    "[{history: 99, depth: -1, reliability: unheard_of}]",
    "'- history: 3\\n  depth: 0'",
    "{a: b}",
]


@pytest.mark.parametrize("qos", QOS)
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_metadata_of_any_quality_of_service_is_no_reason_to_find_nothing(tmp_path, storage, qos):
    folder = edited(write(tmp_path / "b", storage), (r"offered_qos_profiles: \[\]", f"offered_qos_profiles: {qos}"))
    assert numbers(folder) == list(range(MESSAGES))
    assert faults(folder) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ((r"message_count: 80\b", "message_count: 474"), "counts 474 messages, the files hold 80; messages are lost"),
        ((r"message_count: 80\b", "message_count: 7"), "counts 7 messages, the files hold 80"),
        ((r"message_count: 40\b", "message_count: 39"), r"other numbers .*: /imu \(39 and 40\), /odom \(39 and 40\)"),
        ((r"name: /imu", "name: /gone"), "topics that the files do not have: /gone"),
        ((r"name: /imu", "name: /gone"), "not all topics that the files have: /imu"),
        ((r"type: sensor_msgs/msg/Imu", "type: a/msg/B"), r"other types .*: /imu \(a/msg/B and sensor_msgs/msg/Imu\)"),
        ((r"duration:\n    nanoseconds: \d+", "duration:\n    nanoseconds: 99000000000"), r"says 99\.0 s"),
        ((r"(epoch: )\d+\n  storage", r"\1 5\n  storage"), "begins -17"),
        ((r"topics_with_message_count:.*", "topics_with_message_count: none"), "does not count"),
        ((r"- b\.(\w+)", r"- renamed.\1"), "lists files that are not there: renamed"),
    ],
)
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_metadata_that_contradicts_the_files_is_told(tmp_path, caplog, storage, change, says):
    folder = edited(write(tmp_path / "b", storage), change)
    with caplog.at_level(logging.WARNING), Bag(folder) as bag:
        assert len(list(bag.messages("/imu"))) == MESSAGES
        assert {topic.name: topic.count for topic in bag.topics} == {"/imu": MESSAGES, "/odom": MESSAGES}
        assert any(re.search(says, fault) for fault in bag.faults), bag.faults
    assert [record.getMessage() for record in caplog.records] == [f"{folder}: {fault}" for fault in bag.faults]


def test_metadata_of_versions_to_come_and_topics_without_messages_are_no_faults(tmp_path):
    empty = (
        "- message_count: 0\n    topic_metadata:\n      name: /never\n      type: std_msgs/msg/Empty\n  - message_count"
    )
    folder = edited(write(tmp_path / "b"), (r"version: 9", "version: 99"), (r"- message_count", empty))
    assert numbers(folder) == list(range(MESSAGES))
    assert faults(folder) == []


@pytest.mark.parametrize(
    "text", ["", "garbage", "{a: [", "\0", "[1, 2]", "rosbag2_bagfile_information: 3", "a: &a [*a]"]
)
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_metadata_of_garbage_falls_back_to_the_files(tmp_path, storage, text):
    folder = write(tmp_path / "b", storage)
    (folder / "metadata.yaml").write_text(text)
    assert numbers(folder) == list(range(MESSAGES))
    assert [fault for fault in faults(folder) if "metadata.yaml" in fault and "\n" not in fault]


def test_metadata_missing_falls_back_to_the_one_file(tmp_path):
    folder = write(tmp_path / "b")
    (folder / "metadata.yaml").unlink()
    (folder / "notes.txt").write_text("rain")
    assert numbers(folder) == list(range(MESSAGES))
    assert ["metadata.yaml is missing" in fault for fault in faults(folder)] == [True]


def test_metadata_that_lists_a_part_that_is_gone_is_refused(tmp_path):
    folder = edited(write(tmp_path / "b"), (r"- b\.mcap\n  ros", "- b.mcap\n  - b_1.mcap\n  ros"))
    with pytest.raises(BagError, match=r"b_1\.mcap is in metadata\.yaml, but missing"):
        numbers(folder)


@pytest.mark.parametrize(
    "names",
    [("a.mcap", "b.mcap"), ("a_0.mcap", "a_2.mcap"), ("a_1.mcap", "a_2.mcap"), ("a_01.mcap", "a_00.mcap")],
)
def test_folder_of_several_recordings_is_refused(tmp_path, names):
    one = write(tmp_path / "one") / "one.mcap"
    (tmp_path / "many").mkdir()
    for name in names:
        shutil.copy(one, tmp_path / "many" / name)
    with pytest.raises(BagError, match=rf"no bag, but a folder with {min(names)}, {max(names)}; give one of these"):
        numbers(tmp_path / "many")


# ---------------------------------------------------------------- names and kinds


@pytest.mark.parametrize("name", ["drive", "DRIVE.BAG", "drive.Mcap", "drive.db3", "drive.bag.active", "drive.txt"])
@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_is_what_its_first_bytes_say(tmp_path, storage, name):
    path = write(tmp_path / ("b.bag" if storage == "ros1" else "b"), storage)
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    shutil.copy(file, tmp_path / name)
    assert numbers(tmp_path / name) == list(range(MESSAGES))
    assert faults(tmp_path / name) == []


def test_bag_active_without_index_is_unfinished(tmp_path):
    data = bytearray(write(tmp_path / "b.bag", "ros1").read_bytes())
    at = data.index(b"index_pos=") + 10
    data[at : at + 8] = bytes(8)
    (tmp_path / "b.bag.active").write_bytes(data)
    with pytest.raises(BagError, match=r"did not finish it .*; 'rosbag reindex b\.bag\.active' may save it"):
        numbers(tmp_path / "b.bag.active")


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        (b"ros2", b"abcd", r"an MCAP of another system \(profile 'abcd'\)"),
        (b"ros2msg", b"ros1msg", f"encoded as 'ros1msg'; {FOREIGN}"),
        (b"cdr", b"abc", f"encoded as 'abc'; {FOREIGN}"),
    ],
)
def test_mcap_of_another_system_is_called_by_its_name(tmp_path, before, after, says):
    data = (write(tmp_path / "b") / "b.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(data.replace(before, after, 1 if before == b"ros2" else -1))
    with pytest.raises(BagError, match=says) as caught:
        numbers(tmp_path / "x.mcap")
    assert str(caught.value).count("x.mcap") == 1


def test_folder_device_pipe_and_other_database_are_no_bags(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with contextlib.closing(sqlite3.connect(tmp_path / "other.db3")) as connection:
        connection.execute("CREATE TABLE mine (x)")
        connection.commit()
    for path, says in (
        (tmp_path / "folder", r"no bag: a rosbag2 folder has a metadata\.yaml and \.mcap or \.db3 files"),
        (tmp_path / "pipe", "is a device or a pipe"),
        (Path("/dev/zero"), "is a device or a pipe"),
        (tmp_path / "other.db3", "an SQLite database, but no bag"),
    ):
        with pytest.raises(BagError, match=says):
            numbers(path)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_bag_compressed_by_file_or_message_is_read_with_and_without_metadata(tmp_path, storage, mode):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode

    with TinyBag(tmp_path / "b", storage=storage) as bag:
        pass
    shutil.rmtree(tmp_path / "b")
    bag = TinyBag(tmp_path / "b", storage=storage)
    bag.writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with bag:
        for i in range(MESSAGES):
            bag.imu("/imu", START_NS + i * 10**6, 0.1)
    assert numbers(tmp_path / "b") == list(range(MESSAGES))
    assert faults(tmp_path / "b") == []
    (tmp_path / "b" / "metadata.yaml").unlink()
    with Bag(tmp_path / "b", tell=False) as opened:
        rates = [opened.deserialize(message).angular_velocity.z for message in opened.messages("/imu")]
    assert rates == [0.1] * MESSAGES


def test_mcap_whose_index_miscounts_is_told(tmp_path):
    data = bytearray((write(tmp_path / "b") / "b.mcap").read_bytes())
    at = data.rindex((1).to_bytes(2, "little") + (MESSAGES).to_bytes(8, "little"))
    data[at + 2] = 99
    (tmp_path / "x.mcap").write_bytes(data)
    assert faults(tmp_path / "x.mcap") == [f"/imu: 99 messages by the index, {MESSAGES} were found"]


def test_mcap_without_counts_is_counted(tmp_path):
    data = bytearray((write(tmp_path / "b") / "b.mcap").read_bytes())
    for connection in (1, 2):
        at = data.rindex(connection.to_bytes(2, "little") + (MESSAGES).to_bytes(8, "little"))
        data[at + 2] = 0
    (tmp_path / "x.mcap").write_bytes(data)
    with Bag(tmp_path / "x.mcap", tell=False) as bag:
        assert {topic.name: topic.count for topic in bag.topics} == {"/imu": MESSAGES, "/odom": MESSAGES}


def test_bag_left_open_by_an_error_leaves_no_temporary_files(tmp_path, scratch):
    """A folder of which the second file is no bag: what was made for the first one goes."""
    killed = kill_with_log(write(tmp_path / "drive", "sqlite3"))
    shutil.move(killed / "drive.db3", killed / "drive_0.db3")
    shutil.move(killed / "drive.db3-wal", killed / "drive_0.db3-wal")
    (killed / "metadata.yaml").unlink()
    (killed / "drive_1.db3").write_bytes(b"SQLite format 3\0" + bytes(50))
    with pytest.raises(BagError, match="truncated"):
        numbers(killed)
    assert list(scratch.iterdir()) == []


def test_sound_bag_needs_no_temporary_files(tmp_path, scratch, monkeypatch):
    monkeypatch.setattr(storage.Workshop, "_place", lambda *_: pytest.fail("a temporary file"))
    for kind in ("sqlite3", "mcap"):
        assert numbers(write(tmp_path / kind, kind)) == list(range(MESSAGES))


def test_bag_folder_whose_bytes_are_whole_gives_the_same_as_its_file(tmp_path):
    drive = TinyDrive(seconds=1.0, width=64)
    with TinyBag(tmp_path / "b") as bag:
        fill(bag, drive)
    counts = []
    for path in (tmp_path / "b", tmp_path / "b" / "b.mcap"):
        with Bag(path) as opened:
            counts.append([(t.name, t.msgtype, t.count) for t in opened.topics])
            assert [t.name for t in opened.topics if t.msgtype == IMU] == ["/imu/data"]
    assert counts[0] == counts[1]
    assert np.all([count for *_, count in counts[0]])


# ---------------------------------------------------------------- single messages, and what is in between


@pytest.mark.parametrize(
    "content", [b"", b"\0\1\0\0", bytes(11), b"\0\1\0\0" + bytes(60), b"\x28\xb5\x2f\xfd no frame"]
)
@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_single_messages_that_are_damaged_are_counted_and_the_others_read(tmp_path, storage, content):
    path = tmp_path / ("b.bag" if storage == "ros1" else "b")
    with TinyBag(path, storage=storage) as bag:
        fill(bag, TinyDrive(seconds=0.5, width=64))
        for connection in bag.connections.values():
            bag.writer.write(connection, bag.recorded_ns, content)
    run = fuse(path)
    reasons = {one["reason"]: one["count"] for one in run.summary["unusable_messages"]}
    assert reasons == {
        "/imu/data: damaged: no sensor_msgs/Imu by its bytes": 1,
        "/odom: damaged: no nav_msgs/Odometry by its bytes": 1,
        "/ground_truth/odom: damaged: no nav_msgs/Odometry by its bytes": 1,
        "image: damaged: no sensor_msgs/CompressedImage by its bytes": 1,
    }
    assert "samples_lost" in [warning.code for warning in run.warnings]
    assert run.summary["images"]["ok"] == 5
    told = [line for line in inspect_bag(path, Settings()).splitlines() if line.startswith("problem: ")]
    assert "problem: /imu/data: 1 messages are damaged: their bytes are none of their type" in told


def test_topic_of_damaged_messages_alone_is_refused_with_what_to_do(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.imu("/imu", START_NS, 0.1)
        kind = bag.writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=bag.store)
        bag.writer.write(kind, bag.recorded_ns, b"\0\1\0\0nothing")
    with pytest.raises(
        BagError, match=r"/odom: none of its 1 messages is usable: damaged: .*; choose another topic, or"
    ):
        fuse(tmp_path / "b")
    assert fuse(tmp_path / "b", odometry_topic="none").summary["topics"]["gyro"] == "/imu"


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5])
def test_mcap_that_breaks_off_in_its_middle_is_refused_as_a_truncated_one(tmp_path, share):
    """What follows is lost though the index at the end is whole: a yaw that ends there is not that of the drive."""
    data = bytearray((write(tmp_path / "b") / "b.mcap").read_bytes())
    at = int(share * len(data))  # of which the last third are definitions and index
    data[at : at + 4096] = bytes(4096)
    (tmp_path / "x.mcap").write_bytes(data)
    with pytest.raises(BagError, match=r"x\.mcap: bag is (truncated or )?damaged .*mcap recover x\.mcap"):
        numbers(tmp_path / "x.mcap")


@pytest.mark.parametrize("name", ["50%", "a%20b", "drive #2", "what?", "a?mode=rw&x", "\udcff"])
@pytest.mark.parametrize("as_folder", [False, True])
def test_sqlite_is_read_whatever_its_name_and_folder(tmp_path, name, as_folder):
    write(tmp_path / "b", "sqlite3")
    path = tmp_path / name if as_folder else tmp_path / f"{name}.db3"
    (tmp_path / "b" if as_folder else tmp_path / "b" / "b.db3").rename(path)
    assert numbers(path) == list(range(MESSAGES))


def test_what_the_library_says_is_cut_to_a_line(tmp_path):
    """It quotes all definitions of a bag where one of them cannot be parsed."""
    data = (write(tmp_path / "b") / "b.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(data.replace(b"std_msgs/Header header", b"========/Header header"))
    with pytest.raises(BagError) as caught:
        numbers(tmp_path / "x.mcap")
    assert len(str(caught.value)) < len(str(tmp_path)) + 300
    assert str(caught.value).endswith("may save it")
