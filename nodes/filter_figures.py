"""What ``/diagnostics`` says of the filter: its estimate, its gates, what it has found out about the sensors."""

from __future__ import annotations

import math
from collections import Counter

from fusion import Sensor, SensorReport, YawEstimate
from fusion.imu.tilt import tilt_angle
from fusion.state.filter_state import FilterState
from nodes.diagnostics import Finding
from nodes.health import Level


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
        jitter_ms = 1e3 * math.sqrt(state.jitter.variance)
        return {"references lost": str(state.references_lost), "timestamp jitter [ms]": f"{jitter_ms:.1f}"}
    if sensor is Sensor.TRACKS:
        voice = state.odometry_fields
        spoken = [name for name, spoke in (("pose", voice.pose), ("twist", voice.twist)) if spoke]
        return {"filled in": " and ".join(spoken) or "nothing but zeros so far"}
    up = state.trail.points[-1].up if state.trail.points else None
    return {"tilt of the robot [deg]": f"{math.degrees(tilt_angle(up)):.1f}" if up else "not known"}


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
