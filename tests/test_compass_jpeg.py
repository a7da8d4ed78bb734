"""JPEGs of which only the upper rows are decoded: the same pixels there, and not a word from libjpeg."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from panoramas import as_bytes, scene

from compass import CompassConfig, CompassStatus, VisualCompass
from compass.images.decode import image_from_compressed
from compass.images.jpeg import JpegHeader
from compass.images.orientation import rows_used

PLAIN = {
    "grey": [],
    "4:2:0": [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420],
    "4:4:4": [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444],
    "4:1:1": [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411],
    "optimised": [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
}
OTHERS = {"progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], "restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 8]}


@pytest.fixture(scope="module")
def picture():
    return as_bytes(scene(3, 1000, 504))


def encoded(picture, kind):
    options = (PLAIN | OTHERS)[kind]
    image = picture if kind == "grey" else cv2.applyColorMap(picture, cv2.COLORMAP_JET)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90, *options])[1].tobytes()


@pytest.mark.parametrize("columns", [0, 500, 250, 125])
@pytest.mark.parametrize("kind", PLAIN)
def test_upper_rows_are_the_same_and_the_rest_is_black(picture, kind, columns, capfd):
    data = encoded(picture, kind)
    whole = image_from_compressed(data, columns)
    for bottom in (0.001, 0.3, 0.55, 0.9):
        upper = image_from_compressed(data, columns, bottom=bottom)
        rows = round(bottom * len(whole)) + 1
        assert upper.shape == whole.shape
        np.testing.assert_array_equal(upper[:rows], whole[:rows])
        assert not upper[min(rows + 40, len(whole) - 1) :].any()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("columns", [0, 250])
def test_what_cannot_be_cut_is_decoded_as_a_whole(picture, columns, capfd):
    grey, colour = encoded(picture, "grey"), encoded(picture, "4:2:0")
    exif = b"\xff\xe1\x00\x10Exif\0\0II*\0\x08\0\0\0"
    whole = [encoded(picture, kind) for kind in OTHERS]
    whole += [grey[:2] + exif + grey[2:], colour + bytes(100)]
    for data in whole:
        image = image_from_compressed(data, columns)
        np.testing.assert_array_equal(image_from_compressed(data, columns, bottom=0.3), image)
    np.testing.assert_array_equal(
        image_from_compressed(grey, columns, bottom=1.0), image_from_compressed(grey, columns)
    )
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("columns", [0, 250])
def test_damage_above_the_edge_is_what_it_was_and_below_it_nothing(picture, columns):
    data = bytearray(encoded(picture, "grey"))
    for at, rows in ((0.2, 0.05), (0.9, 0.5)):
        broken = bytearray(data)
        broken[int(at * len(data)) : int(at * len(data)) + 200] = bytes(200)
        whole, upper = (image_from_compressed(bytes(broken), columns, bottom=bottom) for bottom in (1.0, 0.5))
        clear = int(rows * len(whole))
        np.testing.assert_array_equal(upper[:clear], whole[:clear])


def test_header_says_size_and_whether_rows_follow_each_other(picture):
    for kind in PLAIN | OTHERS:
        header = JpegHeader.of(np.frombuffer(encoded(picture, kind), np.uint8))
        assert (header.width, header.height, header.is_plain) == (1000, 504, kind in PLAIN)
    assert JpegHeader.of(np.frombuffer(b"\xff\xd8\xff", np.uint8)) == JpegHeader()


def test_the_compass_sees_no_difference(picture):
    config = CompassConfig()
    jpegs = [encoded(np.roll(picture, 7 * i, axis=1), "4:2:0") for i in range(6)]
    found = []
    for bottom in (1.0, rows_used(config)):
        compass = VisualCompass(config)
        images = [image_from_compressed(jpeg, 500, bottom=bottom) for jpeg in jpegs]
        increments = [compass.update(t_ns, image) for t_ns, image in enumerate(images)]
        found.append((increments, compass.status, compass.yaw, compass.yaw_variance))
    assert found[0] == found[1]
    assert found[0][1] is CompassStatus.OK
