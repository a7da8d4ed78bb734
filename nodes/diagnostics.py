"""What ``/diagnostics`` says of streams and compass, and how it is published."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from compass import VisualCompass
from fusion.buffer.events import Sensor
from fusion.checks.warnings import Warning
from nodes.health import Level, StreamHealth
from nodes.link import Link, rivals, unserved
from nodes.throttled_log import REPEAT_S, ThrottledLog, surviving

PERIOD_S = 1.0
_QUIET_PERIODS = 3  # after the start: the sensors' drivers may be starting, too
_GONE = (Level.ERROR, Level.STALE)
Finding = tuple[Level, str, dict[str, str]]


class Diagnostics:
    """Publishes the findings of named sources once a second, and logs when one is lost and when it returns.

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
        self._gone: set[str] = set()
        self._periods = 0
        self._warn = ThrottledLog(node.get_logger().warning)
        self._tell = ThrottledLog(lambda line: node.get_logger().info(line))  # rclpy wants one severity a source line
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # A steady clock: with use_sim_time and a paused bag, the diagnostics go on.
        publish = surviving(node, "diagnostics", self._warn, self._publish)
        node.create_timer(PERIOD_S, lambda: publish(DiagnosticArray()), clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self, message: DiagnosticArray) -> None:
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._periods += 1
        for name, find in self._sources.items():
            level, text, figures = find()
            if self._periods > _QUIET_PERIODS:
                self._log(name, level, text)
            message.status.append(
                DiagnosticStatus(
                    level=bytes([level]),
                    name=f"{self._node.get_fully_qualified_name()}: {name}",
                    message=text,
                    hardware_id="visual_compass",
                    values=[KeyValue(key=key, value=value) for key, value in figures.items()],
                )
            )
        self._publisher.publish(message)

    def _log(self, name: str, level: Level, text: str) -> None:
        """For who sees the terminal only; a source that comes and goes is not repeated every second."""
        if level in _GONE and name not in self._gone:
            self._gone.add(name)
            self._warn(name, text)
        elif level not in _GONE and name in self._gone:
            self._gone.remove(name)
            self._tell(name, "back")


def stream_finding(node: Node, health: StreamHealth, timeout: float, link: Link) -> Finding:
    """Health of a stream and of the way it comes, with the age of its newest used message by the node's clock.

    Parameters
    ----------
    node : Node
        The subscriber.
    health : StreamHealth
        Of the stream.
    timeout : float
        Silence from which on it is stale, s.
    link : Link
        The way from its publishers.
    """
    level, text, figures = health.judge(time.monotonic(), timeout)
    wrong, explained, seen = link.look()
    figures |= seen
    if level is Level.STALE and not explained:
        text += link.why_silent()
    if wrong:
        text = wrong if level is Level.OK else f"{text}; {wrong}"
        level = max(level, Level.WARN)
    if health.stamp_ns is not None:
        figures["age [s]"] = f"{(node.get_clock().now().nanoseconds - health.stamp_ns) * 1e-9:.3f}"
    return level, text, figures


def delivered(node: Node, finding: Finding, publisher: Publisher) -> Finding:
    """A finding, with those who subscribe to one of its outputs in vain, or publish there, too."""
    level, text, figures = finding
    unheard, others = unserved(node, publisher.topic, publisher.qos_profile), rivals(node, publisher.topic)
    if not unheard and not others:
        return finding
    if unheard:
        figures |= {f"not matching, {publisher.topic_name}": unheard}
    if others:
        node.get_logger().warning(others, throttle_duration_sec=REPEAT_S)
    wrong = "; ".join(filter(None, (others, unheard)))
    return max(level, Level.WARN), wrong if level is Level.OK else f"{text}; {wrong}", figures


def warned(finding: Finding, warnings: Iterable[Warning], sensor: Sensor | None = None) -> Finding:
    """A finding, with what is wrong (most serious first) with its sensor; with all that is wrong where it is of none.

    The most serious goes into the message, unless the sensor is lost altogether: then it stands behind that.
    """
    level, text, figures = finding
    found = [warning for warning in warnings if sensor is None or sensor.value in warning.sensors]
    if not found:
        return finding
    figures |= {"warnings": ", ".join(dict.fromkeys(warning.code for warning in found))}
    figures |= {f"warning: {warning.code}, {warning.sensor}": warning.text for warning in found}
    if level in _GONE:
        return level, f"{text}; {found[0].text}", figures
    if level is Level.WARN:
        figures["also"] = text
    return Level.WARN, found[0].text, figures


def compass_figures(compass: VisualCompass, confidence: float) -> dict[str, str]:
    """The compass's last outcome and the count of every outcome."""
    figures = {
        "status": compass.status.value,
        "confidence": f"{confidence:.3f}",
        "yaw [deg]": f"{math.degrees(compass.yaw):.2f}",
        "yaw sigma [deg]": f"{math.degrees(math.sqrt(compass.yaw_variance)):.3f}",
        "camera roll on the robot [deg]": f"{math.degrees(compass.mount.roll):.2f}",
        "camera pitch on the robot [deg]": f"{math.degrees(compass.mount.pitch):.2f}",
        "camera tilt sigma [deg]": f"{math.degrees(compass.mount.sigma):.2f}",
    }
    return figures | {f"images: {status.value}": str(count) for status, count in dict(compass.counts).items()}
