"""Circles of fisheye lenses and mirrors, found in images and in a recording, against what was rendered."""

from __future__ import annotations

import math
from dataclasses import replace

import camera_models as camera
import cv2
import numpy as np
import pytest
from panoramas import as_bytes, scene
from tiny_bags import TinyBag, TinyDrive, fill

from compass import CompassConfig
from fusion.offline.circles import with_circles
from fusion.offline.cli import main
from fusion.settings import load_settings

pytestmark = pytest.mark.usefixtures("without_plot")

R = math.radians
SIZE = 480


@pytest.fixture(scope="module")
def panoramas():
    image = scene(6, 1024, 512)
    return [as_bytes(np.roll(image, 77 * k, axis=1)) for k in range(6)]


def lit(image, seed):
    """With a camera's noise and the faint light that its surround has."""
    return as_bytes(np.maximum(image.astype(np.float32), 3.0), 2.0, seed)


def found_in(make, panoramas, config):
    return with_circles([lit(make(one), seed) for seed, one in enumerate(panoramas)], config)


@pytest.mark.parametrize("view", [186.0, 195.0, 206.0])
@pytest.mark.parametrize("stacked", [False, True])
def test_dual_fisheye_circles_and_overlap(panoramas, view, stacked):
    make = lambda p: camera.dual_fisheye(p, SIZE, R(view), stacked=stacked, fill=0.9)  # noqa: E731
    config, found = found_in(make, panoramas, CompassConfig(projection="dual_fisheye"))
    height, width = (2 * SIZE, SIZE) if stacked else (SIZE, 2 * SIZE)
    centres = [(SIZE / 2, SIZE / 2), (SIZE / 2, 1.5 * SIZE) if stacked else (1.5 * SIZE, SIZE / 2)]
    given = (config.circle_x, config.circle_y), (config.circle2_x, config.circle2_y)
    for (x, y), centre in zip(given, centres, strict=True):
        assert (x * width, y * height) == pytest.approx(centre, abs=0.5)  # pixels
    # a soft edge ends up to a pixel further out, and the field of view follows it: what counts is their ratio
    assert config.circle_radius * height == pytest.approx(0.45 * SIZE, abs=1.5)
    focal = config.circle_radius * height / (0.5 * R(config.field_of_view_deg))
    assert focal == pytest.approx(0.45 * SIZE / (0.5 * R(view)), rel=0.002)
    assert "correlation" in found["field_of_view_deg"][1]


def test_lenses_without_overlap_have_no_field_of_view_to_be_found(panoramas):
    make = lambda p: camera.dual_fisheye(p, SIZE, R(178), fill=0.9)  # noqa: E731
    config, found = found_in(make, panoramas, CompassConfig(projection="dual_fisheye"))
    assert found["field_of_view_deg"][0] is None
    assert config.field_of_view_deg == 0.0


def test_ring_radii(panoramas):
    make = lambda p: camera.ring(p, SIZE, 70, 215, (R(-60), R(20)))  # noqa: E731
    config, _ = found_in(make, panoramas, CompassConfig(projection="ring"))
    assert config.ring_inner * SIZE == pytest.approx(70, abs=2.5)
    assert config.circle_radius * SIZE == pytest.approx(215, abs=1.5)
    given, found = found_in(make, panoramas, CompassConfig(projection="ring", ring_inner=0.2))
    assert given.ring_inner == 0.2
    assert "ring_inner" not in found


def test_circle_with_a_flare_and_a_pole_across_its_edge(panoramas):
    def make(p):
        image = camera.fisheye(p, SIZE, (251.0, 233.0), 200 / R(95), R(190))
        cv2.circle(image, (420, 120), 40, 255, -1)  # light beyond the edge
        image[400:, 240:262] = 0
        return image

    config, _ = found_in(make, panoramas, CompassConfig(projection="fisheye"))
    assert (config.circle_x * SIZE, config.circle_y * SIZE) == pytest.approx((251.5, 233.5), abs=0.8)
    assert config.circle_radius * SIZE == pytest.approx(200, abs=1.5)


def test_image_without_a_dark_surround_has_no_circle(panoramas):
    config, found = found_in(lambda p: p, panoramas, CompassConfig(projection="fisheye"))
    assert found["circle_radius"][0] is None
    assert config.circle_radius == 0.0


def test_panoramas_are_left_alone(panoramas):
    config = CompassConfig()
    assert found_in(lambda p: p, panoramas, config) == (config, {})


class DualFisheye(TinyDrive):
    """A tiny drive seen by two lenses, upside down."""

    def panorama(self, t, seed=5):
        large = replace(TinyDrive(**{name: getattr(self, name) for name in self.__dataclass_fields__}), width=512)
        return camera.dual_fisheye(large.panorama(t, seed), 240, R(196), fill=0.9)[::-1, ::-1]


def test_calibrate_writes_the_camera_that_fuse_reads(tmp_path, capsys):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, DualFisheye(seconds=9.0))
    settings = "/**:\n  ros__parameters:\n    compass: {projection: dual_fisheye, image_rotation_deg: 180}\n"
    (tmp_path / "camera.yaml").write_text(settings)
    out = tmp_path / "found.yaml"
    assert main(["calibrate", str(tmp_path / "bag"), "--config", str(tmp_path / "camera.yaml"), "--out", str(out)]) == 0
    camera_found = load_settings(out).compass
    assert (camera_found.projection, camera_found.image_rotation_deg) == ("dual_fisheye", 180)
    assert camera_found.circle_radius == pytest.approx(0.45, abs=0.01)
    assert camera_found.field_of_view_deg == pytest.approx(196, abs=3.0)
    told = capsys.readouterr().out
    assert "compass.field_of_view_deg: " in told
    assert main(["fuse", str(tmp_path / "bag"), "--config", str(out), "--out", str(tmp_path / "out")]) == 0
    assert "not_full_circle" not in capsys.readouterr().out
    yaw = np.genfromtxt(tmp_path / "out" / "yaw.csv", delimiter=",", names=True)
    assert yaw["compass_yaw"][-1] == pytest.approx(float(TinyDrive().yaw(9.0)), abs=R(2.0))
    assert main(["inspect", str(tmp_path / "bag"), "--config", str(out), "--roi-preview", str(tmp_path / "r.png")]) == 0
    assert cv2.imread(str(tmp_path / "r.png")).shape[1] >= 2 * cv2.imread(str(tmp_path / "r.png")).shape[0] - 2
