"""Compressed images to arrays, and arrays to grey; raw ones are read in `compass.images.raw`."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from compass.errors import ImageError
from compass.images.codecs import Begins, codec_of
from compass.images.encodings import ENCODINGS, Encoding
from compass.images.jpeg import JpegHeader, upper_rows

Image = npt.NDArray[Any]

# A still of today's 360-degree cameras has up to 72 megapixels (11968 x 5984), and a decoder takes several bytes for
# each: what says to be larger is a fault or a trap (1 MB of PNG may hold a gigapixel), and is not decoded.
MOST_PIXELS = 100_000_000


def image_from_compressed(data: Any, columns: int = 0, named: str = "", bottom: float = 1.0) -> Image:
    """Decode a JPEG or PNG to grey, reduced by 2, 4 or 8 while it stays at least `columns` wide.

    Parameters
    ----------
    data : buffer
        The file's bytes.
    columns : int
        Width that is wanted; 0 decodes at full size. A JPEG decoded at reduced size costs a fraction of the time.
    named : str
        What the message calls its format, for the words of an error; the bytes decide.
    bottom : float
        Share of the height, from the top, that is wanted; of most JPEGs what lies below is not decoded, but black.

    Returns
    -------
    (H, W) array of uint8 or uint16

    Raises
    ------
    ImageError
        The bytes are no JPEG or PNG that OpenCV can decode, or one of more than `MOST_PIXELS`.
    """
    buffer = np.frombuffer(data, np.uint8)
    jpeg, (width, height) = None, (0, 0)
    if buffer[:2].tobytes() == Begins.JPEG:
        jpeg = JpegHeader.of(buffer)
        width, height = jpeg.width, jpeg.height
    else:
        width, height = _png_size(buffer, named)
    if not width or not height:
        raise ImageError(f"compressed image of {buffer.size} bytes is corrupt: its header gives no size")
    if width * height > MOST_PIXELS:
        raise ImageError(
            f"picture of {width} x {height} pixels is not decoded: more than {MOST_PIXELS // 1_000_000} megapixels; "
            "no panorama is that large, send a smaller one"
        )
    flag, by = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH, 1
    if jpeg and columns:
        for factor in (2, 4, 8):  # those that libjpeg knows
            if width >= factor * columns:
                flag, by = getattr(cv2, f"IMREAD_REDUCED_GRAYSCALE_{factor}"), factor
    upper = upper_rows(buffer, jpeg, _rows(height, bottom)) if jpeg else None
    try:
        image = cv2.imdecode(buffer if upper is None else upper, flag)
    except cv2.error:
        image = None
    if image is None:
        raise ImageError(f"compressed image of {buffer.size} bytes is corrupt")
    if upper is not None:
        whole = np.zeros((-(-height // by), image.shape[1]), image.dtype)
        whole[: len(image)] = image
        return whole
    return image


def _rows(height: int, share: float) -> int:
    """Rows of a JPEG that hold this share of its height at any size: whole blocks, and one more."""
    block = 16  # pixels; the largest that a JPEG codes as one
    return (math.ceil(share * height / block) + 1) * block


def _png_size(buffer: npt.NDArray[np.uint8], named: str) -> tuple[int, int]:
    """Width and height from the header of a PNG; `ImageError` where it is none."""
    begin = buffer[:32].tobytes()
    if not begin.startswith(Begins.PNG):
        raise ImageError(_no_picture(buffer, begin, named))
    return int.from_bytes(begin[16:20], "big"), int.from_bytes(begin[20:24], "big")


def _no_picture(buffer: npt.NDArray[np.uint8], begin: bytes, named: str) -> str:
    """What the bytes are, where they are neither JPEG nor PNG, and what to do."""
    said = f" (format {named!r})" if named else ""
    what = f"compressed image of {buffer.size} bytes{said}"
    if begin[12:20] == Begins.PNG or "compresseddepth" in named.lower():
        return f"{what} is a compressedDepth image, distances and no picture; choose the camera's other topic"
    if codec_of(named, begin):
        return f"{what} is a piece of a video; record JPEG, or let image_transport republish it as raw or compressed"
    kind = "is empty" if not buffer.size else "is corrupt or neither JPEG nor PNG"
    return f"{what} {kind}"


def to_grey(image: Image, encoding: str = "") -> Image:
    """Grey image of the same height and width and type; three channels are BGR unless `encoding` says otherwise.

    Raises
    ------
    ImageError
        `image` is not (H, W), (H, W, 1), (H, W, 2) with a YUV 4:2:2 encoding, (H, W, 3) or (H, W, 4), or not of
        type uint8 or uint16, or empty.
    """
    if not isinstance(image, np.ndarray) or image.dtype.kind != "u" or image.dtype.itemsize > 2:
        kind = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise ImageError(f"image is {kind}; give a numpy array of uint8 or uint16")
    if image.ndim not in (2, 3) or image.size == 0:
        raise ImageError(f"image has shape {image.shape}; give (H, W) or (H, W, 3)")
    if not image.dtype.isnative:
        image = image.astype(image.dtype.newbyteorder("="))
    if image.ndim == 2:
        return image
    channels = image.shape[2]
    if channels == 1:
        return image[:, :, 0]
    known = ENCODINGS.get(encoding, Encoding())
    if channels == 2 == known.channels:
        return image[:, :, known.luma]
    if channels in (3, 4):
        usual = cv2.COLOR_BGR2GRAY if channels == 3 else cv2.COLOR_BGRA2GRAY
        return cv2.cvtColor(image, usual if known.grey is None or known.channels != channels else known.grey)
    raise ImageError(f"image has {channels} channels; give 1, 3 or 4")
