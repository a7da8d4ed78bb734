"""What ``/diagnostics`` says of streams, compass and filter."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from compass import VisualCompass
from fusion import Sensor, SensorReport, YawEstimate
from nodes.health import Level, StreamHealth

PERIOD_S = 1.0
Finding = tuple[Level, str, dict[str, str]]


class Diagnostics:
    """Publishes the findings of named sources once a second.

    Parameters
    ----------
    node : Node
        Its name stands before the name of each source.
    sources : mapping of str to callable
        Each returns level, message and figures.
    """

    def __init__(self, node: Node, sources: Mapping[str, Callable[[], Finding]]) -> None:
        self._node = node
        self._sources = sources
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # A steady clock: with use_sim_time and a paused bag, the diagnostics go on.
        node.create_timer(PERIOD_S, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        for name, find in self._sources.items():
            level, text, figures = find()
            message.status.append(
                DiagnosticStatus(
                    level=bytes([level]),
                    name=f"{self._node.get_name()}: {name}",
                    message=text,
                    hardware_id="visual_compass",
                    values=[KeyValue(key=key, value=value) for key, value in figures.items()],
                )
            )
        self._publisher.publish(message)


def stream_finding(node: Node, health: StreamHealth, timeout: float) -> Finding:
    """Health of a stream, with the age of its newest used message by the node's clock."""
    level, text, figures = health.judge(time.monotonic(), timeout)
    if health.stamp_ns is not None:
        figures["age [s]"] = f"{(node.get_clock().now().nanoseconds - health.stamp_ns) * 1e-9:.3f}"
    return level, text, figures


def compass_figures(compass: VisualCompass, confidence: float) -> dict[str, str]:
    """The compass's last outcome and the count of every outcome."""
    figures = {
        "status": compass.status.value,
        "confidence": f"{confidence:.3f}",
        "yaw [deg]": f"{math.degrees(compass.yaw):.2f}",
        "yaw sigma [deg]": f"{math.degrees(math.sqrt(compass.yaw_variance)):.3f}",
    }
    return figures | {f"images: {status.value}": str(count) for status, count in dict(compass.counts).items()}


def gate_figures(report: SensorReport | None) -> dict[str, str]:
    """How a sensor's samples fared at the filter's gate."""
    if report is None:
        return {}
    return {
        "NIS": f"{report.nis:.2f}",
        "gate": report.verdict.value,
        "gate: accepted": str(report.accepted),
        "gate: rejected": str(report.rejected),
        "gate: recovered": str(report.recovered),
    }


def count_figures(counts: Counter[str], prefix: str) -> dict[str, str]:
    """The counts whose name begins with `prefix`."""
    return {name: str(count) for name, count in sorted(dict(counts).items()) if name.startswith(prefix)}


def fusion_finding(estimate: YawEstimate | None, live: int) -> Finding:
    """State of the filter; `live` is how many sensors feed it at present."""
    if estimate is None:
        return Level.STALE, "no sample yet", {}
    figures = {
        "yaw [deg]": f"{math.degrees(estimate.yaw):.2f}",
        "yaw sigma [deg]": f"{math.degrees(math.sqrt(estimate.yaw_variance)):.3f}",
        "yaw rate [deg/s]": f"{math.degrees(estimate.yaw_rate):.3f}",
        "gyro bias [deg/s]": f"{math.degrees(estimate.gyro_bias):.4f}",
        "gyro bias sigma [deg/s]": f"{math.degrees(math.sqrt(estimate.gyro_bias_variance)):.4f}",
        "track scale": f"{estimate.track_scale:.4f}",
        "track scale sigma": f"{math.sqrt(estimate.track_scale_variance):.4f}",
        "standstill": str(estimate.standstill),
        "slip": str(estimate.slip),
    }
    if live == 0:
        return Level.STALE, "no sensor feeds the filter", figures
    if live < len(Sensor):
        return Level.WARN, f"only {live} of {len(Sensor)} sensors feed the filter", figures
    return Level.OK, "OK", figures
