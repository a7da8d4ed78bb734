"""Tiny bags: a textured panorama that turns, a gyro, tracks; in every format."""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START_NS = 1_700_000_000_000_000_000


@dataclasses.dataclass(frozen=True)
class TinyDrive:
    """A robot that stands for a second, then turns left; images at 10 Hz, gyro at 100 Hz, tracks at 20 Hz."""

    seconds: float = 3.0
    rate: float = 0.5
    gyro_bias: float = 0.01
    width: int = 256
    camera_delay: float = 0.0  # from the exposure to the stamp, s
    body: bool = False  # whether the lower 30 % of the image show the robot itself

    def turn_rate(self, t: Any) -> Any:
        """Reached within half a second, as a robot of some mass does it."""
        return self.rate * np.clip((np.asarray(t) - 1.0) / 0.5, 0.0, 1.0)

    def yaw(self, t: Any) -> Any:
        since = np.maximum(np.asarray(t) - 1.0, 0.0)
        return self.rate * np.where(since < 0.5, since**2, since - 0.25)

    def times(self, hertz: float) -> np.ndarray:
        return np.arange(int(self.seconds * hertz) + 1) / hertz

    def panorama(self, t: float, seed: int = 5) -> np.ndarray:
        """Smooth texture with a camera's noise; a turn to the left moves the scene to the right by a Fourier shift."""
        wave = np.exp(-1j * float(self.yaw(t)) * np.arange(self.width // 2 + 1))
        scene = np.fft.irfft(_spectrum(self.width, seed) * wave, self.width, axis=1)
        if self.body:
            own = np.random.default_rng(11).normal(size=(self.width // 16, self.width // 8))
            picture = cv2.resize(own, (self.width, self.width // 2), interpolation=cv2.INTER_CUBIC)
            first = round(0.7 * scene.shape[0])
            scene[first:] = (scene.std() * picture / picture.std())[first:]
        grain = np.random.default_rng(round((t + 1.0) * 1e6)).normal(size=scene.shape)
        return np.clip(np.rint(128 + 50 * scene / scene.std() + grain), 0, 255).astype(np.uint8)


@lru_cache(maxsize=4)
def _spectrum(width: int, seed: int) -> np.ndarray:
    """Fourier transform along the rows of a smooth texture of twice as many columns as rows."""
    texture = np.random.default_rng(seed).normal(size=(width // 2, width))
    rows, columns = np.fft.fftfreq(width // 2), np.fft.rfftfreq(width)
    smooth = np.exp(-((rows[:, None] ** 2 + columns[None, :] ** 2) / (2 * 0.05**2)))
    return np.fft.ifft(np.fft.rfft2(texture) * smooth, axis=0)


class TinyBag:
    """Writes messages with chosen record order, stamps and formats."""

    def __init__(self, path: Path, *, storage: str = "mcap") -> None:
        self.path = path
        self.ros1 = storage == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_JAZZY)
        if self.ros1:
            self.writer: Any = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
            self.writer = Writer2(path, version=9, storage_plugin=plugin)
        self.connections: dict[str, Any] = {}
        self.recorded_ns = START_NS

    def __enter__(self) -> TinyBag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def make(self, msgtype: str, **fields: Any) -> Any:
        kind = self.store.types[msgtype]
        return kind(**fields)

    def header(self, t_ns: int) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="x", **extra)

    def write(self, topic: str, message: Any) -> None:
        """Append; the record time only ever counts up, whatever the stamp says."""
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.recorded_ns += 1000
        self.writer.write(self.connections[topic], self.recorded_ns, serialize(message, kind))

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", x=float(x), y=float(y), z=float(z))

    def quaternion(self, x: float, y: float, z: float, w: float) -> Any:
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def imu(self, topic: str, t_ns: int, rate: float) -> None:
        """An IMU with z up and no orientation."""
        none = np.array([-1.0] + [0.0] * 8)
        self.write(
            topic,
            self.make(
                "sensor_msgs/msg/Imu",
                header=self.header(t_ns),
                orientation=self.quaternion(0.0, 0.0, 0.0, 0.0),
                orientation_covariance=none,
                angular_velocity=self.vector(0, 0, rate),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=self.vector(0, 0, 9.81),
                linear_acceleration_covariance=np.zeros(9),
            ),
        )

    def odometry(self, topic: str, t_ns: int, yaw: float, rate: float, speed: float = 0.0) -> None:
        orientation = self.quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        pose = self.make("geometry_msgs/msg/Pose", position=self.vector(0, 0, 0, "Point"), orientation=orientation)
        twist = self.make("geometry_msgs/msg/Twist", linear=self.vector(speed, 0, 0), angular=self.vector(0, 0, rate))
        none = np.zeros(36)
        self.write(
            topic,
            self.make(
                "nav_msgs/msg/Odometry",
                header=self.header(t_ns),
                child_frame_id="base_link",
                pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=none),
                twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=none),
            ),
        )

    def image(self, topic: str, t_ns: int, pixels: np.ndarray, encoding: str = "mono8") -> None:
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
        self.write(
            topic,
            self.make(
                "sensor_msgs/msg/Image",
                header=self.header(t_ns),
                height=height,
                width=width,
                encoding=encoding,
                is_bigendian=0,
                step=data.size // height,
                data=data,
            ),
        )

    def compressed(self, topic: str, t_ns: int, pixels: np.ndarray, extension: str = ".jpg") -> None:
        self.bytes(topic, t_ns, cv2.imencode(extension, pixels)[1].tobytes())

    def bytes(self, topic: str, t_ns: int, data: bytes) -> None:
        """A CompressedImage of any bytes, sound or not."""
        buffer = np.frombuffer(data, np.uint8)
        header = self.header(t_ns)
        self.write(topic, self.make("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=buffer))


def fill(bag: TinyBag, drive: TinyDrive, *, images: str = "compressed", shuffle: bool = False) -> None:
    """Write the drive, by time or (`shuffle`) with small samples recorded at random and images swapped in pairs."""
    events: list[tuple[float, str]] = []
    for hertz, kind in ((100.0, "imu"), (20.0, "odometry"), (20.0, "truth"), (10.0, "image")):
        events += [(t, kind) for t in drive.times(hertz)]
    events.sort()
    if shuffle:
        small = [event for event in events if event[1] != "image"]
        seen = [event for event in events if event[1] == "image"]
        np.random.default_rng(1).shuffle(small)
        pairs = [event for i in range(0, len(seen), 2) for event in reversed(seen[i : i + 2])]
        events = [(float(t), str(kind)) for t, kind in small] + pairs
    for t, kind in events:
        _write(bag, drive, t, kind, images)


def _write(bag: TinyBag, drive: TinyDrive, t: float, kind: str, images: str) -> None:
    t_ns = START_NS + round(t * 1e9)
    rate = float(drive.turn_rate(t))
    if kind == "imu":
        bag.imu("/imu/data", t_ns, rate + drive.gyro_bias)
    elif kind == "odometry":
        bag.odometry("/odom", t_ns, 1.2 * float(drive.yaw(t)), 1.2 * rate)
    elif kind == "truth":
        bag.odometry("/ground_truth/odom", t_ns, float(drive.yaw(t)), rate)
    elif images == "compressed":
        bag.compressed("/viz/pano/image/compressed", t_ns, drive.panorama(t - drive.camera_delay))
    elif images == "raw":
        bag.image("/viz/pano/image", t_ns, drive.panorama(t - drive.camera_delay))
