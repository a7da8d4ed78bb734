"""The report of a run: all its curves, zoomable, with the panorama and the warnings at the cursor's time."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compass.errors import VisualCompassError
from compass.version import __version__
from fusion.offline.report.panels import panels_of
from fusion.offline.report.thumbnails import Thumbnails
from fusion.offline.run import FusedRun

if TYPE_CHECKING:
    from bokeh.model import Model

FILE = "report.html"
NO_NETWORK = "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data:"
GENERATOR = '<meta name="generator" content="visual-compass">'
STYLE = """
body { margin: 0; font: 14px/1.4 system-ui, sans-serif; color: #222; background: #fff; }
main { max-width: 1400px; margin: auto; padding: 0 1em 2em; }
h1 { font-size: 1.3em; margin: .6em 0; overflow-wrap: anywhere; }
table { border-collapse: collapse; } td, th { padding: .15em .8em .15em 0; text-align: right; vertical-align: top; }
td:first-child, th:first-child, .words td, .words th { text-align: left; }
#view { position: sticky; top: 0; z-index: 5; background: #fff; padding: .3em 0; border-bottom: 1px solid #ddd; }
#panorama { display: block; width: 480px; max-width: 100%; height: auto; }
.held { background: #fdf3b0; }
"""
# What happens at a cursor's time t: lines through all panels, the panorama, the warnings that hold.
CURSOR = """
const t = cb_obj.x;
if (!Number.isFinite(t)) return;
for (const line of lines) { line.location = t; line.visible = true; }
const data = window.panoramaData ??= JSON.parse(document.getElementById("thumbnails").textContent);
document.getElementById("time").textContent = t.toFixed(2);
let low = 0, high = data.t.length - 1;
while (low < high) { const mid = (low + high + 1) >> 1; if (data.t[mid] <= t) low = mid; else high = mid - 1; }
if (data.t.length) document.getElementById("panorama").src = data.picture[low];
for (const row of document.querySelectorAll("#warnings tr[data-spans]")) {
    row.classList.toggle("held", JSON.parse(row.dataset.spans).some(([since, until]) => since <= t && t <= until));
}
"""
TEMPLATE = """
{% block preamble %}__GENERATOR__<meta http-equiv="Content-Security-Policy" content="__POLICY__">
<style>__STYLE__</style>{% endblock %}
{% block contents %}<main>__HEAD__{{ super() }}</main>
<script type="application/json" id="thumbnails">__PICTURES__</script>
<script>
const firstPicture = JSON.parse(document.getElementById("thumbnails").textContent).picture[0];
if (firstPicture) document.getElementById("panorama").src = firstPicture;
</script>{% endblock %}"""


class ReportError(VisualCompassError):
    """A report that cannot be written."""


def check_bokeh() -> None:
    """Raise `ReportError` where the library that draws is not installed: before anything is fused."""
    try:
        import bokeh  # noqa: F401
    except ImportError:
        raise ReportError(
            "--report needs Bokeh, which is not installed: pip install 'visual-compass[report]'"
        ) from None


def write_report(
    path: Path, run: FusedRun, summary: Mapping[str, Any], title: str, pictures: Thumbnails | None = None
) -> None:
    """Write the report of a run as one HTML file: library, curves and pictures inside, no network needed.

    Parameters
    ----------
    path : Path
        File to write.
    run : FusedRun
        With at least one row.
    summary : mapping
        As `summarise` gives it.
    title : str
        Heading.
    pictures : Thumbnails, optional
        That watched the run.

    Raises
    ------
    ReportError
        Bokeh is not installed.
    """
    check_bokeh()
    from bokeh.events import MouseMove, Tap
    from bokeh.layouts import gridplot
    from bokeh.models import CustomJS, Span

    start_ns = run.rows[0].t_ns
    figures = panels_of(run)
    lines = [Span(dimension="height", line_color="#444", line_width=1, visible=False) for _ in figures]
    cursor = CustomJS(args={"lines": lines}, code=CURSOR)
    for figure, line in zip(figures, lines, strict=True):
        figure.add_layout(line)
        figure.js_on_event(MouseMove, cursor)
        figure.js_on_event(Tap, cursor)
    head = _head(run, summary, title, bool(pictures and pictures.pictures))
    grid = gridplot([[one] for one in figures], sizing_mode="stretch_width", toolbar_options={"logo": None})
    page = rendered(grid, title, head, pictures, start_ns)
    path.write_text(page, encoding="utf-8", errors="backslashreplace")  # names that are not UTF-8


def rendered(model: Model, title: str, head: str, pictures: Thumbnails | None = None, start_ns: int = 0) -> str:
    """A page with Bokeh's library inlined; `head` is HTML."""
    from bokeh.embed import file_html
    from bokeh.resources import INLINE

    page: str = file_html(model, INLINE, title, template=TEMPLATE)
    parts = {"GENERATOR": GENERATOR, "POLICY": NO_NETWORK, "STYLE": STYLE, "HEAD": head}
    parts["PICTURES"] = pictures.as_json(start_ns) if pictures else '{"t": [], "picture": []}'
    for name, part in parts.items():
        page = page.replace(f"__{name}__", part, 1)
    return page


def _head(run: FusedRun, summary: Mapping[str, Any], title: str, has_pictures: bool) -> str:
    """Heading, what turned how far, and what was wrong."""
    first = '<img id="panorama" alt="the panorama at the cursor\'s time">' if has_pictures else "<i>no images</i>"
    return (
        f"<h1>{html.escape(title)}</h1>\n{_yaws(summary)}\n{_warnings(run)}\n"
        f'<div id="view">{first}<div>t = <span id="time">0.00</span> s of {summary["duration_s"]:.1f} s</div></div>\n'
        "<p>Drag to zoom in time; ctrl and the wheel zoom, too; the toolbar moves, and shows all again. A click in a "
        f"legend hides its curve. Yellow: a warning holds. visual-compass {__version__}</p>"
    )


def _yaws(summary: Mapping[str, Any]) -> str:
    keys = {
        "turned_deg": "turned", "sigma_deg": "sigma at the end", "final_error_deg": "final error",
        "rms_error_deg": "RMS error", "worst_error_deg": "worst error",
    }  # fmt: skip
    used = {key: name for key, name in keys.items() if any(key in values for values in summary["yaw"].values())}
    lines = ["<tr><th>deg</th>" + "".join(f"<th>{name}</th>" for name in used.values()) + "</tr>"]
    if summary["truth_turned_deg"] is not None:
        lines.append(f"<tr><td>truth</td><td>{_number(summary['truth_turned_deg'])}</td></tr>")
    for source, values in summary["yaw"].items():
        cells = "".join(f"<td>{_number(values.get(key))}</td>" for key in used)
        lines.append(f"<tr><td>{html.escape(source.replace('_', ' '))}</td>{cells}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _warnings(run: FusedRun) -> str:
    """What was wrong, in words; rows light up while the cursor is where they held."""
    if not run.warnings:
        return "<p>No warnings.</p>"
    start_ns, lines = run.rows[0].t_ns, []
    for one in run.warnings:
        spans = [
            [round(1e-9 * (since - start_ns), 3), round(1e-9 * (until - start_ns), 3)] for since, until in one.spans
        ]
        when = ", ".join(f"{since:.1f} to {until:.1f} s" for since, until in spans[:3]) + (" ..." if spans[3:] else "")
        lines.append(
            f'<tr data-spans="{spans}"><td>{when}</td><td>{html.escape(one.warning.code)}</td>'
            f"<td>{html.escape(one.warning.sensor)}</td><td>{html.escape(one.warning.text)}</td></tr>"
        )
    return f'<table class="words" id="warnings">{"".join(lines)}</table>'


def _number(value: float | None) -> str:
    return f"{value:.2f}" if value is not None and math.isfinite(value) else ""
