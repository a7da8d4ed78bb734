"""Panoramas, gyro and track odometry in; the raw compass and the fused yaw out."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu

from compass import YawIncrement
from compass.errors import VisualCompassError
from fusion import GyroSample, OdometrySample, YawPipeline
from fusion.messages import gyro_sample, odometry_sample
from fusion.settings import Settings
from fusion.vertical import ImuLevel
from nodes.compass_stream import CompassStream
from nodes.complaints import Complaints
from nodes.conversions import fused_odometry
from nodes.parameters import NodeParameters
from nodes.runtime import run


class FusionNode(Node):
    """Publishes the raw compass and the fused yaw as ``nav_msgs/Odometry``."""

    def __init__(self) -> None:
        super().__init__("fusion_node", automatically_declare_parameters_from_overrides=True)
        parameters = NodeParameters(self, ("topics", "compass", "fusion", "imu"))
        settings = parameters.settings
        topics = settings.topics
        self._complaints = Complaints(self.get_logger().warning)
        self._pipeline = YawPipeline(settings.compass, settings.fusion)
        self._level = ImuLevel(settings.imu)
        self._lock = threading.Lock()  # guards the filter; the compass works outside of it
        self._published_ns = -1
        self._frames = (topics.odom_frame, topics.base_frame)
        self._publisher = self.create_publisher(Odometry, topics.fused_output_topic, 10)
        self._subscribe(Imu, topics.gyro_topic, self._on_gyro)
        self._subscribe(Odometry, topics.odometry_topic, self._on_odometry)
        self._stream = CompassStream(self, settings, self._pipeline.compass, self._complaints, self._fuse)
        parameters.on_change(self._apply)

    def _subscribe(self, kind: type, topic: str, callback: Callable[..., None]) -> None:
        options = QoSOverridingOptions.with_default_policies()
        self.create_subscription(kind, topic, callback, qos_profile_sensor_data, qos_overriding_options=options)

    def _on_gyro(self, message: Imu) -> None:
        try:
            self._fuse(gyro_sample(message, self._level))
        except VisualCompassError as error:
            self._complaints("gyro", error)

    def _on_odometry(self, message: Odometry) -> None:
        try:
            self._fuse(odometry_sample(message))
        except VisualCompassError as error:
            self._complaints("odometry", error)

    def _fuse(self, sample: GyroSample | OdometrySample | YawIncrement) -> None:
        """Add a sample, from whichever thread, and publish what it changed."""
        with self._lock:
            self._pipeline.add(sample)
            estimate = self._pipeline.estimate()
            if estimate is not None and estimate.t_ns > self._published_ns:
                self._published_ns = estimate.t_ns
                self._publisher.publish(fused_odometry(estimate, self._frames))

    def _apply(self, settings: Settings) -> None:
        self._pipeline.compass.config = settings.compass
        self._stream.textout = settings.topics.compass_textout

    def destroy_node(self) -> None:
        """End the image thread, then the node."""
        self._stream.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass fusion_node``."""
    return run(FusionNode, args)


if __name__ == "__main__":
    sys.exit(main())
