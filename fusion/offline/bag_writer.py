"""Bags written: MCAP, as a single file or as a rosbag2 folder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from compass.images.decode import Image
from fusion.offline.atomic_output import staged_file
from fusion.offline.bag import BagError
from fusion.offline.bag_messages import COMPRESSED_IMAGE, IMAGE, IMU, ODOMETRY

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
UNMEASURED = 1e6  # variance of an axis nobody measured: large, yet finite, so that a filter can invert it


class BagWriter(AbstractContextManager["BagWriter"]):
    """Writes messages of the ROS 2 standard types; the bag appears complete, or not at all.

    Parameters
    ----------
    path : Path
        A name ending in ``.mcap`` gives that file, any other a rosbag2 folder.

    Raises
    ------
    BagError
        The name ends in ``.bag``, which readers take for ROS 1.
    """

    def __init__(self, path: Path) -> None:
        if path.suffix == ".bag":
            raise BagError(f"{path}: .bag is for ROS 1; give a name that ends in .mcap, or one for a rosbag2 folder")
        self.path = path
        self._store: Any = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> BagWriter:
        self._stage = staged_file(self.path)
        self._staged = self._stage.__enter__()
        single = self.path.suffix == ".mcap"
        self._folder = self._staged.with_name("bag") if single else self._staged
        self._writer = Writer(self._folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, error, trace)
        if kind is None and self._folder != self._staged:
            next(self._folder.glob("*.mcap")).replace(self._staged)
        self._stage.__exit__(kind, error, trace)

    def write(self, topic: str, msgtype: str, t_ns: int, message: Any) -> None:
        """Append a message, recorded at `t_ns`."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, msgtype, typestore=self._store)
        self._writer.write(self._connections[topic], t_ns, self._store.serialize_cdr(message, msgtype))

    def _make(self, msgtype: str, **fields: Any) -> Any:
        return self._store.types[msgtype](**fields)

    def _header(self, t_ns: int, frame_id: str) -> Any:
        sec, nanosec = divmod(t_ns, 1_000_000_000)
        stamp = self._make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)

    def _vector(self, values: Sequence[float], msgtype: str = "geometry_msgs/msg/Vector3") -> Any:
        x, y, z = map(float, values)
        return self._make(msgtype, x=x, y=y, z=z)

    def _quaternion(self, values: Sequence[float]) -> Any:
        x, y, z, w = map(float, values)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def write_jpeg(self, topic: str, t_ns: int, data: bytes, frame_id: str = "camera") -> None:
        """Append a ``sensor_msgs/CompressedImage`` of JPEG bytes."""
        message = self._make(
            COMPRESSED_IMAGE, header=self._header(t_ns, frame_id), format="jpeg", data=np.frombuffer(data, np.uint8)
        )
        self.write(topic, COMPRESSED_IMAGE, t_ns, message)

    def write_image(self, topic: str, t_ns: int, image: Image, encoding: str, frame_id: str = "camera") -> None:
        """Append a ``sensor_msgs/Image`` of an (H, W) or (H, W, channels) array."""
        height, width = image.shape[:2]
        data = np.ascontiguousarray(image).view(np.uint8).reshape(-1)
        message = self._make(
            IMAGE,
            header=self._header(t_ns, frame_id),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=data.size // height,
            data=data,
        )
        self.write(topic, IMAGE, t_ns, message)

    def write_imu(
        self,
        topic: str,
        t_ns: int,
        angular_velocity: Sequence[float],
        linear_acceleration: Sequence[float] | None = None,
        orientation: Sequence[float] | None = None,
        frame_id: str = "imu",
    ) -> None:
        """Append a ``sensor_msgs/Imu``; what is None is marked as not measured."""
        known, unknown = np.zeros(9), np.array([-1.0] + [0.0] * 8)
        message = self._make(
            IMU,
            header=self._header(t_ns, frame_id),
            orientation=self._quaternion((0.0, 0.0, 0.0, 1.0) if orientation is None else orientation),
            orientation_covariance=unknown if orientation is None else known,
            angular_velocity=self._vector(angular_velocity),
            angular_velocity_covariance=known,
            linear_acceleration=self._vector((0.0, 0.0, 0.0) if linear_acceleration is None else linear_acceleration),
            linear_acceleration_covariance=unknown if linear_acceleration is None else known,
        )
        self.write(topic, IMU, t_ns, message)

    def write_odometry(
        self,
        topic: str,
        t_ns: int,
        yaw: float,
        yaw_rate: float,
        *,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        speed: float = 0.0,
        yaw_variance: float = 0.0,
        rate_variance: float = 0.0,
        frames: tuple[str, str] = ("odom", "base_link"),
    ) -> None:
        """Append a ``nav_msgs/Odometry`` of yaw (rad), yaw rate (rad/s), position (m) and speed along x (m/s)."""
        pose = self._make(
            "geometry_msgs/msg/Pose",
            position=self._vector(position, "geometry_msgs/msg/Point"),
            orientation=self._quaternion((0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))),
        )
        twist = self._make(
            "geometry_msgs/msg/Twist", linear=self._vector((speed, 0, 0)), angular=self._vector((0, 0, yaw_rate))
        )
        message = self._make(
            ODOMETRY,
            header=self._header(t_ns, frames[0]),
            child_frame_id=frames[1],
            pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=_covariance(yaw_variance)),
            twist=self._make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=_covariance(rate_variance)
            ),
        )
        self.write(topic, ODOMETRY, t_ns, message)

    def write_diagnostics(self, topic: str, t_ns: int, name: str, fault: str, values: Mapping[str, object]) -> None:
        """Append a ``diagnostic_msgs/DiagnosticArray`` with one status: OK, or WARN and the fault."""
        status = self._make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=1 if fault else 0,
            name=name,
            message=fault or "OK",
            hardware_id="",
            values=[
                self._make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value)) for key, value in values.items()
            ],
        )
        message = self._make(DIAGNOSTICS, header=self._header(t_ns, ""), status=[status])
        self.write(topic, DIAGNOSTICS, t_ns, message)


def _covariance(variance: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Row-major 6x6 covariance with `variance` for yaw and a large one for every other axis."""
    diagonal = np.full(6, UNMEASURED)
    diagonal[5] = variance
    return np.diag(diagonal).reshape(36)
