"""What a bag holds: topics and messages, and the types that are read."""

from __future__ import annotations

import struct
from dataclasses import dataclass

CDR, ROS1 = "cdr", "ros1"  # how messages are serialised, in ROS 2 and 1
IMU = "sensor_msgs/msg/Imu"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
ODOMETRY = "nav_msgs/msg/Odometry"
# packets of videos, and their fields: bags of sqlite3 do not bring them along
VIDEOS = {
    "foxglove_msgs/msg/CompressedVideo": "builtin_interfaces/Time timestamp\nstring frame_id\n"
    "uint8[] data\nstring format",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "std_msgs/Header header\nint32 width\nint32 height\n"
    "string encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data",
}
IMAGES = (IMAGE, COMPRESSED_IMAGE, *VIDEOS)


@dataclass(frozen=True, slots=True)
class Topic:
    """What a bag's index says of a topic."""

    name: str
    msgtype: str
    count: int

    @property
    def short_type(self) -> str:
        """The type as people write it, ``sensor_msgs/Imu``."""
        return self.msgtype.replace("/msg/", "/")


@dataclass(frozen=True, slots=True)
class Message:
    """One recorded message, not deserialised yet.

    Attributes
    ----------
    topic, msgtype : str
        Where it was recorded and what it is.
    record_ns : int
        When the recorder wrote it, ns; never used as a time of measurement.
    stamp_ns : int
        ``header.stamp``, ns.
    raw : bytes
        As serialised in the bag.
    """

    topic: str
    msgtype: str
    record_ns: int
    stamp_ns: int
    raw: bytes


def stamp_of(raw: bytes, is_ros2: bool) -> int:
    """``header.stamp`` from the first bytes of a message, ns.

    CDR has four bytes of encapsulation before the header, ROS 1 the four bytes of ``seq``: the stamp stands at the
    same place in both.
    """
    order = ">" if is_ros2 and not raw[1] & 1 else "<"
    sec, nanosec = struct.unpack_from(f"{order}iI" if is_ros2 else "<II", raw, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)
