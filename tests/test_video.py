"""Panoramas that come as packets of a video: each with its own stamp, none that shows parts of an older one."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

pytest.importorskip("av", reason="videos need PyAV")
from video_packets import ENCODERS, Encoded, encode, write_packet

from compass import ImageError
from compass.images.codecs import codec_of
from compass.images.video import VideoDecoder
from fusion.imu.levelling import ImuConfig
from fusion.offline.bag import Bag
from fusion.offline.cli import main
from fusion.offline.recording import read_recording
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import TopicSettings

COUNT, GOP = 34, 10
NEXT_KEY = 10


@pytest.fixture(scope="module")
def pictures():
    """Unlike each other by far more than compression leaves."""
    scene = TinyDrive(width=256).panorama(0.0)
    return [np.roll(scene, 9 * index, axis=1) for index in range(COUNT)]


@pytest.fixture(scope="module")
def videos(pictures):
    return {kind: encode(pictures, kind, GOP) for kind in ENCODERS}


def decoded(kind, packets):
    """(stamp, picture) of all that come out, and how many packets gave none, by reason."""
    decoder, out = VideoDecoder(kind.partition("_")[0]), []
    for packet in packets:
        try:
            out += decoder.decode(START_NS + packet.index, packet.data)
        except ImageError:
            continue
    return [(t_ns - START_NS, image) for t_ns, image in out + decoder.rest()], decoder.skipped


def assert_true(out, pictures):
    """Each picture is the one of its stamp, in the order of capture."""
    indices = [index for index, _ in out]
    assert indices == sorted(set(indices))
    for index, image in out:
        assert np.abs(image.astype(int) - pictures[index]).mean() < 4.0  # another one is off by 30 and more


@pytest.mark.parametrize("kind", ENCODERS)
def test_every_packet_gives_the_picture_of_its_stamp(pictures, videos, kind):
    out, skipped = decoded(kind, videos[kind])
    assert_true(out, pictures)
    assert len(out) == COUNT
    assert not skipped


@pytest.mark.parametrize("kind", ["h264", "hevc"])
def test_without_b_frames_no_picture_is_held_back(videos, kind):
    decoder = VideoDecoder(kind)
    assert all(len(decoder.decode(one.index, one.data)) == 1 for one in videos[kind])


@pytest.mark.parametrize("kind", ENCODERS)
@pytest.mark.parametrize("lost", [1, 4])
def test_after_a_lost_packet_pictures_begin_again_at_the_next_key_frame(pictures, videos, kind, lost):
    packets = videos[kind]
    out, skipped = decoded(kind, packets[:3] + packets[3 + lost :])
    assert_true(out, pictures)
    indices = {index for index, _ in out}
    assert set(range(NEXT_KEY, COUNT)) <= indices
    if kind == "hevc_b_frames" and lost == 1:  # one that no other needs: nothing else is missing
        assert indices == set(range(COUNT)) - {packets[3].index}
        return
    assert sum(skipped.values()) == NEXT_KEY - 3 - lost
    assert any("key frame" in reason for reason in skipped)


@pytest.mark.parametrize("kind", ENCODERS)
def test_a_stream_that_was_joined_late_starts_at_a_key_frame(pictures, videos, kind):
    out, skipped = decoded(kind, videos[kind][4:])
    assert_true(out, pictures)
    assert out[0][0] == NEXT_KEY
    assert skipped["waits for a key frame"] == NEXT_KEY - 4


@pytest.mark.parametrize("kind", ENCODERS)
def test_a_damaged_packet_harms_no_picture_after_the_next_key_frame(pictures, videos, kind):
    packets = list(videos[kind])
    damaged = bytearray(packets[5].data)
    damaged[len(damaged) // 2 :] = bytes(len(damaged) - len(damaged) // 2)
    packets[5] = Encoded(packets[5].index, False, bytes(damaged))
    out, _ = decoded(kind, packets)
    later = [(index, image) for index, image in out if index >= NEXT_KEY]
    assert_true(later, pictures)
    assert len(later) == COUNT - NEXT_KEY


def test_nonsense_is_a_fault_and_no_crash():
    rng = np.random.default_rng(0)
    for codec in ("h264", "hevc"):
        decoder = VideoDecoder(codec)
        for size in (0, 1, 5, 300):
            with pytest.raises(ImageError):
                decoder.decode(0, b"\0\0\1" + rng.bytes(size))


@pytest.mark.parametrize(
    ("name", "begin", "codec"),
    [
        ("h264", b"\0\0\0\1\x67", "h264"),
        ("H.265", b"\0\0\1\x40", "hevc"),
        ("hevc_nvenc", b"\0\0\1\x40", "hevc"),
        ("", b"\0\0\0\1\x67", "h264"),
        ("", b"\0\0\0\1\x40", "hevc"),
        ("libx264", b"\0\0\1\x06", "h264"),
        ("rgb8; jpeg compressed bgr8", b"\xff\xd8\xff\xe0", ""),
        ("h264", b"\xff\xd8\xff\xe0", ""),
        ("png", b"\x89PNG\r\n", ""),
    ],
)
def test_codec_is_told_by_name_and_bytes(name, begin, codec):
    assert codec_of(name, begin) == codec


def test_without_pyav_the_fault_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImageError, match=r"pip install 'visual-compass\[video\]'"):
        VideoDecoder("h264")


def video_bag(path, carrier, storage="mcap", drop=(), kind="h264"):
    """A tiny drive whose panoramas are a video."""
    drive = TinyDrive()
    with TinyBag(path, storage=storage) as bag:
        times = drive.times(10.0)
        packets = encode([drive.panorama(t) for t in times], kind, GOP)
        fill(bag, drive, images="none")
        for place, packet in enumerate(packets):
            if place not in drop:
                write_packet(bag, carrier, START_NS + round(times[packet.index] * 1e9), packet)
    return path


@pytest.mark.parametrize("carrier", ["image", "foxglove", "ffmpeg"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
def test_videos_in_bags_are_found_by_type_and_read(tmp_path, carrier, storage):
    path = video_bag(tmp_path / ("a.bag" if storage == "ros1" else "a"), carrier, storage, kind="h264_b_frames")
    with Bag(path) as bag:
        choice = choose_topics(bag, TopicSettings(), TopicRequest())
        recording = read_recording(bag, choice, ImuConfig(), 256)
        stamps = [frame.t_ns - START_NS for frame in recording.frames()]
    assert choice.image.name.startswith("/pano/")
    assert stamps == [round(t * 1e9) for t in TinyDrive().times(10.0)]
    assert not recording.dropped


def test_fusing_a_video_with_a_lost_packet_gives_the_yaw_and_says_what_is_missing(tmp_path):
    path = video_bag(tmp_path / "a", "ffmpeg", drop=(23,))
    assert main(["fuse", str(path), "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    told = " ".join(warning["text"] for warning in summary["warnings"])
    assert "6 unusable: image: video (h264) waits for a key frame" in told
    yaw = np.genfromtxt(tmp_path / "out" / "yaw.csv", delimiter=",", names=True)
    true = float(TinyDrive().yaw(3.0))
    assert yaw["fused_yaw"][-1] == pytest.approx(true, abs=math.radians(0.5))
