"""Encodings of cameras' drivers beyond grey and BGR: the same picture, whatever the bytes."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from panoramas import as_bytes, compare, scene, shifted

from compass import CompassConfig, ImageError, VisualCompass
from compass.images.decode import to_grey
from compass.images.raw import image_from_raw

HEIGHT, WIDTH = 64, 128


@pytest.fixture(scope="module")
def colour():
    """BGR picture, smooth, of unlike channels."""
    channels = [cv2.GaussianBlur(scene(seed, WIDTH, HEIGHT), (0, 0), 2.0) for seed in (1, 2, 3)]
    return as_bytes(np.stack(channels, axis=2))


def grey_of(data, encoding, step, height=HEIGHT, width=WIDTH, big=False):
    return to_grey(image_from_raw(data, encoding, height, width, step, big), encoding)


PLACES = {"r": 2, "g": 1, "b": 0}


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize(("bits", "kind", "big"), [(8, "u1", False), (16, "<u2", False), (16, ">u2", True)])
def test_mosaic_becomes_the_grey_picture(colour, order, bits, kind, big):
    mosaic = np.empty((HEIGHT, WIDTH), np.uint16)
    for place, name in enumerate(order):
        row, column = divmod(place, 2)
        mosaic[row::2, column::2] = colour[row::2, column::2, PLACES[name]]
    mosaic = (mosaic * (257 if bits == 16 else 1)).astype(kind)
    grey = grey_of(mosaic.tobytes(), f"bayer_{order}{bits}", WIDTH * bits // 8, big=big)
    grey = grey / 257.0 if bits == 16 else grey.astype(float)
    expected = to_grey(colour).astype(float)
    assert np.abs(grey - expected)[2:-2, 2:-2].mean() < 1.0
    for wrong in {"rggb", "bggr", "gbrg", "grbg"} - {order}:  # the mean would not tell red from blue
        other = grey_of(mosaic.tobytes(), f"bayer_{wrong}{bits}", WIDTH * bits // 8, big=big)
        other = other / 257.0 if bits == 16 else other
        assert np.abs(other - expected)[2:-2, 2:-2].mean() > 2.0


@pytest.mark.parametrize("encoding", ["nv12", "nv21", "i420", "yv12"])
@pytest.mark.parametrize("counted", [False, True])
@pytest.mark.parametrize("padding", [0, 32])
def test_luma_is_the_picture(colour, encoding, counted, padding):
    """Whether the message's height counts the chroma below, and whether rows are padded."""
    planes = cv2.cvtColor(colour, cv2.COLOR_BGR2YUV_I420)  # luma stands first in all of them
    data = np.pad(planes, ((0, 0), (0, padding)), constant_values=255).tobytes()
    height = HEIGHT * 3 // 2 if counted else HEIGHT
    grey = grey_of(data, encoding, WIDTH + padding, height)
    np.testing.assert_array_equal(grey, planes[:HEIGHT])


def test_luma_of_a_step_that_counts_all_bytes_of_a_pixel(colour):
    planes = cv2.cvtColor(colour, cv2.COLOR_BGR2YUV_I420)
    np.testing.assert_array_equal(grey_of(planes.tobytes(), "nv12", WIDTH * 3 // 2), planes[:HEIGHT])


@pytest.mark.parametrize("missing", [1, WIDTH, WIDTH * HEIGHT // 8])
def test_luma_of_a_picture_whose_chroma_is_cut_keeps_its_rows(colour, missing):
    """Two thirds of them, which is what a height that counts the chroma would mean, would move the horizon."""
    rows = HEIGHT // 3 * 3  # two thirds of which are whole rows
    data = colour[:rows, :, 0].tobytes() + bytes(WIDTH * rows // 2 - missing)
    np.testing.assert_array_equal(grey_of(data, "nv12", WIDTH, rows), colour[:rows, :, 0])


@pytest.mark.parametrize("encoding", ["bgr16", "rgb16", "bgra16", "rgba16", "16UC3", "16UC4"])
@pytest.mark.parametrize("big", [False, True])
def test_16_bit_colours(colour, encoding, big):
    channels = [2, 1, 0] if encoding.startswith("rgb") else [0, 1, 2]
    deep = colour[:, :, channels].astype(np.uint16) * 257
    if "a" in encoding or encoding.endswith("4"):
        deep = np.concatenate([deep, np.full((HEIGHT, WIDTH, 1), 65535, np.uint16)], axis=2)
    data = deep.astype(">u2" if big else "<u2").tobytes()
    grey = grey_of(data, encoding, 2 * WIDTH * deep.shape[2], big=big)
    np.testing.assert_allclose(grey / 257.0, to_grey(colour), atol=1.0)


@pytest.mark.parametrize(("scale", "big"), [(1.0, False), (255.0, False), (255.0, True)])
def test_floats_of_either_range(colour, scale, big):
    part = to_grey(colour) / 255.0
    data = (part * scale).astype(">f4" if big else "<f4").tobytes()
    np.testing.assert_allclose(grey_of(data, "32FC1", 4 * WIDTH, big=big) / 65535.0, part, atol=2e-5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 3000.0])
def test_floats_that_are_no_grey_values_are_refused(value):
    pixels = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    pixels[3, 4] = value
    with pytest.raises(ImageError, match=r"0\.\.1 or 0\.\.255"):
        image_from_raw(pixels.tobytes(), "32FC1", HEIGHT, WIDTH, 4 * WIDTH)


@pytest.mark.parametrize(
    ("encoding", "step", "size"),
    [("nv12", WIDTH, WIDTH * HEIGHT // 2), ("nv12", WIDTH - 1, 2 * WIDTH * HEIGHT), ("bayer_rggb16", WIDTH, 10**6)],
)
def test_too_few_bytes_are_refused(encoding, step, size):
    with pytest.raises(ImageError, match="bytes"):
        image_from_raw(bytes(size), encoding, HEIGHT, WIDTH, step)


def test_i420_under_the_name_of_grey_has_its_chroma_cut_off():
    image, columns = scene(5, 512, 256), 7
    chroma = np.random.default_rng(0).integers(0, 255, (128, 512))  # would change from image to image
    pictures = [
        as_bytes(np.vstack([shifted(image, shift), np.roll(chroma, 9 * shift, axis=0)])) for shift in (0, columns)
    ]
    cut = VisualCompass(CompassConfig(chroma_below=True))
    plain = VisualCompass(CompassConfig())
    expected = compare(plain, *(picture[:256] for picture in pictures))
    assert compare(cut, *pictures).yaw == expected.yaw
    assert expected.yaw * 512 / math.tau == pytest.approx(columns, abs=0.05)
