"""Videos and folders of images, with CSV files for the other sensors: as good as a bag, and refused in one line."""

import json
import math
import struct
import sys
import types
from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_bags import TinyDrive

from fusion.offline.cli import main
from fusion.offline.sensor_csv import nanoseconds
from fusion.settings import load_settings

pytestmark = pytest.mark.usefixtures("without_plot")

DRIVE = TinyDrive()
RATE = 10  # images a second
TURNED = math.degrees(float(DRIVE.yaw(DRIVE.seconds)))


def encoded(path: Path, drive: TinyDrive) -> Path:
    """The tiny drive, encoded without loss of the turn."""
    av = pytest.importorskip("av", reason="videos need PyAV")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=RATE)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 256, 128, "yuv420p", 8_000_000
        for t in drive.times(RATE):
            grey = drive.panorama(t)
            frame = av.VideoFrame.from_ndarray(np.repeat(grey[:, :, None], 3, axis=2), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    return encoded(tmp_path_factory.mktemp("video") / "ride.mp4", DRIVE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The tiny drive as pictures, listed in no order of time."""
    folder = tmp_path_factory.mktemp("folder") / "ride"
    folder.mkdir()
    lines = []
    for index, t in enumerate(DRIVE.times(RATE)):
        cv2.imwrite(str(folder / f"{index}.png"), DRIVE.panorama(t))
        lines.append(f"{index}.png,{1700000000 + t:.3f}")
    (folder / "times.csv").write_text("\n".join(["file,t", *lines[::-1]]) + "\n")
    return folder


def gyro_csv(path: Path, start: float = 0.0, separator: str = ",") -> Path:
    rows = [("t", "gx", "gy", "gz", "ax", "ay", "az")]
    rows += [(f"{start + t:.3f}", 0, 0, f"{DRIVE.turn_rate(t):.6f}", 0, 0, 9.81) for t in DRIVE.times(100)]
    path.write_text("\n".join(separator.join(map(str, row)) for row in rows) + "\n")
    return path


def odometry_csv(path: Path, start: float = 0.0) -> Path:
    rows = [f"{start + t:.3f},{DRIVE.yaw(t):.6f},0.0" for t in DRIVE.times(20)]
    path.write_text("\n".join(["t,yaw,speed", *rows]) + "\n")
    return path


def fuse(path: Path, out: Path, *options: object) -> dict:
    assert main(["fuse", str(path), "--out", str(out), *map(str, options)]) == 0
    return json.loads((out / "summary.json").read_text())


def test_video_alone_gives_the_turn(video, tmp_path):
    summary = fuse(video, tmp_path / "out")
    assert summary["images"]["ok"] + summary["images"]["first_frame"] == DRIVE.times(RATE).size
    # 30 increments, each right to a hundredth of a column of 1.4 deg; the codec's loss is within that
    assert summary["yaw"]["raw_compass"]["turned_deg"] == pytest.approx(TURNED, abs=30 * 0.01 * 360 / 256)


def test_video_with_sensors_and_truth_is_scored(video, tmp_path):
    (tmp_path / "truth.csv").write_text("t;yaw\n" + "".join(f"{t};{DRIVE.yaw(t)}\n" for t in DRIVE.times(20)))
    files = "--gyro", gyro_csv(tmp_path / "imu.csv"), "--odometry", odometry_csv(tmp_path / "odom.csv")
    summary = fuse(video, tmp_path / "out", *files, "--truth", tmp_path / "truth.csv")
    assert set(summary["yaw"]) == {"raw_compass", "gyro_alone", "tracks_alone", "fused"}
    for source in ("gyro_alone", "tracks_alone"):
        assert summary["yaw"][source]["worst_error_deg"] == pytest.approx(0.0, abs=0.05)  # their rate steps at 1 s
    assert abs(summary["yaw"]["fused"]["final_error_deg"]) < 0.5  # a third of a column
    assert summary["gyro_vertical"] == "gravity"
    assert not summary["warnings"]


def test_video_start_moves_the_video_into_the_clock_of_the_files(video, tmp_path):
    imu = gyro_csv(tmp_path / "imu.csv", 1_700_000_000.0, "\t")
    summary = fuse(video, tmp_path / "out", "--gyro", imu, "--video-start", "1700000000.000")
    assert summary["start_ns"] == 1_700_000_000_000_000_000
    assert summary["yaw"]["fused"]["turned_deg"] == pytest.approx(TURNED, abs=0.5)


def test_video_to_be_shown_upside_down_is_turned_upright(video, tmp_path):
    """A display matrix of 180 deg: without it the turn would come out with the wrong sign."""
    data, turned = video.read_bytes(), tmp_path / "turned.mp4"
    at = data.index(b"tkhd") + 4 + 40  # version and flags, times, and so on, up to the matrix (ISO 14496-12, 8.3.2)
    identity = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    assert data[at : at + 36] == identity
    matrix = struct.pack(">9i", -1 << 16, 0, 0, 0, -1 << 16, 0, 256 << 16, 128 << 16, 1 << 30)
    turned.write_bytes(data[:at] + matrix + data[at + 36 :])
    summary = fuse(turned, tmp_path / "out")
    # both axes are turned round: the yaw's sign, seen from above, is the other one
    assert summary["yaw"]["raw_compass"]["turned_deg"] == pytest.approx(-TURNED, abs=30 * 0.01 * 360 / 256)


def test_video_that_was_cut_says_how_much_is_missing(video, tmp_path):
    av = pytest.importorskip("av", reason="videos need PyAV")
    cut = tmp_path / "cut.mkv"
    with av.open(str(video)) as source, av.open(str(cut), "w") as sink:
        stream = sink.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(source.streams.video[0]):
            if packet.dts is not None:
                packet.stream = stream
                sink.mux(packet)
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (warning,) = fuse(cut, tmp_path / "out")["warnings"]
    assert warning["code"] == "samples_lost"
    assert "frames could be read" in warning["text"]


def test_video_of_variable_frame_rate_misses_nothing_where_its_container_counts_no_frames(tmp_path):
    av = pytest.importorskip("av", reason="videos need PyAV")
    path = tmp_path / "ride.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=RATE)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 256, 128, "yuv420p", 8_000_000
        for index, t in enumerate(DRIVE.times(RATE)):
            if index > 10 and index % 3:  # it got dark: longer exposures
                continue
            frame = av.VideoFrame.from_ndarray(np.repeat(DRIVE.panorama(t)[:, :, None], 3, axis=2), format="rgb24")
            frame.pts = index
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    summary = fuse(path, tmp_path / "out")
    assert summary["warnings"] == []
    assert summary["yaw"]["raw_compass"]["turned_deg"] == pytest.approx(TURNED, abs=30 * 0.01 * 360 / 256)


def test_folder_of_images_gives_the_turn_at_its_times(folder, tmp_path):
    summary = fuse(folder, tmp_path / "out", "--odometry", odometry_csv(tmp_path / "odom.csv", 1_700_000_000.0))
    assert summary["start_ns"] == 1_700_000_000_000_000_000
    assert summary["yaw"]["raw_compass"]["turned_deg"] == pytest.approx(TURNED, abs=30 * 0.01 * 360 / 256)
    assert summary["yaw"]["tracks_alone"]["turned_deg"] == pytest.approx(TURNED, abs=0.01)


def test_folder_with_missing_pictures_names_them(folder, tmp_path):
    broken = tmp_path / "ride"
    broken.mkdir()
    for picture in folder.glob("*.png"):
        (broken / picture.name).write_bytes(picture.read_bytes())
    (broken / "3.png").unlink()
    (broken / "4.png").write_bytes(b"nothing")
    (broken / "times.csv").write_text((folder / "times.csv").read_text() + "x.png,soon\n")
    summary = fuse(broken, tmp_path / "out")
    assert sum(one["count"] for one in summary["unusable_messages"]) == 3
    assert [one["code"] for one in summary["warnings"]] == ["samples_lost"]


REFUSED = {
    "no such video": (["no.mp4"], "no such file"),
    "no video inside": (["junk.mp4"], "cannot be read as a video"),
    "times by another clock": (["ride.mp4", "--gyro", "unix.csv"], "give --video-start"),
    "no time in common": (["ride.mp4", "--gyro", "unix.csv", "--video-start", "99"], "no time in common"),
    "column missing": (
        ["ride.mp4", "--gyro", "odom.csv"],
        "its columns are t, yaw, speed; wanted t (s)",
    ),
    "no number": (["ride.mp4", "--gyro", "words.csv"], "no row can be used: no number in yaw_rate ('0 | fast')"),
    "decimal commas": (["ride.mp4", "--gyro", "commas.csv"], "more cells than columns; decimals are set off by points"),
    "decimal commas, semicolons": (["ride.mp4", "--gyro", "semicolons.csv"], "no number in t ('0,01 | 0,5')"),
    "empty column": (["ride.mp4", "--odometry", "rates.csv"], "no number in yaw ('0 | 0.5 | ')"),
    "decimal commas of a folder": (["commas"], "more cells than columns; decimals are set off by points"),
    "binary": (["ride.mp4", "--gyro", "ride.mp4"], "no CSV text"),
    "device": (["ride.mp4", "--gyro", "/dev/zero"], "no regular file"),
    "empty": (["ride.mp4", "--odometry", "empty.csv"], "its columns are none"),
    "topics": (["ride.mp4", "--gyro-topic", "/imu"], "give --gyro and --odometry CSV files"),
    "pictures without times": (["pictures"], "2 pictures but no times.csv"),
    "times without pictures": (["times"], "no row can be used: has no rows"),
    "start of a folder": (["ride", "--video-start", "1"], "is for videos"),
    "gyro of a folder": (["ride", "--gyro", "embedded"], "has no gyro inside"),
}


@pytest.mark.parametrize(("arguments", "said"), REFUSED.values(), ids=REFUSED)
def test_video_or_folder_that_cannot_be_used_is_refused_in_a_line(
    arguments, said, video, folder, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("ride.mp4").symlink_to(video)
    Path("ride").symlink_to(folder)
    Path("junk.mp4").write_bytes(b"\x12\x34" * 4000)
    gyro_csv(Path("unix.csv"), 1_700_000_000.0)
    odometry_csv(Path("odom.csv"))
    Path("words.csv").write_text("t,yaw_rate\n0,fast\n")
    Path("commas.csv").write_text("t,yaw_rate\n" + "".join(f"{i // 10},{i % 10},0,5\n" for i in range(30)))
    Path("semicolons.csv").write_text("t;yaw_rate\n0,01;0,5\n")
    Path("rates.csv").write_text("t,yaw_rate,yaw\n0,0.5,\n")
    Path("empty.csv").write_text("")
    for name in ("pictures", "times", "commas"):
        Path(name).mkdir()
    for name in ("1.jpg", "2.PNG"):
        (Path("pictures") / name).write_bytes(b"")
    Path("times/times.csv").write_text("file,t\n")
    Path("commas/times.csv").write_text("file,t\n1.jpg,0,5\n")
    assert main(["fuse", *arguments, "--out", "out"]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not Path("out").exists()


def test_part_of_a_video_is_fused(video, tmp_path):
    imu = gyro_csv(tmp_path / "imu.csv")
    summary = fuse(video, tmp_path / "out", "--gyro", imu, "--start", "1.5", "--end", "2.5")
    assert (summary["start_ns"], summary["duration_s"]) == (1_500_000_000, pytest.approx(1.0))
    assert summary["images"]["ok"] + summary["images"]["first_frame"] == 11


def test_video_is_calibrated_from(tmp_path):
    drive = TinyDrive(seconds=8.0, body=True)
    ride, out = encoded(tmp_path / "ride.mp4", drive), tmp_path / "robot.yaml"
    (tmp_path / "imu.csv").write_text("t,yaw_rate\n" + "".join(f"{t},{drive.turn_rate(t)}\n" for t in drive.times(100)))
    assert main(["calibrate", str(ride), "--gyro", str(tmp_path / "imu.csv"), "--out", str(out)]) == 0
    assert load_settings(out).compass.roi_bottom < 0.7  # where the robot's body begins


def test_bag_with_files_of_sensors_is_refused(tiny_bag, tmp_path, capsys):
    assert main(["fuse", str(tiny_bag), "--gyro", "imu.csv", "--out", str(tmp_path / "out")]) == 1
    assert "go with a video or a folder" in capsys.readouterr().err


def test_video_without_pyav_names_the_extra(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "av", None)
    (tmp_path / "ride.mp4").write_bytes(b"")
    assert main(["fuse", str(tmp_path / "ride.mp4"), "--out", str(tmp_path / "out")]) == 1
    assert "visual-compass[video]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "column", "t_ns"),
    [("1700000000.123456789", "t", 1_700_000_000_123_456_789), ("1.5e3", "t", 1_500_000_000_000), ("7", "t_ns", 7)],
)
def test_stamps_of_a_csv_are_exact(text, column, t_ns):
    assert nanoseconds(text, column) == t_ns


@pytest.mark.parametrize("text", ["", "nan", "inf", "-1", "1e300", "12:30"])
def test_stamps_that_are_none_are_refused(text):
    with pytest.raises(ValueError, match=r"t is negative|no number in t"):
        nanoseconds(text)


def test_gyro_inside_the_video_is_levelled_like_any(video, tmp_path, monkeypatch):
    """What telemetry-parser gives: milliseconds of the video, deg/s, m/s^2; read from a real GoPro's video by hand."""

    class Parser:
        def __init__(self, path):
            assert path == str(video)

        def normalized_imu(self):
            rates = [(1e3 * t, math.degrees(DRIVE.turn_rate(t))) for t in DRIVE.times(100)]
            return [{"timestamp_ms": ms, "gyro": (0.0, rate, 0.0), "accl": (0.0, 9.81, 0.0)} for ms, rate in rates]

    monkeypatch.setitem(sys.modules, "telemetry_parser", types.SimpleNamespace(Parser=Parser))
    summary = fuse(video, tmp_path / "out", "--gyro", "embedded")
    assert summary["yaw"]["gyro_alone"]["turned_deg"] == pytest.approx(TURNED, abs=0.05)
    assert summary["gyro_vertical"] == "gravity"


def test_turn_before_the_first_increment_counts(tmp_path):
    """From the first image on, where the yaw is zero: of a camera alone nothing is known before the second."""
    times = [t for t in DRIVE.times(RATE) if t > 1.55]
    for t in times:
        cv2.imwrite(str(tmp_path / f"{t:.1f}.png"), DRIVE.panorama(t))
    (tmp_path / "times.csv").write_text("\n".join(["file,t", *(f"{t:.1f}.png,{t}" for t in times)]))
    turned = math.degrees(float(DRIVE.yaw(times[-1]) - DRIVE.yaw(times[0])))
    yaws = fuse(tmp_path, tmp_path / "out")["yaw"]
    for source in ("raw_compass", "fused"):
        assert yaws[source]["turned_deg"] == pytest.approx(turned, abs=0.1)


@pytest.mark.parametrize("seed", range(12))
def test_damaged_video_is_named_or_right(video, tmp_path, seed, capsys):
    """Bytes flipped anywhere: frames that FFmpeg would make up from others are left out, and all is told."""
    data, rng = bytearray(video.read_bytes()), np.random.default_rng(seed)
    for place in rng.integers(0, len(data), (1, 5, 50)[seed % 3]):
        data[place] ^= int(rng.integers(1, 256))
    path = tmp_path / "ride.mp4"
    path.write_bytes(data)
    code = main(["fuse", str(path), "--out", str(tmp_path / "out")])
    assert code in (0, 1)
    if code == 1:
        assert capsys.readouterr().err.count("\n") == 1
        return
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    yaw = summary["yaw"].get("raw_compass", {"turned_deg": math.nan})
    assert abs(yaw["turned_deg"] - TURNED) < 0.5 or summary["warnings"]
