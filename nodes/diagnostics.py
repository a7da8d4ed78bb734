"""What ``/diagnostics`` says of streams, compass and filter."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from compass import VisualCompass
from fusion import Sensor, SensorReport, Warning, YawEstimate
from fusion.imu.tilt import tilt_angle
from fusion.state.filter_state import FilterState
from nodes.health import Level, StreamHealth
from nodes.link import Link, unserved
from nodes.throttled_log import ThrottledLog, surviving

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
    """A finding, with those who subscribe to one of its outputs in vain."""
    level, text, figures = finding
    wrong = unserved(node, publisher.topic, publisher.qos_profile)
    if not wrong:
        return finding
    figures |= {f"not matching, {publisher.topic_name}": wrong}
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


def state_figures(sensor: Sensor, state: FilterState) -> dict[str, str]:
    """What the filter has found out about a sensor."""
    if sensor is Sensor.COMPASS:
        stray = 1e3 * math.sqrt(state.jitter.variance)
        return {"references lost": str(state.references_lost), "stamps stray by [ms]": f"{stray:.1f}"}
    if sensor is Sensor.TRACKS:
        voice = state.odometry_fields
        spoken = [name for name, spoke in (("pose", voice.pose), ("twist", voice.twist)) if spoke]
        return {"filled in": " and ".join(spoken) or "nothing but zeros so far"}
    up = state.trail.ups[-1] if state.trail.ups else None
    return {"robot leans by [deg]": f"{math.degrees(tilt_angle(up)):.1f}" if up else "not known"}


def count_figures(counts: Counter[str], prefix: str) -> dict[str, str]:
    """The counts whose name begins with `prefix`."""
    return {name: str(count) for name, count in sorted(dict(counts).items()) if name.startswith(prefix)}


def fusion_finding(estimate: YawEstimate | None, live: int, there: int = len(Sensor)) -> Finding:
    """State of the filter; `live` is how many sensors feed it at present, of those that are `there` at all."""
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
        "camera delay [ms]": f"{1e3 * estimate.camera_delay:.1f}",
        "camera delay sigma [ms]": f"{1e3 * math.sqrt(estimate.camera_delay_variance):.1f}",
        "standstill": str(estimate.standstill),
        "slip": str(estimate.slip),
    }
    if live == 0:
        return Level.STALE, "no sensor feeds the filter", figures
    if live < there:
        return Level.WARN, f"only {live} of {there} sensors feed the filter", figures
    return Level.OK, "OK", figures
