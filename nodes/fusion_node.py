"""Panoramas, gyro and track odometry in; the raw compass and the fused yaw out."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_srvs.srv import Empty

from compass import YawIncrement
from fusion import Sensor, Verdict, YawPipeline
from fusion.buffer.events import fault_of, sensor_of
from fusion.imu.levelling import ImuLevel
from fusion.messages import gyro_sample, odometry_sample
from fusion.settings import Settings
from nodes.compass_stream import CompassStream
from nodes.conversions import fused_odometry, pose_yaw
from nodes.diagnostics import (
    Diagnostics,
    Finding,
    count_figures,
    fusion_finding,
    gate_figures,
    state_figures,
    stream_finding,
    warned,
)
from nodes.health import StreamHealth
from nodes.parameters import NodeParameters
from nodes.runtime import on_jump_back, run
from nodes.sample_queue import Sample, SampleQueue
from nodes.throttled_log import ThrottledLog, WarningLogger, surviving
from nodes.transforms import transform_broadcaster, transform_of

MESSAGES = {Sensor.GYRO: Imu, Sensor.TRACKS: Odometry}


class FusionNode(Node):
    """Publishes the raw compass and the fused yaw as ``nav_msgs/Odometry``."""

    def __init__(self) -> None:
        super().__init__("fusion_node", automatically_declare_parameters_from_overrides=True)
        parameters = NodeParameters(self, ("topics", "compass", "fusion", "imu"))
        settings = parameters.settings
        topics = settings.topics
        self._settings = settings
        self._topics = {Sensor.GYRO: topics.gyro_topic, Sensor.TRACKS: topics.odometry_topic}
        self._log = ThrottledLog(self.get_logger().warning)
        self._tell = WarningLogger(self.get_logger().warning)
        self._pipeline = YawPipeline(settings.compass, settings.fusion)
        self._level = ImuLevel(settings.imu)
        self._pipeline.warning_sources.append(self._level.warnings)
        self._queue = SampleQueue(self, surviving(self, "fusion", self._log, self._fuse))
        self._health = {sensor: StreamHealth() for sensor in Sensor}
        self._published_ns = -1
        self._publisher = self.create_publisher(Odometry, topics.fused_output_topic, 10)
        self._broadcaster = transform_broadcaster(self) if topics.publish_tf else None
        self._listen(Sensor.GYRO, lambda message: gyro_sample(message, self._level))
        self._listen(Sensor.TRACKS, odometry_sample)
        self._stream = CompassStream(
            self, settings, self._pipeline.compass, self._log, self._pipeline.measure_image, self._queue.send
        )
        self._health[Sensor.COMPASS], self._topics[Sensor.COMPASS] = self._stream.health, self._stream.topic
        parameters.on_change(self._apply)
        self.create_service(Empty, "~/reset", self._on_reset)
        set_pose = surviving(self, "set_pose", self._log, self._on_set_pose)
        self.create_subscription(PoseWithCovarianceStamped, "set_pose", set_pose, 10)
        self._jumps = on_jump_back(self, self._reset)
        heard = ", ".join(f"{sensor.value} {topic}" for sensor, topic in self._topics.items())
        self.get_logger().info(f"{heard} -> {topics.compass_output_topic}, {topics.fused_output_topic}")
        self._diagnostics = Diagnostics(
            self,
            {
                "images": self._images_finding,
                "gyro": lambda: self._sensor_finding(Sensor.GYRO),
                "tracks": lambda: self._sensor_finding(Sensor.TRACKS),
                "fusion": self._fusion_finding,
            },
        )

    def _listen(self, sensor: Sensor, convert: Callable[[Any], Sample]) -> None:
        """Subscribe to a sensor whose messages become samples by `convert`."""
        topic, health = self._topics[sensor], self._health[sensor]

        def receive(message: Any) -> None:
            health.receive(time.monotonic())
            self._queue.append(convert(message))

        self._queue.listen(MESSAGES[sensor], topic, surviving(self, topic, self._log, receive))

    def _fuse(self, samples: list[Sample]) -> None:
        """Add samples and publish what they changed."""
        for sample in samples:
            sensor = sensor_of(sample)
            if not self._pipeline.add(sample):
                why = fault_of(sample) or "late beyond lag_window, far ahead of all others, or known already"
                self._log(self._topics[sensor], f"refused: {why}")
            elif not (isinstance(sample, YawIncrement) and sample.long_baseline):  # that is the second of its image
                self._count(sensor, sample.t_ns)
        self._publish()

    def _count(self, sensor: Sensor, t_ns: int) -> None:
        """Note whether the filter used a sample that it took in."""
        if self._accepted(sensor):
            self._health[sensor].use(time.monotonic(), t_ns)
        else:
            self._health[sensor].refuse(time.monotonic())

    def _accepted(self, sensor: Sensor) -> bool:
        report = self._pipeline.fusion.reports()[sensor]
        return report is None or report.verdict is not Verdict.REJECTED

    def _publish(self) -> None:
        """Publish the estimate if it is newer than the last; a late sample shows in the next."""
        estimate = self._pipeline.estimate()
        topics = self._settings.topics
        pause_ns = 1e9 / topics.fused_rate if topics.fused_rate > 0.0 else 1.0
        if estimate is None or 0 <= estimate.t_ns - self._published_ns < pause_ns:
            return
        self._tell(estimate.warnings)
        self._published_ns = estimate.t_ns
        message = fused_odometry(estimate, (topics.odom_frame, topics.base_frame))
        self._publisher.publish(message)
        if self._broadcaster is not None:
            self._broadcaster.sendTransform(transform_of(message))

    def _apply(self, settings: Settings) -> None:
        self._settings = settings
        self._stream.apply(settings)

    def _reset(self) -> None:
        """Start everything anew."""
        self._stream.reset(self._pipeline.reset)
        self._queue.clear()
        self._level.reset()
        self._tell.clear()

    def _on_reset(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        self._reset()
        return response

    def _on_set_pose(self, message: PoseWithCovarianceStamped) -> None:
        yaw, variance = pose_yaw(message)
        self._pipeline.fusion.set_yaw(yaw, variance)

    def _warned(self, finding: Finding, sensor: Sensor | None = None) -> Finding:
        """A finding with the warnings that go with it; what is new is logged."""
        warnings = self._pipeline.warnings()
        self._tell(warnings)
        return warned(finding, warnings, sensor)

    def _sensor_finding(self, sensor: Sensor) -> Finding:
        timeout = self._settings.topics.sensor_timeout
        level, text, figures = stream_finding(
            self, self._health[sensor], timeout, self._topics[sensor], MESSAGES[sensor]
        )
        figures |= self._filter_figures(sensor)
        if sensor is Sensor.GYRO:
            figures["vertical from"] = self._level.source
        return self._warned((level, text, figures | self._log.figures(self._topics[sensor])), sensor)

    def _filter_figures(self, sensor: Sensor) -> dict[str, str]:
        """How a sensor's samples fared in the filter."""
        fusion = self._pipeline.fusion
        known = gate_figures(fusion.reports()[sensor]) | state_figures(sensor, fusion.state)
        return known | count_figures(fusion.counts, f"{sensor.value}: ")

    def _fusion_finding(self) -> Finding:
        timeout, now = self._settings.topics.sensor_timeout, time.monotonic()
        live = sum(health.alive(now, timeout) for health in self._health.values())
        level, text, figures = fusion_finding(self._pipeline.estimate(), live)
        figures |= self._log.figures("fusion")
        return self._warned((level, text, figures | count_figures(self._pipeline.fusion.counts, "reset")))

    def _images_finding(self) -> Finding:
        level, text, figures = self._stream.finding()
        return self._warned((level, text, figures | self._filter_figures(Sensor.COMPASS)), Sensor.COMPASS)

    def destroy_node(self) -> None:
        """End the image thread, then the node."""
        self._stream.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass fusion_node``."""
    return run(FusionNode, args)


if __name__ == "__main__":
    sys.exit(main())
