"""A finished run written down: CSV, TUM, MCAP, JSON, YAML and the plot."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fusion.buffer.events import Sensor
from fusion.offline.bag_writer import BagWriter
from fusion.offline.earlier_results import SUMMARY
from fusion.offline.run import FusedRun, Row
from fusion.offline.scores import yaw_at
from fusion.offline.streams import Floats, Times, TruthTrack
from fusion.offline.topics import camera_topic
from fusion.samples import YawEstimate
from fusion.settings import Settings, absent, dump_settings, in_bag

DIAGNOSTICS_EVERY_NS = 1_000_000_000


def write_results(
    folder: Path,
    run: FusedRun,
    settings: Settings,
    summary: dict[str, Any],
    pictures: Sequence[tuple[int, bytes]] = (),
) -> None:
    """Write all result files but the plot into `folder`; no TUM file without a single yaw."""
    write_csv(folder / "yaw.csv", run)
    write_tum(folder / "compass.tum", ((row.t_ns, row.compass.yaw) for row in run.rows if row.compass))
    write_tum(folder / "fused.tum", ((row.t_ns, row.fused.yaw) for row in run.rows if row.fused))
    write_tum(folder / "smoothed.tum", ((row.t_ns, row.smoothed.yaw) for row in run.rows if row.smoothed))
    if run.truth is not None:
        write_tum(folder / "truth.tum", zip(run.t_ns.tolist(), _true_yaws(run.truth, run.t_ns).tolist(), strict=True))
    write_mcap(folder / "result.mcap", run, settings, pictures)
    (folder / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    (folder / "config.yaml").write_text(dump_settings(settings), encoding="utf-8")


COLUMNS = (
    *("t", "compass_yaw", "compass_sigma", "confidence"),
    *("fused_yaw", "fused_sigma", "yaw_rate", "gyro_bias"),
    *("yaw_rate_sigma", "gyro_bias_sigma", "track_scale", "track_scale_sigma", "standstill", "slip"),
    *("camera_delay", "camera_delay_sigma"),
    *("compass_status", *(f"{sensor.value}_nis" for sensor in Sensor)),
    "warnings",
)


def write_csv(path: Path, run: FusedRun) -> None:
    """One line per row, `t` in s, angles in rad; the truth and what smoothing gave in last columns where known."""
    columns, rows = table_of(run)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def table_of(run: FusedRun) -> tuple[list[str], Iterator[dict[str, str]]]:
    """The columns of yaw.csv, and its rows as text; what is unknown is left out."""
    more: dict[str, Floats] = {}
    if any(row.smoothed for row in run.rows):
        estimates = [
            (one.yaw, math.sqrt(one.yaw_variance)) if one else (math.nan, math.nan)
            for one in (row.smoothed for row in run.rows)
        ]
        more["smoothed_yaw"], more["smoothed_sigma"] = np.array(estimates).T
    if run.truth is not None:
        more["truth_yaw"] = _true_yaws(run.truth, run.t_ns)
    rows = (
        row_cells(row) | {name: _cell(values[index]) for name, values in more.items()}
        for index, row in enumerate(run.rows)
    )
    return [*COLUMNS, *more], rows


def row_cells(row: Row) -> dict[str, str]:
    """A row as text, by column of yaw.csv; what is unknown is left out."""
    values: dict[str, float] = {f"{sensor.value}_nis": report.nis for sensor, report in row.gates.items()}
    if row.fused:
        values |= _fused_values(row.fused)
    cells = {name: _cell(value) for name, value in values.items()}
    if row.compass:
        confidence = row.compass.increment.confidence if row.compass.increment else math.nan
        cells |= {"compass_yaw": _cell(row.compass.yaw), "compass_sigma": _cell(row.compass.sigma)}
        cells |= {"confidence": _cell(confidence), "compass_status": row.compass.status.name}
    cells["warnings"] = " ".join(dict.fromkeys(warning.code for warning in row.warnings))
    return {"t": seconds(row.t_ns)} | {name: cell for name, cell in cells.items() if cell}


def _fused_values(estimate: YawEstimate) -> dict[str, float]:
    return {
        "fused_yaw": estimate.yaw,
        "fused_sigma": math.sqrt(estimate.yaw_variance),
        "yaw_rate": estimate.yaw_rate,
        "yaw_rate_sigma": math.sqrt(estimate.yaw_rate_variance),
        "gyro_bias": estimate.gyro_bias,
        "gyro_bias_sigma": math.sqrt(estimate.gyro_bias_variance),
        "track_scale": estimate.track_scale,
        "track_scale_sigma": math.sqrt(estimate.track_scale_variance),
        "camera_delay": estimate.camera_delay,
        "camera_delay_sigma": math.sqrt(estimate.camera_delay_variance),
        "standstill": int(estimate.standstill),
        "slip": int(estimate.slip),
    }


def _true_yaws(truth: TruthTrack, t_ns: Times) -> Floats:
    """The truth at other times, NaN outside of it."""
    yaw = yaw_at(truth, t_ns)
    yaw[(t_ns < truth.t_ns[0]) | (t_ns > truth.t_ns[-1])] = math.nan
    return yaw


def _cell(value: float) -> str:
    return f"{value:.9g}" if math.isfinite(value) else ""


def seconds(t_ns: int) -> str:
    """Nanoseconds as decimal seconds, exactly."""
    return f"{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}"


def write_tum(path: Path, yaws: Iterable[tuple[int, float]]) -> None:
    """Write ``t x y z qx qy qz qw`` per line, as evo reads it, position 0; no file where no yaw is known."""
    lines = [
        f"{seconds(t_ns)} 0 0 0 0 0 {math.sin(0.5 * yaw):.12g} {math.cos(0.5 * yaw):.12g}\n"
        for t_ns, yaw in yaws
        if math.isfinite(yaw)
    ]
    if lines:
        path.write_text("".join(lines), encoding="utf-8")


def write_mcap(path: Path, run: FusedRun, settings: Settings, pictures: Sequence[tuple[int, bytes]] = ()) -> None:
    """Both yaws as Odometry, as the live node publishes them, diagnostics once a second, and small panoramas.

    `pictures` are stamps, ns, and JPEG files.
    """
    topics = settings.topics
    frames = (topics.odom_frame, topics.base_frame)
    told_ns = 0
    with BagWriter(path) as bag:
        for t_ns, jpeg in pictures:
            if jpeg and not absent(topics.compass_image):
                bag.write_jpeg(in_bag(camera_topic(topics.compass_image)), t_ns, jpeg)
        for row in run.rows:
            compass, fused = row.compass, row.fused
            if compass and compass.increment:
                bag.write_odometry(
                    in_bag(topics.compass_output_topic),
                    row.t_ns,
                    compass.yaw,
                    compass.rate,
                    yaw_variance=compass.sigma**2,
                    rate_variance=compass.rate_variance,
                    frames=frames,
                )
            if fused:
                bag.write_odometry(
                    in_bag(topics.fused_output_topic),
                    row.t_ns,
                    fused.yaw,
                    fused.yaw_rate,
                    yaw_variance=fused.heading_variance,
                    rate_variance=fused.yaw_rate_variance,
                    frames=frames,
                )
            if row.t_ns - told_ns >= DIAGNOSTICS_EVERY_NS:
                told_ns = row.t_ns
                bag.write_diagnostics("/diagnostics", row.t_ns, "visual_compass", *_health(row))


def _health(row: Row) -> tuple[str, dict[str, str]]:
    """Fault, if any, and facts of a row; the most serious warning goes before what befell single samples."""
    if row.warnings:
        return row.warnings[0].text, row_cells(row)
    rejected = [sensor.value for sensor, report in row.gates.items() if report.verdict.name == "REJECTED"]
    fault = f"rejected at the gate: {', '.join(rejected)}" if rejected else ""
    if row.compass and row.compass.increment is None:
        fault = fault or f"compass: {row.compass.status.value}"
    return fault, row_cells(row)
