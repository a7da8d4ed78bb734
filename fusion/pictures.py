"""Pictures of a topic's messages: of messages that are one each, and of packets of a video, whose decoder remembers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from compass.errors import ImageError
from compass.images.codecs import codec_of
from compass.images.decode import Image
from compass.images.video import VideoDecoder
from fusion.messages import image_of, stamp_to_ns

_BEGIN = 8  # bytes that tell a video from a picture


@dataclass(frozen=True, slots=True)
class Picture:
    """Pixels with the stamp of the message that they came in, ns, and their encoding ("" for grey and BGR)."""

    t_ns: int
    image: Image
    encoding: str = ""


@dataclass(frozen=True, slots=True)
class Packet:
    """A part of a video: one picture, mostly what differs from those before. `codec` as `codec_of` gives it."""

    t_ns: int
    codec: str
    data: bytes


class PictureStream:
    """The pictures of one topic, message by message.

    Parameters
    ----------
    columns : int
        Width below which no picture may be reduced while it is decoded, px; see `CompassConfig.decoded_columns`.
    """

    def __init__(self, columns: int) -> None:
        self._columns = columns
        self._decoder: VideoDecoder | None = None

    def add(self, message: Any) -> list[Picture]:
        """The pictures that a message completes: one; of a video perhaps none yet, or one that was held back, too.

        Raises
        ------
        ImageError
            It cannot be used, or the decoder waits for a key frame.
        MessageError
            Zero stamp.
        """
        packet = packet_of(message)
        if packet is None:
            return [Picture(stamp_to_ns(message.header.stamp), *image_of(message, self._columns))]
        if self._decoder is None or self._decoder.codec != packet.codec:
            self._decoder = VideoDecoder(packet.codec)
        return [Picture(t_ns, image) for t_ns, image in self._decoder.decode(packet.t_ns, packet.data)]

    def rest(self) -> list[Picture]:
        """What a video's decoder still holds back at the end."""
        return [Picture(t_ns, image) for t_ns, image in self._decoder.rest()] if self._decoder else []


def packet_of(message: Any) -> Packet | None:
    """The packet that a message is; None for a picture.

    Videos come as ``foxglove_msgs/CompressedVideo``, ``ffmpeg_image_transport_msgs/FFMPEGPacket``, and as
    ``sensor_msgs/CompressedImage`` whose `format` names a codec.

    Raises
    ------
    ImageError
        A video of a codec that is not known.
    MessageError
        Zero stamp.
    """
    if hasattr(message, "timestamp"):
        stamp, name = message.timestamp, str(message.format)
    elif hasattr(message, "pts"):
        stamp, name = message.header.stamp, str(message.encoding).partition(";")[0]
    elif not hasattr(message, "format"):
        return None
    else:
        name = str(message.format)
        if not codec_of(name, bytes(memoryview(message.data)[:_BEGIN])):
            return None
        stamp = message.header.stamp
    data = bytes(memoryview(message.data))
    codec = codec_of(name, data)
    if not codec:
        raise ImageError(f"video of {len(data)} bytes: codec {name!r} is unknown; use h264 or h265")
    return Packet(stamp_to_ns(stamp), codec, data)
