"""The bytes of a ``sensor_msgs/Image`` as an array: a view of them wherever the pixels lie side by side.

Of a colour picture whose luma stands by itself (NV12, NV21, I420) only that is taken; a mosaic of colour filters
becomes grey. Names are those of ``sensor_msgs/image_encodings.hpp``, and those that drivers use beside them.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from compass.errors import ImageError
from compass.images.decode import Image

# encoding -> type of a sample, channels
_LAYOUT = {
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "mono16": ("u2", 1),
    "16UC1": ("u2", 1),
    "32FC1": ("f4", 1),
    "bgr8": ("u1", 3),
    "8UC3": ("u1", 3),
    "rgb8": ("u1", 3),
    "bgra8": ("u1", 4),
    "8UC4": ("u1", 4),
    "rgba8": ("u1", 4),
    "bgr16": ("u2", 3),
    "16UC3": ("u2", 3),
    "rgb16": ("u2", 3),
    "bgra16": ("u2", 4),
    "16UC4": ("u2", 4),
    "rgba16": ("u2", 4),
    "yuv422": ("u1", 2),
    "uyvy": ("u1", 2),
    "yuv422_yuy2": ("u1", 2),
    "yuyv": ("u1", 2),
}
# OpenCV names a mosaic by the second pixels of its second row, ROS by its first two rows
_MOSAIC = {
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}
_LUMA_FIRST = ("nv12", "nv21", "nv24", "i420", "yv12", "yuv420", "yuv420p")
_KNOWN = (*_LAYOUT, *(f"{mosaic}{bits}" for mosaic in _MOSAIC for bits in ("8", "16")), *_LUMA_FIRST)


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
    if encoding not in _KNOWN:
        raise ImageError(f"encoding {encoding!r} is unknown; use one of: {', '.join(_KNOWN)}")
    if height <= 0 or width <= 0:
        raise ImageError(f"image of {width} x {height} pixels is empty")
    buffer = np.frombuffer(data, np.uint8)
    if encoding in _LUMA_FIRST:
        return _luma(buffer, encoding, height, width, step)
    mosaic = encoding.rstrip("0123456789") if encoding.startswith("bayer_") else ""
    kind, channels = ("u2" if encoding.endswith("16") else "u1", 1) if mosaic else _LAYOUT[encoding]
    row_bytes = width * channels * int(kind[1])
    _check(buffer, encoding, height, width, step, row_bytes)
    rows: Image = buffer[: step * height].reshape(height, step)[:, :row_bytes]
    if kind != "u1":
        rows = rows.view(np.dtype((">" if is_bigendian else "<") + kind))
    if mosaic:
        return _demosaiced(rows, mosaic)
    if kind == "f4":
        return _from_floats(rows)
    return rows if channels == 1 else rows.reshape(height, width, channels)


def _check(buffer: Image, encoding: str, height: int, width: int, step: int, row_bytes: int) -> None:
    if step < row_bytes:
        raise ImageError(f"step {step} is shorter than a row of {width} pixels in {encoding}, {row_bytes} bytes")
    if buffer.size < step * height:
        raise ImageError(f"image data has {buffer.size} bytes; {height} rows of step {step} need {step * height}")


def _luma(buffer: Image, encoding: str, height: int, width: int, step: int) -> Image:
    """The first plane: drivers count the rows of chroma or do not, and some count a row's chroma in its step."""
    planes = 3 if encoding == "nv24" else 1.5
    if step * height == buffer.size == round(planes * width * height) > width * height:
        step = width  # the step says how many bytes there are in all, not where the next row begins
    _check(buffer, encoding, height, width, step, width)
    nearer = buffer.size < 0.5 * (1.0 + planes) * step * height  # than to what there is where they are not counted
    counted = nearer and round(height / planes) * planes == height
    rows = round(height / planes) if counted else height
    return buffer[: step * rows].reshape(rows, step)[:, :width]


def _demosaiced(rows: Image, mosaic: str) -> Image:
    height, width = rows.shape
    if height < 4 or width < 4:
        raise ImageError(f"image of {width} x {height} pixels is too small for a mosaic of colour filters")
    native = np.ascontiguousarray(rows, rows.dtype.newbyteorder("="))
    return np.asarray(cv2.cvtColor(native, _MOSAIC[mosaic]))


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
