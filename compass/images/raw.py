"""The bytes of a ``sensor_msgs/Image`` as an array: a view of them wherever the pixels lie side by side.

Of a colour picture whose luma stands by itself (NV12, NV21, I420) only that is taken; a mosaic of colour filters
becomes grey.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from compass.errors import ImageError
from compass.images.decode import Image
from compass.images.encodings import ENCODINGS


def image_from_raw(data: Any, encoding: str, height: int, width: int, step: int, is_bigendian: bool = False) -> Image:
    """View the bytes of a ``sensor_msgs/Image`` as an array, without copying them where that can be.

    Parameters
    ----------
    data : buffer
        At least ``step * height`` bytes.
    encoding : str
        One of `sensor_msgs`' names: mono8, mono16, bgr8, rgb8, bgra8, rgba8 and their 16-bit kin, 8UC1..4, 16UC1..4,
        32FC1, yuv422, yuv422_yuy2, bayer_*8, bayer_*16, nv12, nv21, i420.
    height, width, step : int
        Rows, columns and bytes per row. Where luma stands first, `height` may count the rows of chroma, too.
    is_bigendian : bool
        Byte order of samples of several bytes.

    Returns
    -------
    (height, width) or (height, width, channels) array of uint8 or uint16
        Grey of bayer_*, nv12, nv21 and i420. A 32FC1 whose greatest value is at most 1 is from 0 to 1, else from 0 to
        255; either becomes uint16.

    Raises
    ------
    ImageError
        Unknown encoding, zero size, `step` or `data` too short, or numbers that are no grey values.
    """
    if encoding not in ENCODINGS:
        raise ImageError(f"encoding {encoding!r} is unknown; use one of: {', '.join(ENCODINGS)}")
    if height <= 0 or width <= 0:
        raise ImageError(f"image of {width} x {height} pixels is empty")
    buffer = np.frombuffer(data, np.uint8)
    how = ENCODINGS[encoding]
    if how.planes > 1.0:
        return _luma(buffer, encoding, height, width, step)
    row_bytes = width * how.channels * np.dtype(how.sample).itemsize
    _check(buffer, encoding, height, width, step, row_bytes)
    rows: Image = buffer[: step * height].reshape(height, step)[:, :row_bytes]
    rows = rows.view(np.dtype((">" if is_bigendian else "<") + how.sample))
    if how.sample == "f4":
        return _from_floats(rows)
    if how.channels > 1:
        return rows.reshape(height, width, how.channels)
    return rows if how.grey is None else _demosaiced(rows, how.grey)


def _check(buffer: Image, encoding: str, height: int, width: int, step: int, row_bytes: int) -> None:
    if step < row_bytes:
        raise ImageError(f"step {step} is shorter than a row of {width} pixels in {encoding}, {row_bytes} bytes")
    if buffer.size < step * height:
        raise ImageError(f"image data has {buffer.size} bytes; {height} rows of step {step} need {step * height}")


def _luma(buffer: Image, encoding: str, height: int, width: int, step: int) -> Image:
    """The first plane: drivers count the rows of chroma or do not, and some count a row's chroma in its step."""
    planes = ENCODINGS[encoding].planes
    if step * height == buffer.size == round(planes * width * height) > width * height:
        step = width  # the step says how many bytes there are in all, not where the next row begins
    _check(buffer, encoding, height, width, step, width)
    nearer = buffer.size < 0.5 * (1.0 + planes) * step * height  # than to what there is where they are not counted
    counted = nearer and round(height / planes) * planes == height
    rows = round(height / planes) if counted else height
    return buffer[: step * rows].reshape(rows, step)[:, :width]


def _demosaiced(rows: Image, code: int) -> Image:
    height, width = rows.shape
    if height < 4 or width < 4:
        raise ImageError(f"image of {width} x {height} pixels is too small for a mosaic of colour filters")
    native = np.ascontiguousarray(rows, rows.dtype.newbyteorder("="))
    return np.asarray(cv2.cvtColor(native, code))


def _from_floats(rows: Image) -> Image:
    """Grey values of 16 bits; which range the numbers have is not in the message."""
    lowest, highest = float(rows.min()), float(rows.max())
    if not (lowest >= 0.0 and highest <= 255.0):  # true for NaN too
        raise ImageError(
            f"32FC1 values from {lowest:g} to {highest:g}: grey values must be 0..1 or 0..255, and finite; a "
            "depth image is no picture"
        )
    scale = 65535.0 if highest <= 1.0 else 257.0
    grey: npt.NDArray[np.uint16] = np.round(rows * np.float32(scale)).astype(np.uint16)
    return grey
