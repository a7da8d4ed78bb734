"""What calibration finds in a recording, against what was put in."""

import json
import math

import cv2
import numpy as np
import pytest
from tiny_bags import TinyBag, TinyDrive, fill

from compass import VisualCompass
from compass.images.mask import load_mask
from compass.methods.sector_median import SectorShifts
from fusion.offline.cli import main
from fusion.offline.mounting import body_top, forward_column, static_pixels
from fusion.offline.scores import COMPASS, FUSED
from fusion.offline.summary import key_of
from fusion.settings import load_settings

pytestmark = pytest.mark.usefixtures("without_plot")

COLUMNS = 1024


def turning_frames(static_rows: slice, horizon: bool = False) -> list[np.ndarray]:
    """Texture that rolls by a seventh of the circle a frame, over texture that stays."""
    rng = np.random.default_rng(2)
    scene, body = (80 + 40 * rng.normal(size=(128, 256)) for _ in range(2))
    if horizon:
        scene = np.tile(scene[:, :1], (1, 256)) + 5 * rng.normal(size=scene.shape)
    frames = []
    for index in range(8):
        frame = np.roll(scene, 37 * index, axis=1)
        frame[static_rows] = body[static_rows]
        frames.append((frame + rng.normal(size=frame.shape)).astype(np.float32))
    return frames


def test_static_pixels_are_the_body_and_nothing_else():
    static = static_pixels(turning_frames(slice(90, None)))
    # Windows of 15 px straddle the edge by 7.
    assert static[98:].mean() > 0.99
    assert static[:82].mean() < 0.01
    assert body_top(static) == pytest.approx(90 / 128, abs=8 / 128)


def test_static_pixels_a_horizon_alike_all_around_is_no_body():
    assert static_pixels(turning_frames(slice(0, 0), horizon=True)).mean() < 0.01


def test_static_pixels_the_edge_of_a_roof_is_no_body():
    """A little further on it looks the same, so it stays as well as it turns away; and it does not go all around."""
    scene, body = (80 + 40 * np.random.default_rng(seed).normal(size=(128, 256)) for seed in (2, 3))
    scene[30:34, :90] += 300.0
    frames = [np.concatenate([np.roll(scene, 20 * i, axis=1)[:100], body[100:]]).astype(np.float32) for i in range(4)]
    assert static_pixels(frames)[20:44].mean() > 0.02
    static = static_pixels(frames, np.radians(360.0 * 20 / 256 * np.arange(4)))
    assert static[:92].mean() < 0.001
    assert static[108:].mean() > 0.99


def test_body_top_without_body_is_none():
    assert body_top(np.zeros((10, 10), bool)) is None


def pushed(ahead: float, size: float, rng: np.random.Generator, turn: float = 0.3) -> SectorShifts:
    """Sectors at random distances pushed away from the column `ahead` (fraction), with noise and a turn."""
    centre = np.arange(64) * COLUMNS / 64
    azimuth = 2 * math.pi * (centre / COLUMNS - ahead)
    push = size * rng.uniform(0.2, 1.0, 64) * np.sin(azimuth)
    ones = np.ones(64)
    return SectorShifts(centre, turn + push + rng.normal(0.0, 0.05, 64), 0.05 * ones)


@pytest.mark.parametrize("ahead", [0.0, 0.25, 0.5, 0.9])
def test_forward_column_is_where_everything_moves_away_from(ahead):
    rng = np.random.default_rng(6)
    found = forward_column([pushed(ahead, 2.0, rng) for _ in range(20)], COLUMNS)
    off = (found.column - ahead + 0.5) % 1.0 - 0.5
    assert abs(off) < 3 * found.sigma
    assert found.sigma < 5 / 360


def test_forward_column_in_the_far_is_not_guessed():
    rng = np.random.default_rng(6)
    assert forward_column([pushed(0.5, 0.0, rng) for _ in range(6)], COLUMNS) is None


def test_calibrate_proposes_what_was_put_in(tmp_path, capsys):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, TinyDrive(seconds=8.0, body=True))
    (tmp_path / "start.yaml").write_text("/**: {ros__parameters: {compass: {roi_bottom: 0.9}}}")
    command = ["calibrate", str(tmp_path / "bag"), "--out", str(tmp_path / "c.yaml")]
    assert main([*command, "--config", str(tmp_path / "start.yaml"), "--mask-preview", str(tmp_path / "m.png")]) == 0
    settings = load_settings(tmp_path / "c.yaml")
    assert settings.compass.roi_bottom < 0.71  # the body begins at 0.7
    assert settings.fusion.initial_scale == pytest.approx(1.2, abs=0.01)  # the tiny drive's tracks claim so much
    assert "forward_column: not found" in (tmp_path / "c.yaml").read_text()  # it never drives
    assert (tmp_path / "m.png").exists()
    assert "settings in" in capsys.readouterr().out


def test_calibrate_and_fuse_tell_how_late_the_images_are_stamped(tmp_path, capsys):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, TinyDrive(seconds=8.0, camera_delay=0.08))
    assert main(["calibrate", str(tmp_path / "bag"), "--out", str(tmp_path / "c.yaml")]) == 0
    settings = load_settings(tmp_path / "c.yaml")
    assert settings.fusion.camera_delay == pytest.approx(0.08, abs=0.01)
    capsys.readouterr()
    for more in ([], ["--config", str(tmp_path / "c.yaml")]):
        assert main(["fuse", str(tmp_path / "bag"), "--out", str(tmp_path / f"out{len(more)}"), *more]) == 0
        assert " ms after their exposure; taken into account" in capsys.readouterr().out
        summary = json.loads((tmp_path / f"out{len(more)}" / "summary.json").read_text())
        assert summary["camera_delay_s"] == pytest.approx(0.08, abs=3.0 * summary["camera_delay_sigma_s"])
        fused, compass = (summary["yaw"][key_of(source)]["final_error_deg"] for source in (FUSED, COMPASS))
        assert abs(fused) < 0.2 * abs(compass)  # 0.08 s at 0.5 rad/s: 2.3 deg


def test_calibrate_without_turning_is_refused(tiny_bag, tmp_path, capsys):
    assert main(["calibrate", str(tiny_bag), "--out", str(tmp_path / "c.yaml")]) == 1
    assert "calibration needs 120" in capsys.readouterr().err
    assert not (tmp_path / "c.yaml").exists()


def test_static_pixels_a_thin_mast_is_found_to_its_edges():
    frames = turning_frames(slice(0, 0))
    rng = np.random.default_rng(4)
    for frame in frames:
        frame[30:, 100:106] = 230.0 + rng.normal(size=(98, 6))
    static = static_pixels(frames)
    assert static[38:, 100:106].mean() > 0.95
    assert static[:, [*range(90), *range(116, 256)]].mean() < 0.01


def masted_bag(path):
    """A bag whose robot has, beside its body, a mast with a pattern in the middle of the picture."""
    rows = np.random.default_rng(8).uniform(30, 220, (32, 1))

    class Masted(TinyDrive):
        def panorama(self, t, seed=5):
            image = super().panorama(t, seed)
            image[: 32 * 3, 60:76] = np.repeat(rows, 3, axis=0).astype(np.uint8)
            return image

    with TinyBag(path) as bag:
        fill(bag, Masted(seconds=26.0, body=True))


def test_calibrate_writes_a_mask_that_the_compass_reads(tmp_path, capsys):
    masted_bag(tmp_path / "bag")
    out = tmp_path / "robots" / "one.yaml"
    assert main(["calibrate", str(tmp_path / "bag"), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "compass.mask: one_mask.png" in told
    assert "of the region of interest stay" in told
    assert "mask: one_mask.png" in out.read_text()
    settings = load_settings(out)
    robot = load_mask(settings.compass).robot
    region = robot[round(0.3 * len(robot)) : round(0.5 * len(robot))]  # windows straddle edges by 7 of 512
    assert region[:, 2 * 62 : 2 * 74].mean() > 0.95
    assert region[:, [*range(100), *range(172, 512)]].mean() < 0.02
    assert sorted(file.name for file in out.parent.iterdir()) == ["one.yaml", "one_mask.png"]
    assert VisualCompass(settings.compass).update(0, np.zeros((64, 128), np.uint8)) is None


def test_calibrate_without_anything_static_in_the_region_writes_no_mask(tmp_path, capsys):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, TinyDrive(seconds=26.0))
    assert main(["calibrate", str(tmp_path / "bag"), "--out", str(tmp_path / "c.yaml")]) == 0
    assert "compass.mask: not found" in capsys.readouterr().out
    assert load_settings(tmp_path / "c.yaml").compass.mask == ""
    assert not (tmp_path / "c_mask.png").exists()


class Contradicting(TinyDrive):
    """A tiny drive whose panoramas or gyro claim something else."""

    def __init__(self, change, **fields):
        super().__init__(**fields)
        object.__setattr__(self, "change", change)

    def panorama(self, t, seed=5):
        return self.change(super().panorama(t, seed))


def scaled_gyro(factor):
    class Scaled(TinyBag):
        def imu(self, topic, t_ns, rate):
            super().imu(topic, t_ns, factor * rate)

    return Scaled


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda image: image[:, ::-1], "mirrored or upside down"),
        (lambda image: image[::-1, ::-1], "mirrored or upside down"),
        (lambda image: cv2.resize(image[:, 64:192], (256, 128)), "full circle"),
        (lambda image: CALM ^ (image & 3), "do not turn with the robot"),
        (lambda image: CALM, "no second on end"),
    ],
    ids=["mirrored", "upside down", "half a circle", "do not turn", "frozen"],
)
def test_calibrate_refuses_panoramas_that_contradict_the_gyro(tmp_path, capsys, change, says):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, Contradicting(change, seconds=8.0))
    refused(tmp_path, capsys, says)


@pytest.mark.parametrize(
    ("factor", "says"), [(math.degrees(1.0), "deg/s"), (-1.0, "wrong sign"), (0.0, "does not measure turns")]
)
def test_calibrate_refuses_a_gyro_that_contradicts_the_panoramas(tmp_path, capsys, factor, says):
    with scaled_gyro(factor)(tmp_path / "bag") as bag:
        fill(bag, TinyDrive(seconds=8.0))
    refused(tmp_path, capsys, says)


def test_calibrate_refuses_panoramas_of_another_clock(tmp_path, capsys):
    class Late(TinyBag):
        def compressed(self, topic, t_ns, pixels, extension=".jpg"):
            super().compressed(topic, t_ns + 3600 * 10**9, pixels, extension)

    with Late(tmp_path / "bag") as bag:
        fill(bag, TinyDrive(seconds=8.0))
    refused(tmp_path, capsys, "no time in common")


def test_calibrate_without_another_witness_is_refused(tmp_path, capsys):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, TinyDrive(seconds=8.0))
    refused(tmp_path, capsys, "another witness", "--gyro-topic", "none", "--odometry-topic", "none")


CALM = TinyDrive().panorama(0.0)


def refused(tmp_path, capsys, says, *more):
    """One line that says why, and nothing written."""
    assert main(["calibrate", str(tmp_path / "bag"), "--out", str(tmp_path / "c.yaml"), *more]) == 1
    told = capsys.readouterr().err.strip()
    assert says in told
    assert "\n" not in told
    assert [file.name for file in tmp_path.iterdir()] == ["bag"]
