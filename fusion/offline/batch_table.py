"""Many results in one table, a row for each recording: summary.csv, and summary.parquet where pyarrow is installed."""

from __future__ import annotations

import csv
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fusion.offline.atomic_output import refuse_existing, staged_file
from fusion.offline.bag_task import BagOutcome

CSV, PARQUET = "summary.csv", "summary.parquet"
_OURS = b"visual_compass"  # key in the metadata of a Parquet file
_FOOTER = 256 << 10  # bytes; that of some fifty columns has a tenth of it

_SOURCES = ("fused", "smoothed", "raw_compass", "gyro_alone", "tracks_alone")
_FACTS = ("turned_deg", "sigma_deg", "final_error_deg", "rms_error_deg", "worst_error_deg")
_ESTIMATES = (
    *("gyro_bias_rad_s", "gyro_bias_sigma_rad_s", "track_scale", "track_scale_sigma"),
    *("camera_delay_s", "camera_delay_sigma_s", "camera_roll_deg", "camera_pitch_deg", "camera_tilt_sigma_deg"),
)
_TEXTS = ("bag", "folder", "status", "error", "warnings", "content", "settings_hash", "package_version")
_COUNTS = ("start_ns", "images", "size_bytes")
COLUMNS = (
    *("bag", "folder", "status", "error", "warnings", "start_ns", "duration_s", "truth_turned_deg"),
    *(f"{source}_{fact}" for source in _SOURCES for fact in _FACTS),
    *_ESTIMATES,
    *("images", "processing_s", "size_bytes", "content", "settings_hash", "package_version"),
)


def row_of(outcome: BagOutcome, table: Path) -> dict[str, Any]:
    """An outcome as a row, None where something is unknown; `table` is the folder of the table."""
    summary = outcome.summary
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    folder = outcome.folder
    row |= {"bag": outcome.bag, "status": outcome.status, "error": outcome.error, "warnings": ""}
    row["folder"] = str(folder.relative_to(table) if folder.is_relative_to(table) else folder)
    row["processing_s"] = round(outcome.seconds, 3)
    if not summary:
        return row
    facts = {key: summary.get(key) for key in ("start_ns", "duration_s", "truth_turned_deg", *_ESTIMATES)}
    for source in _SOURCES:
        yaw = summary["yaw"].get(source)
        facts |= {f"{source}_{fact}": yaw.get(fact) for fact in _FACTS if isinstance(yaw, dict)}
    row |= {name: value for name, value in facts.items() if type(value) in (int, float)}
    row["warnings"] = " ".join(
        dict.fromkeys(str(one.get("code")) for one in summary["warnings"] if isinstance(one, dict))
    )
    row["images"] = sum(count for count in summary["images"].values() if type(count) is int)
    row |= {"settings_hash": summary["settings_hash"], "package_version": str(summary.get("package_version"))}
    row["size_bytes"], row["content"] = summary["source"]["size_bytes"], summary["source"]["content"]
    return row


def check_tables(folder: Path, *, force: bool = False) -> None:
    """Refuse to replace tables of those names that are not ours.

    Raises
    ------
    OutputError
        There is such a table.
    """
    refuse_existing(folder / CSV, force=force, begins=",".join(COLUMNS[:4]).encode())
    refuse_existing(folder / PARQUET, force=force or _is_ours(folder / PARQUET))


def _is_ours(parquet: Path) -> bool:
    """Whether a Parquet file has our key in the metadata at its end, which are not compressed."""
    try:
        with parquet.open("rb") as file:
            file.seek(max(parquet.stat().st_size - _FOOTER, 0))
            return _OURS in file.read()
    except OSError:
        return False


def _as_text(value: Any) -> Any:
    """Names of files need not be UTF-8."""
    return value.encode(errors="backslashreplace").decode() if isinstance(value, str) else value


def write_tables(folder: Path, rows: Sequence[dict[str, Any]]) -> list[Path]:
    """Write the tables, each complete or not at all; the paths of those that were written."""
    rows = [{name: _as_text(value) for name, value in row.items()} for row in rows]
    with staged_file(folder / CSV) as staged, staged.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    if importlib.util.find_spec("pyarrow") is None:
        if _is_ours(folder / PARQUET):
            (folder / PARQUET).unlink()  # it says no longer what is here
        return [folder / CSV]
    import pyarrow
    from pyarrow import parquet

    kinds = {**dict.fromkeys(_TEXTS, pyarrow.string()), **dict.fromkeys(_COUNTS, pyarrow.int64())}
    schema = pyarrow.schema(
        [(name, kinds.get(name, pyarrow.float64())) for name in COLUMNS], metadata={_OURS: b"results, a row a bag"}
    )
    columns = {name: [row[name] for row in rows] for name in COLUMNS}
    with staged_file(folder / PARQUET) as staged:
        parquet.write_table(pyarrow.table(columns, schema=schema), staged)
    return [folder / CSV, folder / PARQUET]
