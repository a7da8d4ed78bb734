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
from compass.errors import ConfigError
from fusion import OdometrySample, Sensor, Verdict, YawPipeline
from fusion.buffer.events import sensor_of
from fusion.dead_reckoning import DeadReckoning
from fusion.imu.levelling import ImuLevel
from fusion.messages import gyro_sample, odometry_sample
from fusion.settings import NONE, Settings, absent
from nodes.compass_stream import CompassStream
from nodes.conversions import fused_odometry, pose_place, pose_yaw
from nodes.diagnostics import Diagnostics, Finding, delivered, stream_finding, warned
from nodes.filter_figures import count_figures, fusion_finding, gate_figures, state_figures
from nodes.health import StreamHealth
from nodes.link import Link
from nodes.names import INPUTS, check_names, resolved_name
from nodes.parameters import NodeParameters
from nodes.quality import EVERY_SAMPLE_QOS, SENSOR_QOS
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
        check_names(self, topics)
        if all(absent(getattr(topics, parameter)) for parameter in INPUTS):
            raise ConfigError(f"{', '.join(INPUTS)}: none; a filter needs at least one sensor")
        self._settings = settings
        self._log = ThrottledLog(self.get_logger().warning)
        self._tell = WarningLogger(self.get_logger().warning)
        self._pipeline = YawPipeline(settings.compass, settings.fusion)
        self._level = ImuLevel(settings.imu)
        self._pipeline.warning_sources.append(self._level.warnings)
        qos = EVERY_SAMPLE_QOS if topics.reliable else SENSOR_QOS
        self._queue = SampleQueue(self, surviving(self, "fusion", self._log, self._fuse), qos)
        self._health: dict[Sensor, StreamHealth] = {}
        self._links: dict[Sensor, Link] = {}
        self._published_ns = -1
        self._publisher = self.create_publisher(Odometry, topics.fused_output_topic, 10)
        self._frames = (topics.odom_frame, topics.base_frame)
        self._broadcaster = transform_broadcaster(self, self._frames) if topics.publish_tf else None
        self._reckoning = None if topics.position == NONE else DeadReckoning(settings.fusion)
        self._listen(Sensor.GYRO, topics.gyro_topic, lambda message: gyro_sample(message, self._level))
        self._listen(Sensor.TRACKS, topics.odometry_topic, odometry_sample)
        self._stream = None if absent(topics.compass_image) else self._see()
        parameters.on_change(self._apply)
        self.create_service(Empty, "~/reset", self._on_reset)
        set_pose = surviving(self, "set_pose", self._log, self._on_set_pose)
        self.create_subscription(PoseWithCovarianceStamped, "set_pose", set_pose, 10)
        self._jumps = on_jump_back(self, self._reset)
        heard = ", ".join(f"{sensor.value} {link.name}" for sensor, link in self._links.items())
        outputs = [self._stream.output] if self._stream else []
        self.get_logger().info(f"{heard} -> {', '.join([*outputs, self._publisher.topic_name])}")
        self._diagnostics = Diagnostics(self, self._findings())

    def _findings(self) -> dict[str, Callable[[], Finding]]:
        """What the diagnostics speak of: the sensors that are there, then the filter."""
        findings: dict[str, Callable[[], Finding]] = {}
        if self._stream:
            findings["images"] = self._images_finding
        if Sensor.GYRO in self._links:
            findings["gyro"] = lambda: self._sensor_finding(Sensor.GYRO)
        if Sensor.TRACKS in self._links:
            findings["tracks"] = lambda: self._sensor_finding(Sensor.TRACKS)
        return findings | {"fusion": self._fusion_finding}

    def _see(self) -> CompassStream:
        """Subscribe to the panoramas."""
        compass, measure = self._pipeline.compass, self._pipeline.measure_image
        stream = CompassStream(self, self._settings, compass, self._log, measure, self._queue.send, self._queue.call)
        self._health[Sensor.COMPASS], self._links[Sensor.COMPASS] = stream.health, stream.link
        return stream

    def _listen(self, sensor: Sensor, topic: str, convert: Callable[[Any], Sample]) -> None:
        """Subscribe to a sensor that is there and whose messages become samples by `convert`."""
        if absent(topic):
            return
        health = self._health[sensor] = StreamHealth()

        def receive(message: Any) -> None:
            health.receive(time.monotonic())
            self._queue.append(convert(message))

        name = resolved_name(self, topic, sensor.value)
        self._links[sensor] = self._queue.listen(MESSAGES[sensor], topic, surviving(self, name, self._log, receive))

    def _fuse(self, samples: list[Sample]) -> None:
        """Add samples and publish what they changed."""
        for sample in samples:
            sensor = sensor_of(sample)
            before = self._taken(sensor)
            taken = self._pipeline.add(sample)
            for _ in range(self._taken(sensor) - before - taken):  # samples that had waited
                self._count(sensor, sample.t_ns)
            if not taken:
                self._log(self._links[sensor].name, f"refused: {self._pipeline.fusion.refusals[sensor]}")
            elif not (isinstance(sample, YawIncrement) and sample.long_baseline):  # that is the second of its image
                self._count(sensor, sample.t_ns)
                if self._reckoning and isinstance(sample, OdometrySample):
                    self._reckoning.add(sample)
        self._publish()

    def _taken(self, sensor: Sensor) -> int:
        """How many samples of a sensor the filter has been given so far."""
        counts = self._pipeline.fusion.counts
        return counts[f"{sensor.value}: in order"] + counts[f"{sensor.value}: late"]

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
        """Publish the estimate if it is newer than the last; a late sample shows in the next.

        In a bag there may be no next: where every sample counts, one that came late makes the last be published again.
        """
        estimate = self._pipeline.estimate()
        topics = self._settings.topics
        place = self._reckoning.at(estimate) if self._reckoning and estimate else None
        pause_ns = 1e9 / topics.fused_rate if topics.fused_rate > 0.0 else 1.0
        if estimate is None:
            return
        ahead_ns = estimate.t_ns - self._published_ns
        if 0 <= ahead_ns < pause_ns and not (topics.reliable and ahead_ns == 0):
            return
        self._tell(estimate.warnings)
        self._published_ns = estimate.t_ns
        message = fused_odometry(estimate, self._frames, place)
        self._publisher.publish(message)
        if self._broadcaster is not None and ahead_ns:
            self._broadcaster.sendTransform(transform_of(message, inverted=topics.invert_tf))

    def _apply(self, settings: Settings) -> None:
        self._settings = settings
        if self._stream:
            self._stream.apply(settings)

    def _reset(self) -> None:
        """Start everything anew."""
        if self._stream:
            self._stream.reset(self._pipeline.reset)
        else:
            self._pipeline.reset()
        if self._reckoning:
            self._reckoning.reset()
        self._queue.clear()
        self._level.reset()
        self._tell.clear()

    def _on_reset(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        self._reset()
        return response

    def _on_set_pose(self, message: PoseWithCovarianceStamped) -> None:
        yaw, variance = pose_yaw(message)
        if self._reckoning:
            self._reckoning.set_position(*pose_place(message))
        self._pipeline.fusion.set_yaw(yaw, variance)

    def _warned(self, finding: Finding, sensor: Sensor | None = None) -> Finding:
        """A finding with the warnings that go with it; what is new is logged."""
        warnings = self._pipeline.warnings()
        self._tell(warnings)
        return warned(finding, warnings, sensor)

    def _sensor_finding(self, sensor: Sensor) -> Finding:
        timeout = self._settings.topics.sensor_timeout
        level, text, figures = stream_finding(self, self._health[sensor], timeout, self._links[sensor])
        figures |= self._filter_figures(sensor)
        if sensor is Sensor.GYRO:
            figures["vertical from"] = self._level.source
        return self._warned((level, text, figures | self._log.figures(self._links[sensor].name)), sensor)

    def _filter_figures(self, sensor: Sensor) -> dict[str, str]:
        """How a sensor's samples fared in the filter."""
        fusion = self._pipeline.fusion
        known = gate_figures(fusion.reports()[sensor]) | state_figures(sensor, fusion.state)
        return known | count_figures(fusion.counts, f"{sensor.value}: ")

    def _fusion_finding(self) -> Finding:
        timeout, now = self._settings.topics.sensor_timeout, time.monotonic()
        live = sum(health.alive(now, timeout) for health in self._health.values())
        level, text, figures = fusion_finding(self._pipeline.estimate(), live, len(self._health))
        figures |= self._log.figures("fusion")
        figures |= count_figures(self._pipeline.fusion.counts, "reset")
        return self._warned(delivered(self, (level, text, figures), self._publisher))

    def _images_finding(self) -> Finding:
        assert self._stream is not None
        level, text, figures = self._stream.finding()
        return self._warned((level, text, figures | self._filter_figures(Sensor.COMPASS)), Sensor.COMPASS)

    def destroy_node(self) -> None:
        """End the image thread, then the node."""
        if self._stream:
            self._stream.close()
        for link in self._links.values():
            link.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass fusion_node``."""
    return run(FusionNode, args)


if __name__ == "__main__":
    sys.exit(main())
