"""Bytes of topics and files to arrays, arrays to grey."""

import array
import math
import zlib

import cv2
import numpy as np
import pytest
from panoramas import as_bytes, scene

from compass import CompassConfig, ImageError
from compass.images.decode import image_from_compressed, to_grey
from compass.images.raw import image_from_raw
from compass.images.strip import prepare_strip

HEIGHT, WIDTH = 5, 12
LAYOUTS = {
    "mono8": (1, 1),
    "8UC1": (1, 1),
    "mono16": (2, 1),
    "16UC1": (2, 1),
    "bgr8": (1, 3),
    "8UC3": (1, 3),
    "rgb8": (1, 3),
    "bgra8": (1, 4),
    "8UC4": (1, 4),
    "rgba8": (1, 4),
    "yuv422": (1, 2),
    "uyvy": (1, 2),
    "yuv422_yuy2": (1, 2),
    "yuyv": (1, 2),
}


def pixels_of(encoding, seed=0):
    sample, channels = LAYOUTS[encoding]
    kind = np.uint8 if sample == 1 else np.uint16
    shape = (HEIGHT, WIDTH) if channels == 1 else (HEIGHT, WIDTH, channels)
    return np.random.default_rng(seed).integers(0, np.iinfo(kind).max, shape, dtype=kind)


def message_of(pixels, padding=0, order="<"):
    """Bytes and step of a message that carries the pixels, with `padding` bytes of rubbish after each row."""
    rows = pixels.astype(pixels.dtype.newbyteorder(order)).reshape(HEIGHT, -1)
    packed = np.frombuffer(rows.tobytes(), np.uint8).reshape(HEIGHT, -1)
    filled = np.hstack([packed, np.full((HEIGHT, padding), 0xAB, np.uint8)])
    return filled.tobytes(), filled.shape[1]


@pytest.mark.parametrize("padding", [0, 1, 4, 61])
@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("encoding", LAYOUTS)
def test_raw_image_has_the_pixels_of_the_message(encoding, padding, big_endian):
    pixels = pixels_of(encoding)
    data, step = message_of(pixels, padding, ">" if big_endian else "<")
    image = image_from_raw(data, encoding, HEIGHT, WIDTH, step, big_endian)
    assert image.dtype.itemsize == pixels.dtype.itemsize
    np.testing.assert_array_equal(image, pixels)
    grey = to_grey(image, encoding)
    assert grey.shape == (HEIGHT, WIDTH)
    assert grey.dtype == pixels.dtype


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, lambda data: np.frombuffer(data, np.uint8)])
def test_raw_image_is_a_view_of_any_buffer(kind):
    pixels = pixels_of("bgr8")
    data, step = message_of(pixels, 3)
    buffer = kind(data)
    image = image_from_raw(buffer, "bgr8", HEIGHT, WIDTH, step)
    np.testing.assert_array_equal(image[:, :, 1], pixels[:, :, 1])
    if isinstance(buffer, bytearray):
        buffer[0] = (buffer[0] + 1) % 256
        assert image[0, 0, 0] == buffer[0]


def test_raw_image_of_an_array_as_rclpy_gives_it():
    pixels = pixels_of("mono8")
    image = image_from_raw(array.array("B", pixels.tobytes()), "mono8", HEIGHT, WIDTH, WIDTH)
    np.testing.assert_array_equal(image, pixels)


def test_raw_image_ignores_data_beyond_the_last_row():
    pixels = pixels_of("mono8")
    image = image_from_raw(pixels.tobytes() + b"more", "mono8", HEIGHT, WIDTH, WIDTH)
    np.testing.assert_array_equal(image, pixels)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"encoding": "16SC1"}, "16SC1.*mono8"),
        ({"encoding": ""}, "unknown"),
        ({"height": 0}, "empty"),
        ({"width": 0, "step": 0}, "empty"),
        ({"height": -1}, "empty"),
        ({"width": -12}, "empty"),
        ({"step": 35}, "step 35.*36"),
        ({"step": 0}, "step 0"),
        ({"step": -36}, "step -36"),
        ({"data": b""}, "0 bytes.*180"),
        ({"data": bytes(179)}, "179 bytes.*180"),
        ({"height": 6}, "180 bytes.*216"),
    ],
)
def test_raw_image_that_does_not_fit_is_refused_with_the_numbers(change, message):
    fields = {"data": bytes(180), "encoding": "bgr8", "height": HEIGHT, "width": WIDTH, "step": 36}
    with pytest.raises(ImageError, match=message):
        image_from_raw(**{**fields, **change})


def test_grey_of_red_green_and_blue_by_encoding():
    # ITU-R BT.601: 0.299 red, 0.587 green, 0.114 blue
    red_first = np.zeros((2, 3, 3), np.uint8)
    red_first[:, 0, 0], red_first[:, 1, 1], red_first[:, 2, 2] = 255, 255, 255
    assert to_grey(red_first, "rgb8")[0].tolist() == [76, 150, 29]
    assert to_grey(red_first[:, :, ::-1], "bgr8")[0].tolist() == [76, 150, 29]
    assert to_grey(red_first[:, :, ::-1])[0].tolist() == [76, 150, 29]
    assert to_grey(np.dstack([red_first, red_first[:, :, 0]]), "rgba8")[0].tolist() == [76, 150, 29]
    assert to_grey(np.dstack([red_first[:, :, ::-1], red_first[:, :, 0]]), "bgra8")[0].tolist() == [76, 150, 29]


def test_grey_of_yuv_is_its_luma():
    luma = pixels_of("mono8")
    other = np.full_like(luma, 128)
    for encoding in ("yuv422", "uyvy"):
        np.testing.assert_array_equal(to_grey(np.dstack([other, luma]), encoding), luma)
    for encoding in ("yuv422_yuy2", "yuyv"):
        np.testing.assert_array_equal(to_grey(np.dstack([luma, other]), encoding), luma)


def test_grey_of_grey_is_a_view():
    image = pixels_of("mono8")
    assert np.shares_memory(to_grey(image), image)
    assert np.shares_memory(to_grey(image[:, :, None]), image)


def test_grey_of_foreign_byte_order_is_native():
    image = pixels_of("mono16")
    grey = to_grey(image.astype(">u2"))
    assert grey.dtype.isnative
    np.testing.assert_array_equal(grey, image)


@pytest.mark.parametrize(
    ("image", "encoding", "message"),
    [
        (np.zeros((4, 4), np.float64), "", "float64.*uint8"),
        (np.zeros((4, 4), np.int8), "", "int8"),
        (np.zeros((4, 4), np.uint64), "", "uint64"),
        ([[1, 2]], "", "list"),
        (None, "", "NoneType"),
        (np.zeros(4, np.uint8), "", r"\(4,\)"),
        (np.uint8(3) * np.ones((), np.uint8), "", "uint8|shape"),
        (np.zeros((1, 2, 3, 4), np.uint8), "", "shape"),
        (np.zeros((0, 4), np.uint8), "", "shape"),
        (np.zeros((4, 4, 2), np.uint8), "", "2 channels"),
        (np.zeros((4, 4, 2), np.uint8), "rgb8", "2 channels"),
        (np.zeros((4, 4, 7), np.uint8), "", "7 channels"),
    ],
)
def test_grey_of_no_image_is_refused(image, encoding, message):
    with pytest.raises(ImageError, match=message):
        to_grey(image, encoding)


@pytest.fixture(scope="module")
def picture():
    return as_bytes(scene(1, 1024, 256))


def jpeg(image):
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


@pytest.mark.parametrize(
    ("columns", "width"),
    [(0, 1024), (2000, 1024), (1024, 1024), (530, 1024), (512, 512), (300, 512), (256, 256), (128, 128), (1, 128)],
)
def test_jpeg_is_reduced_while_it_stays_wide_enough(picture, columns, width):
    image = image_from_compressed(jpeg(picture), columns)
    assert image.shape == (width // 4, width)
    assert image.dtype == np.uint8
    expected = cv2.resize(picture, (width, width // 4), interpolation=cv2.INTER_AREA)
    # quality 95 leaves errors of a few grey values; a picture moved by half a pixel would leave far more
    assert float(np.abs(image.astype(float) - expected).mean()) < 2.0


def test_jpeg_of_colours_is_grey(picture):
    colour = np.repeat(picture[:, :, None], 3, axis=2)
    image = image_from_compressed(jpeg(colour))
    assert image.shape == picture.shape
    assert float(np.abs(image.astype(float) - picture).mean()) < 2.0


def test_progressive_jpeg_and_one_with_a_large_header_are_reduced(picture):
    progressive = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    plain = jpeg(picture)
    comment = b"\xff\xfe" + (40_000).to_bytes(2, "big") + bytes(39_998)
    for data in (progressive, plain[:2] + comment + plain[2:]):
        assert image_from_compressed(data, 256).shape == (64, 256)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_png_is_exact_in_its_depth(picture, kind):
    pixels = picture.astype(kind) * (257 if kind is np.uint16 else 1)
    image = image_from_compressed(cv2.imencode(".png", pixels)[1].tobytes(), 1024)
    assert image.dtype == kind
    np.testing.assert_array_equal(image, pixels)


@pytest.mark.parametrize("columns", [0, 256])
@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        b"\xff\xd8",
        b"\xff\xd8\xff",
        b"\xff\xd8\xff\xc0",
        b"not an image",
        bytes(5000),
        b"\x89PNG\r\n\x1a\n",
    ],
)
def test_bytes_that_are_no_picture_are_refused(data, columns):
    with pytest.raises(ImageError, match=f"{len(data)} bytes"):
        image_from_compressed(data, columns)


@pytest.mark.parametrize("columns", [0, 256])
@pytest.mark.parametrize("part", [0.001, 0.01, 0.3, 0.9, 0.999])
def test_truncated_jpeg_is_refused_or_a_whole_picture(picture, part, columns):
    data = jpeg(picture)
    try:
        image = image_from_compressed(data[: int(part * len(data))], columns)
    except ImageError:
        return
    assert image.shape == ((64, 256) if columns else (256, 1024))


def test_jpeg_of_rubbish_inside_never_raises_anything_else(picture):
    data = bytearray(jpeg(picture))
    rng = np.random.default_rng(2)
    for _ in range(60):
        broken = bytearray(data)
        for at in rng.integers(2, min(len(broken), 2000), 12):
            broken[at] = int(rng.integers(0, 256))
        try:
            image = image_from_compressed(bytes(broken), 256)
        except ImageError:
            continue
        assert image.ndim == 2
        assert image.size


def test_jpeg_of_a_segment_of_no_length_ends():
    # a header that points to itself must not be followed for ever
    with pytest.raises(ImageError):
        image_from_compressed(b"\xff\xd8" + b"\xff\xe0\x00\x00" * 2000, 256)


# ---------------------------------------------------------------- what a picture says of itself, before it is decoded


def png_of_size(width, height):
    """A sound PNG of zeros, 8 bits of grey: a gigapixel in a megabyte."""

    def chunk(kind, data):
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    compressor = zlib.compressobj(9)
    row = bytes(width + 1)
    pixels = b"".join(compressor.compress(row) for _ in range(height)) + compressor.flush()
    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def jpeg_saying(picture, width, height):
    """A JPEG whose frame header claims another size."""
    data = bytearray(jpeg(picture))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    return bytes(data)


def refuse_to_decode(*_):
    raise AssertionError("decoded")


@pytest.mark.parametrize("columns", [0, 256])
def test_picture_larger_than_any_panorama_is_not_decoded(picture, columns, monkeypatch):
    huge = [jpeg_saying(picture, 65_500, 65_500), jpeg_saying(picture, 20_000, 5_001), png_of_size(10_001, 10_000)]
    comments = (b"\xff\xfe\xff\xff" + bytes(65_533)) * 3  # the header lies beyond the first 64 KiB
    huge.append(huge[0][:2] + comments + huge[0][2:])
    huge.append(huge[0][:2] + b"\xff" * 9 + huge[0][2:])  # any number of fill bytes may come before a marker
    monkeypatch.setattr(cv2, "imdecode", refuse_to_decode)
    for data in huge:
        with pytest.raises(ImageError, match="pixels is not decoded: more than 100 megapixels"):
            image_from_compressed(data, columns)


def test_picture_as_large_as_cameras_make_them_is_decoded():
    data = cv2.imencode(".jpg", np.zeros((5984, 11968), np.uint8))[1].tobytes()
    assert image_from_compressed(data, 1024).shape == (748, 1496)
    assert image_from_compressed(png_of_size(10_000, 100)).shape == (100, 10_000)


@pytest.mark.parametrize(
    ("data", "named", "says"),
    [
        (b"\0\0\0\1\x67" + bytes(50), "h264", "piece of a video"),
        (b"\0\0\1\x40" + bytes(50), "", "piece of a video"),
        (b"\0\0\1\x40" + bytes(50), "jpeg", "piece of a video"),
        (b"\x12\x00\x0a" + bytes(50), "hevc", "format 'hevc'.* piece of a video"),
        (b"\x12\x00\x0a" + bytes(50), "bgr8; H.265 compressed", "piece of a video"),
        (bytes(12) + b"\x89PNG\r\n\x1a\n" + bytes(50), "", "compressedDepth"),
        (b"1234", "16UC1; compressedDepth png", "compressedDepth"),
        (b"RIFF\0\0\0\0WEBPVP8 " + bytes(50), "webp", "neither JPEG nor PNG"),
        (b"", "jpeg", "is empty"),
        (b"\xff\xd8\xff\xda" + bytes(50), "jpeg", "its header gives no size"),
    ],
)
def test_bytes_of_another_kind_are_called_by_their_name(data, named, says):
    with pytest.raises(ImageError, match=says) as caught:
        image_from_compressed(data, 256, named)
    assert "\n" not in str(caught.value)


def test_format_of_a_message_is_only_words_where_the_bytes_are_a_picture(picture):
    assert image_from_compressed(jpeg(picture), 0, "h264").shape == picture.shape


@pytest.mark.parametrize(("roi_top", "horizon"), [(0.0, 0.5), (0.25, 0.5), (0.25, 0.4), (0.3, 0.6)])
def test_strip_knows_how_high_above_the_horizon_it_begins(roi_top, horizon):
    """Pixels are square: of 1024 columns each row is 2 pi / 1024 rad high."""
    config = CompassConfig(roi_top=roi_top, roi_bottom=0.9, horizon_row=horizon)
    strip = prepare_strip(0, np.zeros((500, 1024), np.uint8), config)
    assert strip.top == pytest.approx((horizon - roi_top) * 500 * math.tau / 1024)
