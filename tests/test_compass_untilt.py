"""A tilt that an IMU tells of, taken out of the view before it is compared."""

import math

import cv2
import numpy as np
import pytest
from panoramas import PHOTO_NAMES, PHOTOS, as_bytes, azimuths, photo, scene, seen_from, shifted, tilted
from scipy.spatial.transform import Rotation

from compass import CompassConfig, VisualCompass
from compass.mask import RobotMask
from compass.match import Search
from compass.parallax import match_parallax
from compass.strip import prepare_strip
from compass.untilt import tilt_between, untilted

WIDTH, HEIGHT = 1024, 512
PER_RAD = WIDTH / math.tau
LEVEL = (0.0, 0.0, 1.0)


def up_of(attitude):
    return tuple(attitude.inv().apply([0.0, 0.0, 1.0]).tolist())


def camera_after(before, tilt, turn):
    """Attitude of a camera whose scene rotated by `tilt` before it turned."""
    return before * Rotation.from_rotvec([-tilt[0], -tilt[1], 0.0]) * Rotation.from_rotvec([0.0, 0.0, turn])


@pytest.mark.parametrize("seed", range(20))
def test_tilt_is_the_one_that_brings_one_vertical_over_the_other(seed):
    rng = np.random.default_rng(seed)
    before = Rotation.from_euler("ZYX", rng.uniform([-3.0, -0.6, -0.6], [3.0, 0.6, 0.6]))
    tilt, turn = rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0)
    found = tilt_between(up_of(before), up_of(camera_after(before, tilt, turn)), turn)
    assert found == pytest.approx(tilt, abs=1e-12)


def test_turn_on_a_slope_is_no_tilt():
    slope = Rotation.from_euler("y", 20.0, degrees=True)
    for turn in (0.0, 0.5, -2.0, 3.1):
        found = tilt_between(up_of(slope), up_of(slope * Rotation.from_euler("z", turn)), turn)
        assert found == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("turn_px", [0.0, 40.0, -300.0])
@pytest.mark.parametrize("degrees", [0.5, 3.0, 8.0])
@pytest.mark.parametrize("about", [0.0, 1.0, 2.5])
def test_untilted_view_is_that_of_a_camera_that_only_turned(about, degrees, turn_px):
    tilt = np.deg2rad(degrees) * np.array([math.cos(about), math.sin(about)])
    turned, leant = (
        as_bytes(shifted(image, turn_px)) for image in (scene(3, WIDTH, HEIGHT), tilted(scene(3, WIDTH, HEIGHT), *tilt))
    )
    config = CompassConfig()
    expected, seen = prepare_strip(0, turned, config), prepare_strip(0, leant, config)
    moved = untilted(seen, tuple(tilt), turn_px / PER_RAD, WIDTH / 2)
    rows = slice(*(round(edge) for edge in (0.15 * len(seen.pixels), 0.85 * len(seen.pixels))))  # what both saw
    assert moved.contrast == pytest.approx(expected.contrast, rel=0.1)
    left, before = (float(np.std((one.pixels - expected.pixels)[rows])) for one in (moved, seen))
    # linear interpolation blurs the finest detail; means of rows at the edges are those of what was not seen
    assert left < 3.0
    assert left < 0.35 * before or degrees < 1.0


def test_mask_tilts_with_the_view():
    robot = np.zeros((HEIGHT, WIDTH), bool)
    robot[220:, 500:540] = True
    config, mask = CompassConfig(), RobotMask(robot)
    strip = prepare_strip(0, as_bytes(scene(1, WIDTH, HEIGHT)), config, "", mask)
    ahead_down = 0.0, math.radians(5.0)  # the scene had gone down ahead, where the robot is
    moved = untilted(strip, ahead_down, 0.0, WIDTH / 2)
    before, after = (np.flatnonzero(one.seen.pixels[:, 520] == 0.0)[0] for one in (strip, moved))
    assert abs(before - after) * strip.row_height == pytest.approx(math.radians(5.0), abs=strip.row_height)
    assert not moved.pixels[moved.seen.pixels == 0.0].any()
    np.testing.assert_allclose(moved.pixels.sum(axis=1), 0.0, atol=0.1)


def driven(before, seed, told):
    """Increment of a camera that drove past things, turned and tilted, and the true turn, rad."""
    rng = np.random.default_rng(seed)
    tilt, turn_px = np.deg2rad(rng.uniform(-3.0, 3.0, 2)), rng.uniform(-30.0, 30.0)
    far = 1.0 / (0.6 + 0.4 * np.cos(2.0 * azimuths(WIDTH) - rng.uniform(0.0, 6.0)))
    now = shifted(tilted(seen_from(before, 0.02, 0.0, far), *tilt), turn_px)
    up = up_of(camera_after(Rotation.identity(), tilt, turn_px / PER_RAD))
    compass = VisualCompass(CompassConfig(), (lambda t_ns: up if t_ns else LEVEL) if told else None)
    compass.update(0, as_bytes(before, 2.0, seed))
    return compass.update(10**8, as_bytes(now, 2.0, seed + 100)), turn_px / PER_RAD


def scenes(seed):
    return scene(seed, WIDTH, HEIGHT)


def photographs(seed):
    return photo(PHOTO_NAMES[seed % len(PHOTO_NAMES)])


needs_photos = pytest.mark.skipif(not PHOTOS.is_dir(), reason="the photographs are not there")


@pytest.mark.parametrize(
    ("pictures", "largest_px"), [(scenes, 0.08), pytest.param(photographs, 0.1, marks=needs_photos)]
)
def test_camera_that_tilts_sees_its_turn_if_an_imu_tells_how(pictures, largest_px):
    errors, variances, missed = [], [], 0
    for seed in range(12):
        increment, turn = driven(pictures(seed), seed, told=True)
        errors.append(increment.turn - turn)
        variances.append(increment.variance)
        guessed, _ = driven(pictures(seed), seed, told=False)
        missed += guessed is None or (guessed.turn - turn) ** 2 > 4.0 * errors[-1] ** 2
    rms_px = float(np.sqrt(np.mean(np.square(errors)))) * PER_RAD
    print(f"{rms_px:.3f} columns, without the IMU {missed} of 12 are worse by two or missing")
    assert rms_px < largest_px
    assert 0.2 < np.mean(np.square(errors) / variances) < 3.0
    assert missed >= 8


@pytest.mark.parametrize("degrees", [2.0, 10.0])
def test_imu_that_errs_does_no_harm(degrees):
    """The view itself tells that it has not tilted so: then the IMU's word is not used."""
    wrong = up_of(Rotation.from_euler("y", degrees, degrees=True))
    image = scene(0, WIDTH, HEIGHT)
    images = as_bytes(image, 1.0, 1), as_bytes(shifted(seen_from(image, 0.02, 0.0, 1.5), 12.3), 1.0, 2)
    turns = []
    for at in (lambda t_ns: None, lambda t_ns: wrong if t_ns else LEVEL):
        compass = VisualCompass(CompassConfig(), at)
        compass.update(0, images[0])
        turns.append(compass.update(10**8, images[1]).turn)
    assert turns[1] == turns[0]


def test_view_of_another_width_is_untilted_all_the_same():
    """Blocks of columns and rows that do not divide the strip."""
    small = cv2.resize(scene(2, WIDTH, HEIGHT), (500, 250), interpolation=cv2.INTER_AREA)
    config, tilt = CompassConfig(columns=500, rows=40), (0.02, -0.03)
    seen = prepare_strip(0, as_bytes(tilted(small, *tilt)), config)
    moved = untilted(seen, tilt, 0.0, 250.0)
    expected = prepare_strip(0, as_bytes(small), config)
    inner = slice(5, -5)
    assert np.std((moved.pixels - expected.pixels)[inner]) < 0.35 * np.std((seen.pixels - expected.pixels)[inner])


@pytest.mark.parametrize("up", [None, LEVEL, up_of(Rotation.from_euler("y", 0.1))], ids=["unknown", "level", "pitched"])
def test_nothing_in_common_is_no_turn_whatever_the_imu_tells(up):
    config, some = CompassConfig(), as_bytes(scene(0, WIDTH, HEIGHT))
    reference = prepare_strip(0, some, config, up=LEVEL)
    current = prepare_strip(1, np.zeros_like(some), config, up=up)
    assert match_parallax(reference, current, Search(0.0, WIDTH, WIDTH / 2)).variance_px2 == math.inf
