"""Videos as packets, encoded by PyAV, and the messages that carry them."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import av
import numpy as np
from rosbags.typesys import get_types_from_msg

ENCODERS = {
    "h264": ("libx264", {"preset": "ultrafast", "tune": "zerolatency"}),
    "h264_b_frames": ("libx264", {"preset": "medium", "bf": "2"}),
    "hevc": ("libx265", {"preset": "ultrafast", "x265-params": "log-level=none:bframes=0"}),
    "hevc_b_frames": ("libx265", {"preset": "ultrafast", "x265-params": "log-level=none:bframes=2"}),
}
FOXGLOVE, FFMPEG = "foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
DEFINITIONS = {
    FOXGLOVE: "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format",
    FFMPEG: "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
    "bool is_bigendian\nuint8[] data",
}


class Encoded(NamedTuple):
    """A packet: which picture it is (in the order of capture), whether it needs no other, and its bytes."""

    index: int
    key: bool
    data: bytes


def encode(pictures, kind="h264", gop=10, quality="10"):
    """Packets of grey pictures in the order in which an encoder gives them."""
    name, options = ENCODERS[kind]
    context = av.CodecContext.create(name, "w")
    context.height, context.width = pictures[0].shape
    context.pix_fmt, context.time_base, context.gop_size = "yuv420p", Fraction(1, 30), gop
    options = dict(options)
    if name == "libx265":
        options["x265-params"] += f":keyint={gop}:min-keyint={gop}:scenecut=0"
    context.options = options | {"crf": quality}
    packets = []
    for index, grey in enumerate(pictures):
        chroma = np.full((grey.shape[0] // 2, grey.shape[1]), 128, np.uint8)
        frame = av.VideoFrame.from_ndarray(np.vstack([grey, chroma]), "yuv420p")
        frame.pts = index
        packets += context.encode(frame)
    packets += context.encode(None)
    return [Encoded(one.pts, one.is_keyframe, bytes(one)) for one in packets]


def write_packet(bag, carrier, t_ns, packet, topic="/pano"):
    """Append a packet to a `TinyBag` as a message of a kind: image, foxglove or ffmpeg."""
    data = np.frombuffer(packet.data, np.uint8)
    if carrier == "image":
        message = bag.make("sensor_msgs/msg/CompressedImage", header=bag.header(t_ns), format="h264", data=data)
        bag.write(f"{topic}/compressed", message)
        return
    kind = FOXGLOVE if carrier == "foxglove" else FFMPEG
    if kind not in bag.store.types:
        bag.store.register(get_types_from_msg(DEFINITIONS[kind], kind))
    if carrier == "foxglove":
        stamp = bag.header(t_ns).stamp
        message = bag.make(kind, timestamp=stamp, frame_id="x", data=data, format="h264")
    else:
        message = bag.make(
            kind,
            header=bag.header(t_ns),
            width=0,
            height=0,
            encoding="h264;yuv420p;bgr8;bgr8",
            pts=packet.index,
            flags=int(packet.key),
            is_bigendian=False,
            data=data,
        )
    bag.write(f"{topic}/{carrier}", message)
