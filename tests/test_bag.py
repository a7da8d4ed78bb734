"""Bags in: every format, any order, and what is wrong with bad ones."""

import itertools
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

from fusion.imu.levelling import ImuConfig
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import Message
from fusion.offline.bag_writer import BagWriter
from fusion.offline.recording import BagRecording, in_order, read_recording
from fusion.offline.topics import TopicChoice, TopicRequest, choose_topics
from fusion.settings import TopicSettings

HUSKY = Path(__file__).parent.parent.parent / "shared" / "data" / "husky.bag"
DRIVE = TinyDrive()


def choose(path: Path, **request: str) -> TopicChoice:
    with Bag(path) as bag:
        return choose_topics(bag, TopicSettings(), TopicRequest(**request))


def read(bag: Bag, columns: int = 1024) -> BagRecording:
    return read_recording(bag, choose_topics(bag, TopicSettings()), ImuConfig(), columns)


def read_all(path: Path) -> None:
    with Bag(path) as bag:
        list(read(bag).frames())


def check_tiny(path: Path) -> None:
    """All samples are there, in order, with the values written."""
    with Bag(path) as bag:
        recording = read(bag)
        frames = list(recording.frames())
    gyro, odometry, truth = recording.gyro, recording.odometry, recording.truth
    np.testing.assert_array_equal(gyro.t_ns, START_NS + np.round(DRIVE.times(100.0) * 1e9).astype(np.int64))
    # the vertical is found from gravity, exact to rounding
    np.testing.assert_allclose(gyro.yaw_rate[[0, -1]], [0.01, 0.51], rtol=1e-9)
    np.testing.assert_allclose(odometry.yaw, 1.2 * DRIVE.yaw(DRIVE.times(20.0)), atol=1e-12)
    np.testing.assert_allclose(truth.yaw, DRIVE.yaw(DRIVE.times(20.0)), atol=1e-12)
    assert [frame.t_ns for frame in frames] == (START_NS + np.round(DRIVE.times(10.0) * 1e9)).astype(int).tolist()
    # JPEG at OpenCV's default quality of 95 keeps smooth texture within 2 grey values on average.
    assert np.abs(frames[7].image.astype(float) - DRIVE.panorama(0.7)).mean() < 2.0
    assert not recording.dropped


@pytest.mark.parametrize("images", ["compressed", "raw"])
@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_every_format_gives_the_same_samples(tmp_path, storage, images):
    path = tmp_path / ("tiny.bag" if storage == "ros1" else "tiny")
    with TinyBag(path, storage=storage) as bag:
        fill(bag, DRIVE, images=images)
    check_tiny(path)
    if storage != "ros1":  # the file inside the folder, on its own
        check_tiny(path / f"tiny.{'db3' if storage == 'sqlite3' else 'mcap'}")


def test_bag_recorded_out_of_order_is_read_by_stamp(tmp_path):
    with TinyBag(tmp_path / "tiny") as bag:
        fill(bag, DRIVE, shuffle=True)
    check_tiny(tmp_path / "tiny")


def test_bag_frames_stream_again_on_every_call(tiny_bag):
    with Bag(tiny_bag) as bag:
        recording = read(bag)
        first, second = ([frame.t_ns for frame in recording.frames()] for _ in range(2))
    assert first == second


def test_bag_frames_left_early_close_cleanly(tiny_bag):
    with Bag(tiny_bag) as bag:
        frames = read(bag).frames()
        assert next(frames).t_ns == START_NS
        frames.close()


def test_bag_wide_jpeg_is_decoded_no_larger_than_needed(tiny_bag):
    with Bag(tiny_bag) as bag:
        assert next(read(bag, columns=64).frames()).image.shape == (32, 64)


def test_in_order_window_bounds_what_is_held():
    stamps = [3, 1, 2, 0, 9, 8]
    messages = [Message("/t", "T", 0, stamp, b"") for stamp in stamps]
    consumed = itertools.count()
    source = (message for message in messages if next(consumed) >= 0)
    ordered = in_order(source, 3)
    assert next(ordered).stamp_ns == 0
    assert next(consumed) == 4  # one more than the window was read for it
    assert [message.stamp_ns for message in ordered] == [1, 2, 3, 8, 9]


# ---------------------------------------------------------------- topics


def write_topics(path: Path, *names: str) -> Path:
    with TinyBag(path) as bag:
        for name in names:
            kind = name.split("/")[1]
            if kind == "imu":
                bag.imu(name, START_NS, 0.1)
            elif kind == "odom":
                bag.odometry(name, START_NS, 0.0, 0.1)
            elif name.endswith("compressed"):
                bag.compressed(name, START_NS, np.zeros((8, 16), np.uint8))
            else:
                bag.image(name, START_NS, np.zeros((8, 16), np.uint8))
    return path


def test_topics_single_candidate_of_its_type_is_found(tmp_path):
    choice = choose(write_topics(tmp_path / "b", "/imu/own", "/odom/own", "/pano/own/compressed"))
    assert [topic.name for topic in choice] == ["/pano/own/compressed", "/imu/own", "/odom/own"]


def test_topics_known_name_wins_among_several(tmp_path):
    assert choose(write_topics(tmp_path / "b", "/imu/a", "/imu/data", "/imu/z")).gyro.name == "/imu/data"


def test_topics_without_messages_are_passed_over(tmp_path):
    """A recorder notes the topics of drivers that never spoke."""
    path = tmp_path / "b"
    with TinyBag(path) as bag:
        for name, kind in (("/imu/a", "sensor_msgs/msg/Imu"), ("/odom/a", "nav_msgs/msg/Odometry")):
            bag.writer.add_connection(name, kind, typestore=bag.store)
        bag.imu("/imu/b", START_NS, 0.1)
    choice = choose(path)
    assert choice.gyro.name == "/imu/b"
    assert choice.odometry is None
    with pytest.raises(BagError, match=r"/imu/a has no messages"):
        choose(path, gyro="/imu/a")


def test_topics_that_we_published_ourselves_are_no_odometry(tmp_path):
    """A bag recorded beside the nodes holds raw compass and fused yaw; fed back, the yaw would confirm itself."""
    ours = TopicSettings().compass_output_topic, TopicSettings().fused_output_topic
    path = tmp_path / "b"
    with TinyBag(path) as bag:
        bag.imu("/imu/data", START_NS, 0.1)
        for name in ours:
            bag.odometry(name, START_NS, 0.0, 0.1)
    assert choose(path).odometry is None
    with TinyBag(tmp_path / "c") as bag:
        for name in (*ours, "/robot1/compass_pose", "/robot1/odometry/fused", "/wheels"):
            bag.odometry(name, START_NS, 0.0, 0.1)
    assert choose(tmp_path / "c").odometry.name == "/wheels"


def test_topics_several_candidates_are_listed(tmp_path):
    path = write_topics(tmp_path / "b", "/imu/a", "/imu/b")
    with pytest.raises(BagError, match=r"several topics of type sensor_msgs/Imu: /imu/a, /imu/b; .*--gyro-topic"):
        choose(path)
    assert choose(path, gyro="/imu/b").gyro.name == "/imu/b"


def test_topics_same_camera_raw_and_compressed_is_one_candidate(tmp_path):
    path = write_topics(tmp_path / "b", "/pano/image", "/pano/image/compressed")
    assert choose(path).image.name == "/pano/image"
    assert choose(path, image="/pano/image/compressed").image.name == "/pano/image/compressed"


@pytest.mark.parametrize("depth", ["/pano/image/compressedDepth", "/depth/compressedDepth"])
def test_topics_compressed_depth_is_never_taken_for_the_panorama(tmp_path, depth):
    with TinyBag(tmp_path / "b") as bag:
        bag.bytes(depth, START_NS, bytes(12) + b"\x89PNG\r\n\x1a\n" + bytes(50))
        bag.imu("/imu/data", START_NS, 0.1)
    assert choose(tmp_path / "b").image is None
    with pytest.raises(BagError, match=rf"--image-topic {depth} is a compressedDepth image, distances and no picture"):
        choose(tmp_path / "b", image=depth)
    path = write_topics(tmp_path / "c", "/pano/image/compressed")
    with TinyBag(tmp_path / "d") as bag:
        bag.bytes(depth, START_NS, bytes(100))
        bag.compressed("/pano/image/compressed", START_NS, np.zeros((8, 16), np.uint8))
    assert choose(tmp_path / "d").image.name == choose(path).image.name == "/pano/image/compressed"


def test_bag_of_video_in_compressed_images_says_so(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for i in range(12):
            bag.bytes("/pano/compressed", START_NS + i, b"\0\0\0\1\x67" + bytes(50))
    with pytest.raises(
        BagError, match=r"/pano/compressed: no usable image among the first 12: video \(h264\).*key frame"
    ):
        read_all(tmp_path / "b")


def test_bag_whose_first_thirty_images_are_empty_is_read_on(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for i in range(30):
            bag.bytes("/pano/compressed", START_NS + i, b"" if i % 2 else b"no picture")
        bag.compressed("/pano/compressed", START_NS + 30, np.zeros((8, 16), np.uint8))
    with Bag(tmp_path / "b") as bag:
        recording = read(bag)
        (frame,) = recording.frames()
        assert frame.t_ns == START_NS + 30
        assert sum(recording.dropped.values()) == 30
        assert [warning.code for warning in recording.warnings] == ["samples_lost"]


def test_topics_none_leaves_a_sensor_out(tmp_path):
    choice = choose(write_topics(tmp_path / "b", "/imu/a", "/odom/a"), gyro="none")
    assert (choice.gyro, choice.odometry.name) == (None, "/odom/a")


def test_topics_requested_but_absent_lists_what_there_is(tmp_path):
    path = write_topics(tmp_path / "b", "/imu/a", "/odom/a")
    with pytest.raises(BagError, match=r"--gyro-topic /imu/c not in the bag; topics of type sensor_msgs/Imu: /imu/a"):
        choose(path, gyro="/imu/c")
    with pytest.raises(BagError, match=r"/odom/a is of type nav_msgs/Odometry"):
        choose(path, gyro="/odom/a")


def test_topics_nothing_usable_names_what_is_wanted_and_found(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.write("/chatter", bag.make("std_msgs/msg/String", data="hello"))
    with pytest.raises(BagError, match=r"no usable topic; wanted .*sensor_msgs/Imu.*; found /chatter \(std_msgs/Str"):
        choose(tmp_path / "b")


# ---------------------------------------------------------------- bad bags


def test_folder_named_like_a_ros1_bag_is_refused_with_its_cure(tmp_path):
    with pytest.raises(BagError, match=r"x\.bag: \.bag is for ROS 1; give a name that ends in \.mcap"):
        BagWriter(tmp_path / "x.bag")
    with BagWriter(tmp_path / "x") as bag:
        bag.write_odometry("/odom", 10**9, 0.1, 0.2)
    with pytest.raises(BagError, match=r"x\.bag: .*rename it"), Bag((tmp_path / "x").rename(tmp_path / "x.bag")):
        pass


@pytest.mark.parametrize("name", ["x.bag", "x.mcap", "x.db3", "x.txt"])
@pytest.mark.parametrize("content", [b"", b"no bag at all, " * 50])
def test_bag_of_other_content_is_no_bag(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError, match=rf"{name}: not a bag \(.*\); give a \.bag, an \.mcap"):
        choose(tmp_path / name)


def test_bag_absent_is_named(tmp_path):
    with pytest.raises(BagError, match=r"nowhere\.bag: no such file"):
        choose(tmp_path / "nowhere.bag")


def test_bag_folder_without_metadata_is_no_bag(tmp_path):
    with pytest.raises(BagError, match=r"metadata\.yaml"):
        choose(tmp_path)


@pytest.mark.parametrize("kept", [0.3, 0.7, 0.99, 0.9999])
@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_truncated_is_refused_with_a_remedy_or_its_cut_is_told(tmp_path, storage, kept):
    """What follows the cut is unknown: a yaw that ends early must not pass for the whole drive."""
    folder = tmp_path / "tiny"
    path = tmp_path / "tiny.bag" if storage == "ros1" else folder
    with TinyBag(path, storage=storage) as bag:
        fill(bag, TinyDrive(seconds=1.0))
    file = path if storage == "ros1" else next(p for p in folder.iterdir() if p.suffix != ".yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * kept)])
    if storage == "mcap" and kept > 0.9:  # its messages are in one chunk, before definitions and index
        with Bag(file, tell=False) as bag:
            assert "its end is missing" in bag.faults[0]
        return
    with pytest.raises(BagError, match=r"truncated or damaged .*(reindex|recover)"):
        read_all(file)


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_of_flipped_bytes_fails_only_as_a_bag_does(tmp_path, storage, seed, hostile_originals):
    """Hostile bytes anywhere: read what is sound, or one BagError; never another exception."""
    data = bytearray(hostile_originals[storage])
    rng = np.random.default_rng(seed)
    for place in rng.integers(0, len(data), 20):
        data[place] ^= int(rng.integers(1, 256))
    path = tmp_path / f"x.{ {'ros1': 'bag', 'sqlite3': 'db3', 'mcap': 'mcap'}[storage] }"
    path.write_bytes(data)
    with suppress(BagError):
        read_all(path)


@pytest.fixture(scope="module")
def hostile_originals(tmp_path_factory):
    originals = {}
    for storage in ("ros1", "sqlite3", "mcap"):
        path = tmp_path_factory.mktemp(storage) / ("tiny.bag" if storage == "ros1" else "tiny")
        with TinyBag(path, storage=storage) as bag:
            fill(bag, TinyDrive(seconds=0.5, width=64))
        file = path if storage == "ros1" else next(p for p in path.iterdir() if p.suffix != ".yaml")
        originals[storage] = file.read_bytes()
        shutil.rmtree(path, ignore_errors=True)
    return originals


# ---------------------------------------------------------------- bad messages


def test_bag_stamps_all_zero_are_refused(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for _ in range(3):
            bag.imu("/imu/data", 0, 0.1)
    with pytest.raises(BagError, match=r"/imu/data: none of its 3 messages is usable: header.stamp is zero"):
        read_all(tmp_path / "b")


def test_bag_image_stamps_all_zero_are_refused(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for _ in range(3):
            bag.compressed("/pano/compressed", 0, np.zeros((8, 16), np.uint8))
    with pytest.raises(BagError, match=r"/pano/compressed: no usable image among the first 3: header.stamp is zero"):
        read_all(tmp_path / "b")


def test_bag_single_zero_stamps_are_dropped_and_counted(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for t_ns in (0, START_NS, START_NS + 1000):
            bag.imu("/imu/data", t_ns, 0.1)
            bag.compressed("/pano/compressed", t_ns, np.zeros((8, 16), np.uint8))
    with Bag(tmp_path / "b") as bag:
        recording = read(bag)
        assert len(list(recording.frames())) == 2
    assert recording.gyro.t_ns.size == 2
    assert sum(recording.dropped.values()) == 2


def test_bag_unknown_encoding_ends_early_with_the_known_ones(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for i in range(310):
            bag.image("/pano", START_NS + i, np.zeros((8, 16), np.uint8), "16SC1")
    with pytest.raises(BagError, match=r"first 300: encoding '16SC1' is unknown; use one of: mono8"):
        read_all(tmp_path / "b")


def test_bag_corrupt_jpeg_between_good_ones_is_dropped_and_counted(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for i in range(6):
            if i == 3:
                bag.bytes("/pano/compressed", START_NS + i, b"\xff\xd8 broken")
            else:
                bag.compressed("/pano/compressed", START_NS + i, np.zeros((8, 16), np.uint8))
    with Bag(tmp_path / "b") as bag:
        recording = read(bag)
        assert [frame.t_ns - START_NS for frame in recording.frames()] == [0, 1, 2, 4, 5]
    assert sum(recording.dropped.values()) == 1


def test_bag_husky_has_its_totals():
    """Totals as the log's own page gives them, in whole degrees; the IMU stands with +Y up."""
    if not HUSKY.exists():
        pytest.skip("needs ../shared/data/husky.bag")
    with Bag(HUSKY) as bag:
        recording = read(bag)
    seconds = (recording.gyro.t_ns - recording.gyro.t_ns[0]) * 1e-9
    gyro = np.degrees(np.sum(np.diff(seconds) * 0.5 * (recording.gyro.yaw_rate[1:] + recording.gyro.yaw_rate[:-1])))
    wheels = np.degrees(np.unwrap(recording.odometry.yaw))
    assert gyro == pytest.approx(-206, abs=0.5)
    assert wheels[-1] - wheels[0] == pytest.approx(-198, abs=0.5)


def test_relative_and_absolute_names_of_the_settings_mean_the_same_topic(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        for name in ("/camera/imu", "/imu/data"):
            bag.imu(name, START_NS, 0.1)
        for name in ("/other/odom", "/odom"):
            bag.odometry(name, START_NS, 0.0, 0.1)
    with Bag(tmp_path / "b") as bag:
        for settings in (TopicSettings(), TopicSettings(gyro_topic="/imu/data", odometry_topic="/odom")):
            choice = choose_topics(bag, settings)
            assert (choice.gyro.name, choice.odometry.name) == ("/imu/data", "/odom")
        assert choose_topics(bag, TopicSettings(gyro_topic="none", odometry_topic="odom")).gyro is None
        assert choose_topics(bag, TopicSettings(gyro_topic="")).gyro is None
        asked = TopicRequest(gyro="camera/imu")  # as a node would name it
        assert choose_topics(bag, TopicSettings(gyro_topic="none"), asked).gyro.name == "/camera/imu"


def test_relative_name_is_found_in_the_namespace_of_the_one_robot(tmp_path):
    def gyros(folder, *names):
        with TinyBag(tmp_path / folder) as bag:
            for name in names:
                bag.imu(name, START_NS, 0.1)
        return tmp_path / folder

    one = ("/robot1/camera/imu", "/robot1/imu/data", "/robot2/camera/imu")
    assert choose(gyros("one", *one)).gyro.name == "/robot1/imu/data"
    with pytest.raises(BagError, match=r"several topics of type sensor_msgs/Imu: /robot1/imu/data, /robot2/imu/data;"):
        choose(gyros("two", *one, "/robot2/imu/data"))


def test_reasons_that_differ_by_numbers_alone_are_one(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.compressed("/pano/compressed", START_NS, np.zeros((8, 16), np.uint8))
        for i in range(1, 50):
            bag.bytes("/pano/compressed", START_NS + i, b"\xff\xd8" + bytes(i))
            bag.image("/pano", START_NS + i, np.zeros((8, 16 + i), np.uint8), "rgb8")
    for topic in ("/pano/compressed", "/pano"):
        with Bag(tmp_path / "b") as bag:
            choice = choose_topics(bag, TopicSettings(), TopicRequest(image=topic))
            recording = read_recording(bag, choice, ImuConfig(), 1024)
            with suppress(BagError):
                list(recording.frames())
            assert list(recording.dropped.values()) == [49]
