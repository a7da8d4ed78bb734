"""How pixels lie in an image, by the names of ``sensor_msgs/image_encodings.hpp`` and of drivers."""

from __future__ import annotations

from dataclasses import dataclass

import cv2


@dataclass(frozen=True, slots=True)
class Encoding:
    """Of one name.

    Attributes
    ----------
    sample : str
        Type of a sample, as numpy names it without the order of its bytes.
    channels : int
        Samples of a pixel.
    grey : int or None
        Of `cv2.cvtColor`; None where a channel is grey already. Of one channel it is a mosaic of colour filters.
    luma : int
        The channel that is grey.
    planes : float
        Size of all planes, that of luma first, as a multiple of that.
    """

    sample: str = "u1"
    channels: int = 1
    grey: int | None = None
    luma: int = 0
    planes: float = 1.0


# OpenCV names a mosaic by the second pixels of its second row, ROS by its first two rows
ENCODINGS = {
    "mono8": Encoding(),
    "8UC1": Encoding(),
    "mono16": Encoding("u2"),
    "16UC1": Encoding("u2"),
    "32FC1": Encoding("f4"),
    "bgr8": Encoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "8UC3": Encoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "rgb8": Encoding("u1", 3, cv2.COLOR_RGB2GRAY),
    "bgra8": Encoding("u1", 4, cv2.COLOR_BGRA2GRAY),
    "8UC4": Encoding("u1", 4, cv2.COLOR_BGRA2GRAY),
    "rgba8": Encoding("u1", 4, cv2.COLOR_RGBA2GRAY),
    "bgr16": Encoding("u2", 3, cv2.COLOR_BGR2GRAY),
    "16UC3": Encoding("u2", 3, cv2.COLOR_BGR2GRAY),
    "rgb16": Encoding("u2", 3, cv2.COLOR_RGB2GRAY),
    "bgra16": Encoding("u2", 4, cv2.COLOR_BGRA2GRAY),
    "16UC4": Encoding("u2", 4, cv2.COLOR_BGRA2GRAY),
    "rgba16": Encoding("u2", 4, cv2.COLOR_RGBA2GRAY),
    "yuv422": Encoding("u1", 2, luma=1),
    "uyvy": Encoding("u1", 2, luma=1),
    "yuv422_yuy2": Encoding("u1", 2),
    "yuyv": Encoding("u1", 2),
    "bayer_rggb8": Encoding("u1", 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_rggb16": Encoding("u2", 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": Encoding("u1", 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_bggr16": Encoding("u2", 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": Encoding("u1", 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_gbrg16": Encoding("u2", 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": Encoding("u1", 1, cv2.COLOR_BayerGB2GRAY),
    "bayer_grbg16": Encoding("u2", 1, cv2.COLOR_BayerGB2GRAY),
    "nv12": Encoding(planes=1.5),
    "nv21": Encoding(planes=1.5),
    "nv24": Encoding(planes=3.0),
    "i420": Encoding(planes=1.5),
    "yv12": Encoding(planes=1.5),
    "yuv420": Encoding(planes=1.5),
    "yuv420p": Encoding(planes=1.5),
}
