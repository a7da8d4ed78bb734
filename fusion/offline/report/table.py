"""The report of many runs: one sortable table of a folder of results, each row linked to its run."""

from __future__ import annotations

import html
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fusion.offline.atomic_output import staged_file
from fusion.offline.report.page import FILE, GENERATOR, NO_NETWORK, STYLE, ReportError

LARGEST_SUMMARY = 10_000_000  # bytes; ours have some thousand
# column: where it stands in summary.json, decimals (None: text)
FUSED = ("yaw", "fused")
COLUMNS: dict[str, tuple[tuple[str, ...], int | None]] = {
    "duration [s]": (("duration_s",), 1),
    "turned [deg]": ((*FUSED, "turned_deg"), 2),
    "sigma [deg]": ((*FUSED, "sigma_deg"), 2),
    "final error [deg]": ((*FUSED, "final_error_deg"), 2),
    "RMS error [deg]": ((*FUSED, "rms_error_deg"), 2),
    "worst error [deg]": ((*FUSED, "worst_error_deg"), 2),
    "gyro bias [rad/s]": (("gyro_bias_rad_s",), 5),
    "track scale": (("track_scale",), 3),
}
SORTABLE = """
th { cursor: pointer; position: sticky; top: 0; background: #fff; }
th[data-order="up"]::after { content: " \\25b4"; } th[data-order="down"]::after { content: " \\25be"; }
"""
SORT = """
for (const head of document.querySelectorAll("th")) head.addEventListener("click", () => {
    const body = document.querySelector("tbody"), column = head.cellIndex, up = head.dataset.order !== "up";
    for (const other of document.querySelectorAll("th")) delete other.dataset.order;
    head.dataset.order = up ? "up" : "down";
    const key = row => { const v = row.cells[column].dataset.value; return v === "" ? NaN : isNaN(v) ? v : Number(v); };
    const rows = [...body.rows].sort((a, b) => {
        const [x, y] = [key(a), key(b)];
        if (x !== x || y !== y) return (x !== x) - (y !== y);  // what is not known comes last
        return (x < y ? -1 : x > y ? 1 : 0) * (up ? 1 : -1);
    });
    body.append(...rows);
});
"""


def report_of_folder(folder: Path) -> tuple[Path, int]:
    """Write ``report.html`` into a folder of results; gives its path and how many runs it lists.

    Raises
    ------
    ReportError
        There are no results in it, or a file of that name that is not ours.
    OutputError
        It cannot be written.
    """
    if not folder.is_dir():
        raise ReportError(f"{folder}: no folder; give the folder that holds the folders of results")
    if (folder / "summary.json").exists():
        raise ReportError(
            f"{folder}: the results of one run; its own report is made by fuse --report, else give {folder.parent}"
        )
    runs = [(file.parent, _summary(file)) for file in sorted(folder.glob("*/summary.json"))]
    if not runs:
        raise ReportError(f"{folder}: no folder in it holds a summary.json, as fuse writes it")
    target = folder / FILE
    if target.is_file() and GENERATOR not in target.read_text(encoding="utf-8", errors="replace"):
        raise ReportError(f"{target}: is not a report of ours, and would be lost; move it away")
    with staged_file(target) as staged:
        staged.write_text(table_page(folder, runs), encoding="utf-8", errors="backslashreplace")
    return target, len(runs)


def table_page(folder: Path, runs: Sequence[tuple[Path, Mapping[str, Any]]]) -> str:
    """The page, given each run's folder and summary."""
    title = html.escape(f"{folder.resolve().name}: {len(runs)} runs")
    heads = "".join(f"<th>{name}</th>" for name in ("run", *COLUMNS, "warnings", "which"))
    body = "\n".join(_row(folder, run, summary) for run, summary in runs)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">{GENERATOR}\n'
        f'<meta http-equiv="Content-Security-Policy" content="{NO_NETWORK}">\n<title>{title}</title>\n'
        f"<style>{STYLE}{SORTABLE}</style></head>\n<body><main><h1>{title}</h1>\n"
        f"<p>A click on a column's name sorts by it; of the fused yaw.</p>\n"
        f"<table><thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n</tbody></table></main>\n"
        f"<script>{SORT}</script></body></html>\n"
    )


def _row(folder: Path, run: Path, summary: Mapping[str, Any]) -> str:
    page = next((name for name in (FILE, "yaw.png", "summary.json") if (run / name).exists()), "")
    name = str(run.relative_to(folder))
    link = f'<a href="{quote(os.fsencode(f"{name}/{page}"))}">{html.escape(name)}</a>'
    cells = [f'<td data-value="{html.escape(name)}">{link}</td>']
    for place, decimals in COLUMNS.values():
        value = _value(summary, place)
        shown = "" if value is None else f"{value:.{decimals}f}"
        cells.append(f'<td data-value="{"" if value is None else value}">{shown}</td>')
    found = summary.get("warnings")
    codes = [str(one.get("code", "")) for one in found if isinstance(one, Mapping)] if isinstance(found, list) else []
    words = html.escape(", ".join(dict.fromkeys(codes)))
    cells += [f'<td data-value="{len(codes)}">{len(codes)}</td>', f'<td data-value="{words}">{words}</td>']
    return f"<tr>{''.join(cells)}</tr>"


def _value(summary: Any, place: Sequence[str]) -> float | None:
    """A number of a summary; None where there is none."""
    for key in place:
        summary = summary.get(key) if isinstance(summary, Mapping) else None
    known = isinstance(summary, int | float) and math.isfinite(summary)
    return float(summary) if known else None


def _summary(file: Path) -> Mapping[str, Any]:
    from compass.files import read_bounded

    try:
        content = json.loads(read_bounded(file, LARGEST_SUMMARY, "remove it, or fuse that recording again"))
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise ReportError(f"{file}: no summary of ours; fuse that recording again, or remove its folder")
    return content
