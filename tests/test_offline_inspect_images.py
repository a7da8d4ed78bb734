"""What `inspect` says of videos and folders of images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from tiny_bags import TinyDrive

from fusion.offline.cli import main

DRIVE = TinyDrive()


def folder(path, picture, rate=10):
    path.mkdir()
    times = DRIVE.times(rate)
    for index, t in enumerate(times):
        cv2.imwrite(str(path / f"{index}.png"), picture(t))
    lines = [f"{index}.png,{5.0 + t:.3f}" for index, t in enumerate(times)]
    (path / "times.csv").write_text("\n".join(["file,t", *lines]) + "\n")
    return path, len(times)


def test_folder_says_size_rate_duration_and_what_to_type_next(tmp_path, capsys):
    path, count = folder(tmp_path / "my ride", DRIVE.panorama)
    assert main(["inspect", str(path), "--roi-preview", str(tmp_path / "roi.png")]) == 0
    said = capsys.readouterr().out
    assert f"{count} images of 256 x 128, 10.0 a second, {(count - 1) / 10:.1f} s" in said
    assert "nothing speaks against the full circle" in said
    assert f"visual-compass fuse '{path}' --gyro imu.csv" in said  # quoted, to be typed as it is
    assert "problem" not in said
    assert cv2.imread(str(tmp_path / "roi.png")).shape == (128, 256, 3)


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (lambda t: np.full((128, 256), 7, np.uint8), "problem: "),
        (lambda t: DRIVE.panorama(t)[:, ::-1][:, :200], "not as wide as a full circle usually is"),
    ],
    ids=["blank", "not 2:1"],
)
def test_folder_that_shows_no_panorama_is_told(tmp_path, capsys, picture, says):
    path, _ = folder(tmp_path / "ride", picture)
    assert main(["inspect", str(path)]) == 0
    said = capsys.readouterr().out
    assert says in said
    assert "nothing speaks against" not in said or says == "problem: "


@pytest.mark.parametrize("name", ["cut.mp4", "pictures", "topic"])
def test_what_cannot_be_inspected_is_one_line(tmp_path, capsys, name):
    pytest.importorskip("av", reason="videos need PyAV")
    path, more = tmp_path / name, []
    if name == "cut.mp4":
        path.write_bytes(b"\0\0\0\x18ftypmp42")
    else:
        folder(path, DRIVE.panorama)
        if name == "topic":
            more = ["--image-topic", "/pano"]
        else:
            (path / "times.csv").unlink()
    assert main(["inspect", str(path), *more]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(path) in said


def test_gyro_inside_a_video_is_told(tmp_path, capsys, monkeypatch):
    av = pytest.importorskip("av", reason="videos need PyAV")
    path = tmp_path / "ride.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 256, 128, "yuv420p"
        for t in DRIVE.times(10):
            colour = np.repeat(DRIVE.panorama(t)[:, :, None], 3, axis=2)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(colour, format="rgb24")))
        container.mux(stream.encode())
    readings = [{"timestamp_ms": 5.0 * k, "gyro": (0.0, 0.0, 1.0), "accl": (0.0, 0.0, 9.81)} for k in range(40)]
    parser = type("Parser", (), {"__init__": lambda self, name: None, "normalized_imu": lambda self: readings})
    monkeypatch.setitem(__import__("sys").modules, "telemetry_parser", type("module", (), {"Parser": parser}))
    assert main(["inspect", str(path)]) == 0
    said = capsys.readouterr().out
    assert "256 x 128, 10.0 a second" in said
    assert "gyro inside: 40 samples" in said
    assert "--gyro embedded" in said
