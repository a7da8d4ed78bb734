"""Full circle or not: told from the pictures alone, and never said of a panorama that is one."""

import math

import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, PHOTO_NAMES, START_NS, as_bytes, photo, scene, shifted

from compass import CompassConfig, VisualCompass
from compass.images import full_circle
from compass.images.full_circle import EVERY, VIEWS

WIDTH, HEIGHT = 512, 256
SCENE = scene(4, WIDTH, HEIGHT)
STEP = 4.0 * EVERY  # columns from one image that is looked at to the next


@pytest.fixture(autouse=True)
def look_at_each(monkeypatch):
    """The images between have no say in the verdict."""
    monkeypatch.setattr(full_circle, "EVERY", 1)


def verdict_of(make, panorama=SCENE, frames=2 * VIEWS + 1):
    """What is said of a turning panorama that went through `make`; the method, here the cheapest, has no say in it."""
    compass = VisualCompass(CompassConfig(method="rows"))
    for index in range(frames):
        image = make(as_bytes(shifted(panorama, STEP * index), 2.0, index))
        compass.update(START_NS + index * FRAME_NS, image)
    return compass.circle.verdict


def resized(image):
    return cv2.resize(image, (WIDTH, HEIGHT))


def whole(image):
    return image


def half(image):
    return resized(image[:, : WIDTH // 2])


def most(image):
    return resized(image[:, : WIDTH * 3 // 4])


def twice(image):
    return resized(np.hstack([image, image]))


def stereo(image):
    return resized(np.hstack([image, np.roll(image, 3, axis=1)]))


def two_halves_apart(image):
    return resized(np.hstack([image[:, 20:200], image[:, 276:456]]))


def half_black(image):
    image[:, : WIDTH // 4] = image[:, -WIDTH // 4 :] = 0
    return image


def with_bars(image):
    image[: HEIGHT // 10] = image[-HEIGHT // 10 :] = 0
    return image


def with_border(image):
    image[:, :2] = image[:, -2:] = 0
    return image


def pillarboxed(image):
    return cv2.copyMakeBorder(resized(image), 0, 0, WIDTH // 10, WIDTH // 10, cv2.BORDER_CONSTANT)


def with_a_narrow_bar(image):
    return cv2.copyMakeBorder(image, 0, 0, 0, 20, cv2.BORDER_CONSTANT, value=128)


def two_parts_with_a_gap(image):
    bar = np.zeros((HEIGHT, 60), np.uint8)
    return np.hstack([image[:, 200:], bar, image[:, :200]])


def with_dark_mast_at_the_seam(image):
    image[:, :20] = image[:, -20:] = 20
    return image


def with_dark_lens(image):
    image[:, WIDTH // 3 : WIDTH * 2 // 3] = 3
    return image


def with_mast_at_the_seam(image):
    image[:, :25] = 160
    image[40:90, :25] = 60
    return image


def with_mast_in_the_middle(image):
    image[:, WIDTH // 2 : WIDTH // 2 + 20] = 30
    return image


def two_discs(image):
    y, x = np.mgrid[0:HEIGHT, 0 : WIDTH // 2]
    outside = np.hypot(x + 0.5 - WIDTH / 4, y + 0.5 - HEIGHT / 2) > HEIGHT / 2
    image[np.hstack([outside, outside])] = 0
    return image


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (half, "do not join"),
        (most, "do not join"),
        (twice, "twice"),
        (stereo, "twice"),
        (two_halves_apart, "join"),
        (half_black, "50 % of their width"),
        (two_discs, "round pictures"),
        (pillarboxed, "17 % of their width are blank bars"),
        (with_a_narrow_bar, "4 % of their width are blank bars"),
        (two_parts_with_a_gap, "10 % of their width are blank bars"),
        (with_dark_lens, "33 % of their width shows nothing"),
    ],
)
def test_what_is_no_full_circle_is_named(make, word):
    verdict = verdict_of(make)
    assert word in verdict.fault
    assert verdict.since_ns == START_NS or make is two_discs


@pytest.mark.parametrize(
    "make",
    [whole, with_bars, with_border, with_mast_at_the_seam, with_dark_mast_at_the_seam, with_mast_in_the_middle],
)
def test_full_circle_is_not_blamed(make):
    verdict = verdict_of(make)
    assert verdict.views >= VIEWS
    assert verdict.fault == ""


def test_nothing_is_said_of_a_camera_that_stands():
    compass = VisualCompass()
    for index in range(20):
        compass.update(START_NS + index * FRAME_NS, half(as_bytes(SCENE, 2.0, index)))
    assert compass.circle.verdict is None


def test_changed_size_is_judged_anew():
    compass = VisualCompass()
    for index in range(2 * VIEWS):
        compass.update(START_NS + index * FRAME_NS, half(as_bytes(shifted(SCENE, STEP * index), 2.0, index)))
    assert compass.circle.verdict.fault
    compass.update(START_NS + 10**12, as_bytes(scene(5, 640, 320)))
    assert compass.circle.verdict is None


def twin_ends(image):
    """Half a circle, the grey of whose ends was made alike, as in a street or a corridor."""
    picture = half(image).astype(np.float32)
    near = np.clip(1.0 - np.minimum(np.arange(WIDTH), np.arange(WIDTH)[::-1]) / 8.0, 0.0, 1.0)
    return (picture * (1.0 - near) + 120.0 * near).astype(np.uint8)


def test_half_a_circle_whose_ends_look_alike_is_told_by_what_crosses_them():
    verdict, full = verdict_of(twin_ends, frames=50), verdict_of(whole, frames=50)
    assert abs(verdict.seam) < full_circle.HALFWAY
    assert verdict.crossing < 0.5 < 0.95 < full.crossing
    assert "does not come in at the other" in verdict.fault
    assert full.fault == ""


@pytest.mark.parametrize("make", [with_border, with_mast_in_the_middle])
def test_border_and_mast_let_the_rest_cross(make):
    assert verdict_of(make, frames=50).crossing > 0.95


def test_mast_at_the_seam_crosses_nothing():
    assert math.isnan(verdict_of(with_mast_at_the_seam, frames=50).crossing)


@pytest.mark.parametrize(
    ("make", "sigma"),
    [(whole, 0.0), (half, 0.5), (twice, 0.5), (pillarboxed, 0.5)],
)
def test_yaw_of_no_full_circle_may_be_wrong_by_a_factor(make, sigma):
    compass, given = VisualCompass(CompassConfig(method="rows")), []
    for index in range(2 * VIEWS + 1):
        image = make(as_bytes(shifted(SCENE, STEP * index), 2.0, index))
        given.append(compass.update(START_NS + index * FRAME_NS, image))
    assert given[-1].factor_sigma == sigma
    assert math.sqrt(compass.yaw_variance) == pytest.approx(sigma * abs(compass.yaw), abs=0.02)
    assert given[1].factor_sigma == 0.0


def test_factor_is_not_forgotten_by_repeated_images_nor_by_another_size():
    compass = VisualCompass()
    for index in range(4 * VIEWS):
        image = half(as_bytes(shifted(SCENE, STEP * index), 2.0, index))
        for again in (0, 1):  # a driver that sends each image twice
            given = compass.update(START_NS + index * FRAME_NS + again * 10_000_000, image)
            if compass.circle.verdict:
                assert given.factor_sigma == 0.5
    assert compass.circle.verdict
    before = compass.yaw_variance
    other = as_bytes(scene(5, 640, 320))
    compass.update(START_NS + 4 * VIEWS * FRAME_NS, other)
    again = compass.update(START_NS + 4 * VIEWS * FRAME_NS + 10_000_000, other)  # of the keyframe itself
    assert compass.circle.verdict is None
    assert again.factor_sigma == 0.5
    compass.update(START_NS + (4 * VIEWS + 1) * FRAME_NS, as_bytes(shifted(scene(5, 640, 320), STEP)))
    assert compass.yaw_variance >= before


@pytest.mark.parametrize("name", PHOTO_NAMES)
def test_photographs_are_told_from_their_halves(name):
    panorama = cv2.resize(photo(name), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    full, cut, dark, bars = (verdict_of(make, panorama, 30) for make in (whole, half, with_dark_lens, pillarboxed))
    assert full.fault == ""
    assert bars.has_bars
    assert not dark.has_bars
    assert dark.turn_factor_sigma == 0.0
    assert math.isnan(full.seam) or full.seam < 0.25  # half of what is blamed
    assert "do not join" in cut.fault
