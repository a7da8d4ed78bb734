"""Images of other projections than the full equirectangular one: the same turn, whatever the camera."""

from __future__ import annotations

import math

import camera_models as camera
import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, START_NS, as_bytes, scene, show

from compass import CompassConfig, ConfigError, VisualCompass
from compass.images.projection import Circle, Fisheye
from compass.images.strip import prepare_strip

R = math.radians
WIDTH, HEIGHT = 2048, 1024
TURN_PX = 23  # of the panorama's 2048 columns, 4 deg
# Of a column of the strip's 1024: noise, the two interpolations, and that a column there is 2 in the panorama.
TOLERANCE_PX = 0.03

CAMERAS = {
    "equirectangular": (lambda p: p, {}),
    "upside_down": (lambda p: p[::-1, ::-1], {"image_rotation_deg": 180}),
    "mirrored": (lambda p: p[:, ::-1], {"mirrored": True}),
    "mirrored_upside_down": (lambda p: p[::-1], {"mirrored": True, "image_rotation_deg": 180}),
    "turned_90": (lambda p: np.rot90(p, 1), {"image_rotation_deg": 90}),
    "turned_270": (lambda p: np.rot90(p, -1), {"image_rotation_deg": 270}),
    "dual_fisheye": (
        lambda p: camera.dual_fisheye(p, 800, R(200)),
        {"projection": "dual_fisheye", "field_of_view_deg": 200.0, "circle_radius": 0.475},
    ),
    "dual_fisheye_stacked_lying": (
        lambda p: camera.dual_fisheye(p, 800, R(200), (R(90), R(-90)), stacked=True),
        {
            "projection": "dual_fisheye",
            "field_of_view_deg": 200.0,
            "circle_radius": 0.475 / 2,
            "circle_roll_deg": 90.0,
            "circle2_roll_deg": -90.0,
        },
    ),
    "dual_fisheye_exposed_unlike": (
        lambda p: camera.dual_fisheye(p, 800, R(200), gain=0.8),
        {"projection": "dual_fisheye", "field_of_view_deg": 200.0, "circle_radius": 0.475},
    ),
    "fisheye_up": (
        lambda p: camera.fisheye(p, 900, (430.0, 455.0), 400 / R(95), R(190)),
        {
            "projection": "fisheye",
            "field_of_view_deg": 190.0,
            "circle_x": 430.5 / 900,
            "circle_y": 455.5 / 900,
            "circle_radius": 400 / 900,
        },
    ),
    "fisheye_down_distorted": (
        lambda p: camera.fisheye(p, 900, (449.5, 449.5), 260.0, R(200), "down", (0.01, -0.004, 0.001, 0.0)),
        {
            "projection": "fisheye",
            "lens_looks": "down",
            "field_of_view_deg": 200.0,
            "fisheye_focal": 260 / 900,
            "fisheye_k1": 0.01,
            "fisheye_k2": -0.004,
            "fisheye_k3": 0.001,
            "roi_top": 0.45,
            "roi_bottom": 0.75,
        },
    ),
    "ring": (
        lambda p: camera.ring(p, 900, 120, 440, (R(-60), R(20))),
        {
            "projection": "ring",
            "ring_inner": 120 / 900,
            "circle_radius": 440 / 900,
            "ring_inner_elevation_deg": -60.0,
            "ring_outer_elevation_deg": 20.0,
            "roi_top": 0.4,
            "roi_bottom": 0.7,
        },
    ),
    "cylinder_of_270_deg": (
        lambda p: camera.cylinder(p, 1536, 800, R(270)),
        {"projection": "cylinder", "field_of_view_deg": 270.0},
    ),
    "part_of_the_sphere": (
        lambda p: camera.cylinder(p, 1536, 640, R(270), tangent=False),
        {"field_of_view_deg": 270.0},
    ),
}


@pytest.fixture(scope="module")
def panorama():
    return as_bytes(scene(4, WIDTH, HEIGHT))


def taken(name, panorama, columns, seed):
    """An image of a camera after a turn to the left by whole columns of the panorama, with noise."""
    return as_bytes(CAMERAS[name][0](np.roll(panorama, columns, axis=1)).astype(np.float32), 2.0, seed)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_turn_is_the_same_through_every_projection(panorama, name, sign):
    compass = VisualCompass(CompassConfig(**CAMERAS[name][1]))
    images = [taken(name, panorama, sign * columns, seed) for seed, columns in enumerate((0, 9, TURN_PX))]
    show(compass, *images)
    strip = prepare_strip(START_NS, images[0], compass.config)
    per_column = math.tau / strip.columns
    assert compass.yaw / per_column == pytest.approx(sign * TURN_PX * strip.columns / WIDTH, abs=TOLERANCE_PX)
    # and its error is one that its variance knows of
    assert abs(compass.yaw - sign * TURN_PX * math.tau / WIDTH) < 4.0 * math.sqrt(compass.yaw_variance)


@pytest.mark.parametrize("name", [name for name in CAMERAS if "unlike" not in name])
def test_strips_of_all_cameras_look_alike(panorama, name):
    """Azimuth and elevation are those of the panorama: the strip is a panorama's of the same region."""
    strip = prepare_strip(0, taken(name, panorama, 0, 0), CompassConfig(**CAMERAS[name][1]))
    elevation = strip.top - strip.row_height * (np.arange(len(strip.pixels)) + 0.5)
    rows = np.repeat((0.5 - elevation / math.pi)[:, None] * HEIGHT - 0.5, strip.columns, axis=1)
    columns = np.tile((np.arange(strip.columns) + 0.5) * WIDTH / strip.columns - 0.5, (len(strip.pixels), 1))
    soft = cv2.GaussianBlur(panorama.astype(np.float32), (0, 0), 1.0)
    seen = np.ones(rows.shape, bool) if strip.seen is None else strip.seen.clear_of(3)

    def likeness(right, down):
        """Of the strip and the panorama looked up this much further on, columns and rows of the strip."""
        x = (columns + right * WIDTH / strip.columns) % WIDTH
        y = rows + down * strip.row_height * HEIGHT / math.pi
        expected = cv2.remap(soft, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        expected -= (expected * seen).sum(axis=1, keepdims=True) / np.maximum(seen.sum(axis=1, keepdims=True), 1)
        return float(np.corrcoef(expected[seen], strip.pixels[seen])[0, 1])

    here = likeness(0, 0)
    assert here > 0.985
    for right, down, most in ((1, 0, 0.1), (0, 1, 0.25)):  # of a pixel off
        before, after = likeness(-right, -down), likeness(right, down)
        assert abs(0.5 * (after - before) / (after - 2.0 * here + before)) < most


@pytest.mark.parametrize("k", [(0.0, 0.0, 0.0, 0.0), (0.08, -0.02, 0.004, -0.001)])
def test_fisheye_is_that_of_opencv(k):
    rng = np.random.default_rng(2)
    azimuth, elevation = rng.uniform(-math.pi, math.pi, 200), rng.uniform(0.1, 1.5, 200)
    lens = Fisheye(Circle(0.52, 0.47, 0.4), R(190), "up", 0.31, k)
    x, y, shown = lens.locate(azimuth, elevation, 1000, 1200)
    level = np.cos(elevation)
    # the image's upper edge is ahead and its right one left: one looks up
    rays = np.stack([level * np.sin(azimuth), -level * np.cos(azimuth), np.sin(elevation)], axis=1)
    matrix = np.array([[310.0, 0.0, 0.52 * 1200 - 0.5], [0.0, 310.0, 0.47 * 1000 - 0.5], [0.0, 0.0, 1.0]])
    expected, _ = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), matrix, np.array(k))
    np.testing.assert_allclose(np.stack([x, y], axis=1)[shown], expected[:, 0][shown], atol=1e-6)
    assert shown.sum() > 150


@pytest.mark.parametrize("name", ["dual_fisheye", "fisheye_up", "upside_down", "turned_90"])
def test_a_mask_is_of_the_image_as_it_is_taken(panorama, tmp_path, name):
    """A pole in the image, white in its mask: the same columns of the strip are hidden."""
    make, settings = CAMERAS[name]
    pole = np.zeros((HEIGHT, WIDTH), np.uint8)
    pole[:, WIDTH // 4 - 20 : WIDTH // 4 + 20] = 255
    cv2.imwrite(str(tmp_path / "pole.png"), make(pole))
    config = CompassConfig(**settings, mask=str(tmp_path / "pole.png"))
    compass = VisualCompass(config)
    show(compass, taken(name, panorama, 0, 0))
    hidden = np.flatnonzero((compass._newest.seen.pixels == 0).all(axis=0))
    columns = compass._newest.columns
    assert hidden.min() == pytest.approx(columns / 4 - 20 * columns / WIDTH, abs=4)
    assert hidden.max() == pytest.approx(columns / 4 + 20 * columns / WIDTH, abs=4)


@pytest.mark.parametrize("name", ["dual_fisheye", "ring", "turned_90"])
def test_an_image_of_half_the_size_gives_the_same_strip(panorama, name):
    """Parameters are fractions: what is decoded at reduced size needs no others."""
    make, settings = CAMERAS[name]
    config = CompassConfig(**settings, columns=512)
    image = np.ascontiguousarray(make(panorama))
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    one, other = (prepare_strip(0, picture, config) for picture in (image, half))
    assert other.columns == one.columns
    assert other.top == pytest.approx(one.top, abs=0.6 * one.row_height)
    rows = min(len(one.pixels), len(other.pixels))
    assert np.corrcoef(one.pixels[:rows].ravel(), other.pixels[:rows].ravel())[0, 1] > 0.98


def test_colours_and_16_bits_are_unwrapped_as_grey_is(panorama):
    make, settings = CAMERAS["dual_fisheye"]
    grey, config = make(panorama), CompassConfig(**settings)
    expected = prepare_strip(0, grey, config).pixels
    colour = prepare_strip(0, np.repeat(grey[..., None], 3, axis=2), config).pixels
    deep = prepare_strip(0, grey.astype(np.uint16) * 257, config).pixels
    np.testing.assert_allclose(colour, expected, atol=1e-3)
    np.testing.assert_allclose(deep, expected, atol=1.0)


@pytest.mark.parametrize("name", ["cylinder_of_270_deg", "part_of_the_sphere", "equirectangular"])
def test_part_of_the_circle_is_no_fault_where_it_was_announced(name):
    """What is not seen is hidden, and only a full panorama's ends have to join."""
    compass = VisualCompass(CompassConfig(**CAMERAS[name][1]))
    part = as_bytes(scene(4, WIDTH, 320))[:, : WIDTH // 2]  # half a circle: its ends do not join
    for k in range(45):
        compass.update(START_NS + k * FRAME_NS, np.roll(part, 40 * k, axis=1) if k else part)
    announced = name != "equirectangular"
    assert compass._newest.seen is None or compass._newest.seen.share == pytest.approx(0.75, abs=0.03)
    assert (compass._newest.seen is not None) == announced
    assert (compass.circle.verdict is None) == announced


def test_region_that_the_image_does_not_show_says_what_it_shows(panorama):
    make, settings = CAMERAS["fisheye_down_distorted"]
    config = CompassConfig(**{**settings, "roi_top": 0.1, "roi_bottom": 0.4})
    with pytest.raises(ConfigError, match=r"72 .. 18 deg of elevation.* show 10 .. -90 deg"):
        VisualCompass(config).update(START_NS, make(panorama))


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"projection": "cylinder"}, "field_of_view_deg"),
        ({"image_rotation_deg": 45}, "0, 90, 180 or 270"),
        ({"projection": "ring", "ring_outer_elevation_deg": -60.0}, "must differ"),
        ({"projection": "pinhole"}, "dual_fisheye"),
    ],
)
def test_unusable_settings_say_what_would_do(settings, word):
    with pytest.raises(ConfigError, match=word):
        CompassConfig(**settings)
