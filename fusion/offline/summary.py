"""A run in a few numbers: for summary.json and for the table on the screen.

Keys are snake_case and end in their unit; `fusion.offline.schemas` describes them, and `VERSION` counts their changes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from compass import CompassStatus
from compass.version import __version__
from fusion.buffer.events import Sensor
from fusion.imu.tilt import tilt_angle
from fusion.offline.console import table
from fusion.offline.open_recording import FileRecording
from fusion.offline.run import FusedRun
from fusion.offline.scores import COMPASS, FUSED, SMOOTHED, scores, yaw_tracks
from fusion.offline.source import Source
from fusion.offline.streams import GyroTrack
from fusion.offline.warning_history import Warned

VERSION = 1  # of the keys; grows when one changes its meaning or goes
KNOWN_DELAY = 0.005  # s, standard deviation of a camera delay that was learnt
MOST_LINES = 5  # warnings on the screen; more than a handful is not read
SMALL_DELAY = 0.005  # s, as much as timestamps jitter anyway
SMALL_MOUNT = 5.0  # deg; turns about an axis that is so askew are seen too small by 1.4 deg in each circle
SMALL_TILT = 8.0  # deg; such a tilt changes a heading by 0.3 deg


def provenance(source: Source, settings_hash: str) -> dict[str, Any]:
    """How a summary begins: which recording it is of, and how that was fused (`earlier_results.settings_hash`)."""
    return {
        "version": VERSION,
        "package_version": __version__,
        "source": asdict(source),
        "settings_hash": settings_hash,
    }


def summarise(run: FusedRun, recording: FileRecording) -> dict[str, Any]:
    """The facts of a run, ready for JSON."""
    tracks, scored = yaw_tracks(run), scores(run)
    t_ns = run.t_ns
    # where these began, at the first image or sample, though they are known from the first increment on only
    starts = {COMPASS: 0.0, FUSED: run.initial_yaw, SMOOTHED: run.initial_yaw}
    yaws: dict[str, dict[str, float | None]] = {}
    for name, track in tracks.items():
        one: dict[str, float | None] = {"turned_deg": _deg(track.yaw[-1] - starts.get(name, track.yaw[0]))}
        if track.sigma is not None:
            one["sigma_deg"] = _deg(track.sigma[-1])
        if name in scored:
            score = scored[name]
            one |= {
                "final_error_deg": _deg(score.final),
                "rms_error_deg": _deg(score.rms),
                "worst_error_deg": _deg(score.worst),
            }
        yaws[key_of(name)] = one
    last = next((row.fused for row in reversed(run.rows) if row.fused), None)
    return {
        "warnings": warning_facts(run),
        "topics": recording.topics,
        "start_ns": int(t_ns[0]) if t_ns.size else None,
        "duration_s": float((t_ns[-1] - t_ns[0]) * 1e-9) if t_ns.size else 0.0,
        "gyro_vertical": recording.vertical,
        "vertical_words": recording.vertical_words if run.gyro.t_ns.size else None,
        "greatest_tilt_deg": _greatest_tilt_deg(run.gyro),
        "truth_turned_deg": None if run.truth is None else _deg(run.truth.yaw[-1] - run.truth.yaw[0]),
        "yaw": yaws,
        "gyro_bias_rad_s": last and last.gyro_bias,
        "gyro_bias_sigma_rad_s": last and math.sqrt(last.gyro_bias_variance),
        "track_scale": last and last.track_scale,
        "track_scale_sigma": last and math.sqrt(last.track_scale_variance),
        "camera_delay_s": last and last.camera_delay,
        "camera_delay_sigma_s": last and math.sqrt(last.camera_delay_variance),
        "camera_roll_deg": _deg(run.mount.roll),
        "camera_pitch_deg": _deg(run.mount.pitch),
        "camera_tilt_sigma_deg": _deg(run.mount.sigma),
        "images": {status.name.lower(): run.compass_counts[status] for status in CompassStatus},
        "samples": _counted("outcome", run.fusion_counts),
        "gates": {sensor.value: _gate_facts(run, sensor) for sensor in Sensor},
        "unusable_messages": _counted("reason", recording.dropped),
    }


def key_of(name: str) -> str:
    """The key of a source of yaw, such as ``raw_compass``."""
    return name.replace(" ", "_")


def _counted(what: str, counts: Counter[str]) -> list[dict[str, Any]]:
    """Counts of texts, which change more easily than keys may."""
    return [{what: text, "count": count} for text, count in sorted(counts.items())]


def warning_facts(run: FusedRun) -> list[dict[str, Any]]:
    """All warnings of a run, most serious first, ready for JSON.

    `since_ns` is the stamp as it was given, `since_s` and `until_s` are seconds from the start of the run and within
    it; `until_s` is None where the warning held to the end.
    """
    return [_warning_facts(one, run.rows[0].t_ns if run.rows else one.spans[0][0]) for one in run.warnings]


def _warning_facts(one: Warned, start_ns: int) -> dict[str, Any]:
    since_ns, until_ns = one.spans[0][0], one.spans[-1][1]
    return {
        "code": one.warning.code,
        "sensor": one.warning.sensor,
        "since_ns": one.warning.since_ns,
        "since_s": round((since_ns - start_ns) * 1e-9, 3),
        "until_s": None if one.lasting else round((until_ns - start_ns) * 1e-9, 3),
        "text": one.warning.text,
    }


def warning_lines(warnings: Sequence[dict[str, Any]], place: str = "summary.json") -> list[str]:
    """The most serious of a summary's warnings, one per line; `place` is where the others stand."""
    shown = warnings[:MOST_LINES]
    lines = [f"warning: {' '.join(one['text'].split())} [{one['code']}, {one['sensor']}]" for one in shown]
    more = len(warnings) - MOST_LINES
    return lines + ([f"and {more} more in {place}"] if more > 0 else [])


def _gate_facts(run: FusedRun, sensor: Sensor) -> dict[str, int]:
    """How many samples of a sensor the filter's gate let pass, refused, and let pass after it had refused for long."""
    report = run.gates.get(sensor)
    verdicts = (report.accepted, report.rejected, report.recovered) if report else (0, 0, 0)
    return dict(zip(("accepted", "rejected", "recovered"), verdicts, strict=True))


def yaw_table(summary: dict[str, Any]) -> str:
    """The yaws of a summary, one source per line, deg."""
    has_truth = summary["truth_turned_deg"] is not None
    header = ["deg", "turned"] + (["final error", "RMS", "worst"] if has_truth else ["sigma"])
    keys = ["turned_deg"] + (["final_error_deg", "rms_error_deg", "worst_error_deg"] if has_truth else ["sigma_deg"])
    rows = [["truth", f"{summary['truth_turned_deg']:.2f}", "", "", ""]] if has_truth else []
    for name, values in summary["yaw"].items():
        rows.append(
            [name.replace("_", " "), *("" if values.get(key) is None else f"{values[key]:.2f}" for key in keys)]
        )
    return table(header, rows)


def remarks(summary: dict[str, Any]) -> list[str]:
    """What was found out that the user may not know: one sentence each."""
    return [
        remark
        for remark in (_delay_remark(summary), _mount_remark(summary), _tilt_remark(summary), _gap_remark(summary))
        if remark
    ]


def _tilt_remark(summary: dict[str, Any]) -> str | None:
    tilt = summary["greatest_tilt_deg"]
    if tilt is None or tilt < SMALL_TILT:
        return None
    return f"the robot was tilted by up to {tilt:.0f} deg; turns were made changes of heading (if it was not: `imu.up`)"


def _mount_remark(summary: dict[str, Any]) -> str | None:
    """On how the camera is mounted; None where that is about level, or not known well enough."""
    roll, pitch, sigma = (summary[key] for key in ("camera_roll_deg", "camera_pitch_deg", "camera_tilt_sigma_deg"))
    if math.hypot(roll, pitch) < max(3.0 * sigma, SMALL_MOUNT):
        return None
    angles = f"roll {roll:.1f} and pitch {pitch:.1f} +- {sigma:.1f} deg"
    return f"the camera is not mounted level on the robot: {angles}; taken into account"


def _gap_remark(summary: dict[str, Any]) -> str | None:
    gaps = summary["images"].get(CompassStatus.FOUND_AGAIN.name.lower())
    if not gaps:
        return None
    return f"after {gaps} gap{'s' * (gaps > 1)} in what the camera showed the compass found its last view again"


def _delay_remark(summary: dict[str, Any]) -> str | None:
    """On the images' stamps; None where nothing was learnt, or they are right."""
    delay, sigma = summary["camera_delay_s"], summary["camera_delay_sigma_s"]
    if delay is None or sigma > KNOWN_DELAY or abs(delay) < max(3.0 * sigma, SMALL_DELAY):
        return None
    return f"images are stamped {1e3 * delay:.0f} +- {1e3 * sigma:.1f} ms after their exposure; taken into account"


def _greatest_tilt_deg(gyro: GyroTrack) -> float | None:
    """Largest tilt of the robot; None where that is never known."""
    known = gyro.up[np.isfinite(gyro.up[:, 0])]
    return max((math.degrees(tilt_angle(tuple(up))) for up in known.tolist()), default=None)


def _deg(angle: float) -> float | None:
    return math.degrees(angle) if math.isfinite(angle) else None
