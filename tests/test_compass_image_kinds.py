"""Every kind of image a camera or a file can give, and sizes from one pixel to sixteen thousand columns."""

import math

import numpy as np
import pytest
from panoramas import as_bytes, compare, scene, shifted, show

from compass import CompassConfig, CompassStatus, ImageError, VisualCompass
from compass.images.strip import prepare_strip

METHODS = ("rows", "sectors", "corners")
WIDTH, STEP = 512, 7.3  # columns


@pytest.fixture(params=METHODS)
def compass(request):
    return VisualCompass(CompassConfig(method=request.param))


@pytest.fixture(scope="module")
def pair():
    image = scene(1, WIDTH, 96)
    return as_bytes(image), as_bytes(shifted(image, STEP))


def stacked(channels):
    return lambda grey: np.repeat(grey[:, :, None], channels, axis=2)


def in_the_middle_of_noise(grey):
    """A view into something larger: neither rows nor pixels lie side by side."""
    large = np.random.default_rng(0).integers(0, 256, (2 * grey.shape[0], 3 * grey.shape[1]), dtype=np.uint8)
    view = large[::2, 1::3]
    view[:] = grey
    return view


def read_only(grey):
    view = np.frombuffer(grey.tobytes(), np.uint8).reshape(grey.shape)
    assert not view.flags.writeable
    return view


SAME_PIXELS = {
    "one channel": stacked(1),
    "BGR": stacked(3),
    "BGRA": stacked(4),
    "mono16": lambda grey: grey.astype(np.uint16) * 257,
    "mono16 big-endian": lambda grey: (grey.astype(np.uint16) * 257).astype(">u2"),
    "BGR of 16 bits": lambda grey: stacked(3)(grey).astype(np.uint16) * 257,
    "view": in_the_middle_of_noise,
    "columns first in memory": np.asfortranarray,
    "turned upside down twice": lambda grey: grey[::-1].copy()[::-1],
    "BGR backwards in memory": lambda grey: stacked(3)(grey)[:, ::-1].copy()[:, ::-1],
    "BGR cut out of BGRA": lambda grey: stacked(4)(grey)[:, :, :3],
    "read-only": read_only,
}


@pytest.mark.parametrize("kind", SAME_PIXELS.values(), ids=SAME_PIXELS)
def test_same_pixels_in_another_layout_give_the_same_answer(compass, pair, kind):
    plain = compare(compass, *pair)
    other = compare(compass, *(kind(grey) for grey in pair))
    # float32 grey values differ by their last bit where 65535 is brought to 255
    assert other.yaw == pytest.approx(plain.yaw, abs=1e-7)
    assert other.confidence == pytest.approx(plain.confidence, abs=1e-6)
    assert plain.yaw == pytest.approx(STEP * math.tau / WIDTH, abs=0.5 * math.tau / WIDTH)


@pytest.mark.parametrize(
    ("encoding", "order"), [("bgr8", [0, 1, 2]), ("rgb8", [2, 1, 0]), ("bgra8", [0, 1, 2, 3]), ("rgba8", [2, 1, 0, 3])]
)
def test_colours_are_weighed_by_their_encoding(compass, encoding, order):
    # blue stands still, green and red turn: the weight of each matters for the rows' confidence
    still, moving = scene(2, WIDTH, 64), scene(3, WIDTH, 64)

    def coloured(columns, order):
        channels = [still, shifted(moving, columns), shifted(moving, columns), np.full_like(still, 255.0)]
        return as_bytes(np.stack([channels[index] for index in order], axis=2))

    def told(frames, name):
        compass.reset()
        compass.update(0, frames[0], name)
        return compass.update(10**8, frames[1], name)

    reference = told([coloured(0.0, [0, 1, 2]), coloured(STEP, [0, 1, 2])], "")
    same = told([coloured(0.0, order), coloured(STEP, order)], encoding)
    assert (same.yaw, same.confidence, same.variance) == (reference.yaw, reference.confidence, reference.variance)
    if encoding in ("rgb8", "rgba8"):
        mistaken = told([coloured(0.0, order), coloured(STEP, order)], "")
        assert mistaken.confidence != reference.confidence


@pytest.mark.parametrize("shape", [(97, 513), (1, 1024), (2, 400), (33, 129), (511, 1001), (64, 361)])
def test_odd_sizes_measure_the_turn(compass, shape):
    height, width = shape
    image = as_bytes(scene(4, width, height))
    columns = width // 40
    increment = compare(compass, image, np.roll(image, columns, axis=1))
    assert increment.yaw == pytest.approx(columns * math.tau / width, abs=0.01 * math.tau / width)


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 2), (2, 1), (2, 2), (3, 5), (4, 15), (5, 16), (8, 31), (3, 63), (500, 3)]
)
def test_tiny_images_give_an_answer_or_a_reason(compass, shape):
    rng = np.random.default_rng(5)
    for index in range(6):
        image = rng.integers(0, 256, shape, dtype=np.uint8)
        increment = compass.update(index * 10**8, image)
        assert (increment is not None) == (compass.status is CompassStatus.OK)
        if increment is not None:
            assert -math.pi <= increment.yaw <= math.pi
            assert 0.0 < increment.variance < math.inf
            assert 0.0 <= increment.confidence <= 1.0
    assert math.isfinite(compass.yaw)


@pytest.mark.parametrize("width", [4096, 16384])
def test_huge_images_measure_the_turn(compass, width):
    coarse = scene(6, 1024, 96)
    image = as_bytes(np.repeat(np.repeat(coarse, width // 1024, axis=1), width // 1024, axis=0))
    columns = 20 * width // 1024
    increment = compare(compass, image, np.roll(image, columns, axis=1))
    assert increment.yaw == pytest.approx(20 * math.tau / 1024, abs=1e-3 * math.tau / 1024)


def test_part_of_a_strip_column_of_a_wide_image_is_measured():
    # 3 of 4096 columns are 0.75 of the strip's 1024
    image = as_bytes(np.repeat(scene(7, 4096, 96), 2, axis=0))
    increment = compare(VisualCompass(), image, np.roll(image, 3, axis=1))
    # merged without a blur, columns that moved by a part of one are another picture: corners know it to LOCK_PX
    assert increment.yaw == pytest.approx(3 * math.tau / 4096, abs=0.012 * math.tau / 1024)
    assert abs(increment.yaw - 3 * math.tau / 4096) < 2.0 * math.sqrt(increment.variance)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros((8, 8, 2), np.uint8), "2 channels"),
        (np.zeros((8, 8, 5), np.uint8), "5 channels"),
        (np.zeros((8, 8), np.float32), "float32"),
        (np.zeros((8, 8), np.int16), "int16"),
        (np.zeros((8, 8), np.uint32), "uint32"),
        (np.zeros((8, 8), bool), "bool"),
        (np.zeros(8, np.uint8), "shape"),
        (np.zeros((2, 8, 8, 3), np.uint8), "shape"),
        (np.zeros((0, 8), np.uint8), "shape"),
        (np.zeros((8, 0, 3), np.uint8), "shape"),
        (None, "NoneType"),
        (b"bytes", "bytes"),
    ],
)
def test_what_is_no_image_is_refused(bad, message):
    with pytest.raises(ImageError, match=message):
        VisualCompass().update(0, bad)


def test_overexposed_and_dark_parts_leave_the_turn(compass):
    # clipping is part of the scene: it turns with it
    image = np.clip(2.5 * (scene(8, WIDTH, 96) - 127.5) + 127.5, 0, 255).round().astype(np.uint8)
    assert (image == 255).mean() > 0.05
    assert (image == 0).mean() > 0.05
    show(compass, image, np.roll(image, -9, axis=1))
    assert compass.yaw == pytest.approx(-9 * math.tau / WIDTH, abs=1e-3 * math.tau / WIDTH)


def test_strip_of_16_bits_has_grey_values_of_255(pair):
    config = CompassConfig()
    of_8, of_16 = (prepare_strip(0, image, config) for image in (pair[0], SAME_PIXELS["mono16"](pair[0])))
    np.testing.assert_allclose(of_16.pixels, of_8.pixels, atol=1e-4)  # float32 of 255
