"""Topics of a camera by image_transport's transports, and the messages on them."""

from __future__ import annotations

import importlib
from typing import Any

from compass.errors import ConfigError
from nodes.names import raw_topic

# transport -> package and message of its topic, whose name has the transport as its suffix
_MESSAGES = {
    "raw": ("sensor_msgs", "Image"),
    "compressed": ("sensor_msgs", "CompressedImage"),
    "ffmpeg": ("ffmpeg_image_transport_msgs", "FFMPEGPacket"),
    "foxglove": ("foxglove_msgs", "CompressedVideo"),
}


def image_topic(name: str, transport: str) -> tuple[str, Any]:
    """Topic of a camera by a transport, given any of its topics, and the message's class.

    Raises
    ------
    ConfigError
        The message's ROS package is not installed.
    """
    package, message = _MESSAGES[transport]
    try:
        kind = getattr(importlib.import_module(f"{package}.msg"), message)
    except ImportError:
        raise ConfigError(
            f"image_transport: {transport} needs the ROS package {package}: apt install "
            f"ros-jazzy-{package.replace('_', '-')}"
        ) from None
    base = raw_topic(name).removesuffix("/ffmpeg").removesuffix("/foxglove")
    return base if transport == "raw" else f"{base}/{transport}", kind
