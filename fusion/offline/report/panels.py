"""The panels of a report: Bokeh figures that share their axis of time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from fusion.offline import curves
from fusion.offline.bands import COLOUR
from fusion.offline.plot import COLOURS, LARGEST, SENSOR_COLOURS, deviation_limit, learnt_limits
from fusion.offline.run import FusedRun
from fusion.offline.scores import COMPASS, FUSED, GYRO, TRACKS, YawTrack
from fusion.offline.streams import Floats, Times

if TYPE_CHECKING:
    from bokeh.plotting import figure as Figure  # noqa: N812

MOST_POINTS = 10_000  # per curve, of which a jump of one sample is never left out; 120 kB on the page
TRUTH = "truth"
REFUSED = ("x", "inverted_triangle", "triangle", "square", "star", "diamond", "plus")


class Panels:
    """Makes figures for a run.

    Parameters
    ----------
    run : FusedRun
        With at least one row.
    """

    def __init__(self, run: FusedRun) -> None:
        from bokeh.models import Range1d

        self.run, self.start_ns = run, run.rows[0].t_ns
        last = max(float(self._seconds(run.t_ns)[-1]), 1e-3)
        margin = 0.01 * last
        self.x_range = Range1d(-margin, last + margin, bounds=(-last, 2.0 * last))
        self.figures: list[Figure] = []
        self._scaled: set[Figure] = set()  # those with limits, or with a number that tells some

    def _seconds(self, t_ns: Times) -> Floats:
        return 1e-9 * np.asarray(np.asarray(t_ns, np.int64) - self.start_ns, np.float64)

    def add(
        self, label: str, *, height: int = 170, limits: tuple[float, float] | None = None, log: bool = False
    ) -> Figure:
        """A new panel at the bottom."""
        from bokeh.models import BoxZoomTool, PanTool, Range1d, ResetTool, SaveTool, WheelZoomTool
        from bokeh.plotting import figure

        # the wheel alone scrolls the page
        drag, wheel = BoxZoomTool(dimensions="width"), WheelZoomTool(dimensions="width", modifiers="ctrl")
        made = figure(
            height=height, sizing_mode="stretch_width", x_range=self.x_range, y_axis_label=label,
            y_axis_type="log" if log else "linear",
            tools=[drag, PanTool(dimensions="width"), wheel, ResetTool(), SaveTool()],
            active_drag=drag, active_scroll=wheel, min_border_left=75, toolbar_location="right",
        )  # fmt: skip
        if limits is not None:
            made.y_range = Range1d(*limits)
            self._scaled.add(made)
        self.figures.append(made)
        return made

    def line(self, panel: Figure, name: str, t_ns: Times, values: Floats, colour: str, width: float = 1.2) -> None:
        """A curve with its entry in the legend, which hides it at a click."""
        values = np.where(np.abs(values) <= LARGEST, values, np.nan)
        if np.isfinite(values).any():
            self._scaled.add(panel)
        kept = curves.thinned(values, MOST_POINTS)
        panel.line(
            self._seconds(t_ns[kept]),
            values[kept].astype(np.float32),
            color=colour,
            line_width=width,
            legend_label=name,
        )

    def band(self, panel: Figure, t_ns: Times, low: Floats, high: Floats, colour: str) -> None:
        """The area between two curves."""
        low, high = (np.clip(np.nan_to_num(values, nan=0.0), -LARGEST, LARGEST) for values in (low, high))
        kept = curves.thinned(high - low, MOST_POINTS)
        panel.varea(
            self._seconds(t_ns[kept]), low[kept].astype(np.float32), high[kept].astype(np.float32),
            fill_color=colour, fill_alpha=0.18,
        )  # fmt: skip

    def dots(
        self,
        panel: Figure,
        name: str,
        t_ns: Times,
        values: Floats,
        colour: str,
        marker: str = "circle",
        size: float = 3,
    ) -> None:
        """A cloud with its entry in the legend."""
        kept = curves.thinned(values, MOST_POINTS)
        seconds, values = self._seconds(t_ns[kept]), values[kept].astype(np.float32)
        panel.scatter(seconds, values, color=colour, size=size, marker=marker, alpha=0.7, legend_label=name)

    def finish(self) -> list[Figure]:
        """All panels: warnings shaded, legends outside, the axis of time named at the bottom."""
        from bokeh.models import Range1d

        spans = [span for one in self.run.warnings for span in one.spans]
        since, until = (
            (self._seconds(np.array(edges, np.int64)) for edges in zip(*spans, strict=True)) if spans else ([], [])
        )
        for panel in self.figures:
            if panel not in self._scaled:
                panel.y_range = Range1d(0.1, 10.0)
            panel.vstrip(x0=since, x1=until, level="underlay", fill_color=COLOUR, fill_alpha=0.25, line_color=COLOUR)
            if panel.legend:
                panel.add_layout(panel.legend[0], "right")
                panel.legend.update(
                    click_policy="hide", label_text_font_size="11px", border_line_color=None, label_width=170
                )
        self.figures[-1].xaxis.axis_label = "time since start [s]"
        return self.figures


def panels_of(run: FusedRun) -> list[Figure]:
    """The panels there is something to show in; the first one is the yaw."""
    panels = Panels(run)
    _yaws(panels, run)
    errors = curves.true_errors(run)
    differing = errors or curves.differences(run)
    if differing:
        _deviations(panels, differing, "error [deg]" if errors else "difference to fused [deg]")
    _sigmas(panels, run)
    if any(row.compass for row in run.rows):
        _confidence(panels, run)
    _innovations(panels, run)
    if any(row.fused for row in run.rows):
        if run.gyro.t_ns.size:
            _learnt(panels, curves.gyro_bias(run), "gyro bias [deg/s]", COLOURS[GYRO])
        if run.odometry.t_ns.size:
            _learnt(panels, curves.track_scale(run), "track scale", COLOURS[TRACKS])
    return panels.finish()


def _yaws(panels: Panels, run: FusedRun) -> None:
    panel = panels.add("yaw [deg], left +", height=300)
    if run.truth is not None:
        yaw = np.degrees(run.truth.yaw - curves.first(run.truth.yaw))
        panels.line(panel, TRUTH, run.truth.t_ns, yaw, "#bbbbbb", 5.0)
    for name, track in _fused_last(curves.aligned_yaws(run)):
        panels.line(panel, name, track.t_ns, np.degrees(track.yaw), COLOURS[name], 2.0 if name == FUSED else 1.2)


def _deviations(panels: Panels, tracks: dict[str, YawTrack], label: str) -> None:
    expected = tracks[FUSED].sigma if FUSED in tracks else None
    reach = {name: curves.most(np.degrees(track.yaw)) for name, track in tracks.items()}
    limit = deviation_limit(reach, 0.0 if expected is None else curves.most(np.degrees(2.0 * expected)))
    panel = panels.add(label, height=220, limits=(-limit, limit))
    if expected is not None:
        two_sigma = np.degrees(2.0 * expected)
        panels.band(panel, tracks[FUSED].t_ns, -two_sigma, two_sigma, COLOURS[FUSED])
    for name, track in _fused_last(tracks):
        panels.line(panel, name, track.t_ns, np.degrees(track.yaw), COLOURS[name], 2.0 if name == FUSED else 1.2)


def _sigmas(panels: Panels, run: FusedRun) -> None:
    """On a logarithmic axis: a sigma without end leaves the others readable."""
    tracks = {name: track for name, track in curves.aligned_yaws(run).items() if track.sigma is not None}
    if not tracks:
        return
    panel = panels.add("sigma of yaw [deg]", log=True)
    for name, track in _fused_last(tracks):
        if track.sigma is not None:
            sigma = np.degrees(np.where(track.sigma > 0.0, track.sigma, np.nan))
            panels.line(panel, name, track.t_ns, sigma, COLOURS[name], 2.0 if name == FUSED else 1.2)


def _confidence(panels: Panels, run: FusedRun) -> None:
    panel = panels.add("compass confidence", limits=(-0.08, 1.05))
    t_ns, confidence = curves.confidences(run)
    if t_ns.size:
        panels.dots(panel, "confidence", t_ns, confidence, COLOURS[COMPASS])
    for (reason, times), marker in zip(curves.refused_images(run).items(), REFUSED, strict=False):
        panels.dots(panel, reason, times, np.zeros(times.size), COLOURS[FUSED], marker, 6)


def _innovations(panels: Panels, run: FusedRun) -> None:
    from bokeh.models import Span

    panel = panels.add("innovations [sigma]", limits=(-6.3, 6.3))
    for sensor, (t_ns, value) in curves.innovations(run).items():
        inside = 100.0 * float(np.mean(np.abs(value) <= 1.96))
        name = f"{sensor.value}: {inside:.0f} % in 1.96"
        panels.dots(panel, name, t_ns, np.clip(value, -6.0, 6.0), SENSOR_COLOURS[sensor])
    for bound in (-1.96, 1.96):
        panel.add_layout(Span(location=bound, dimension="width", line_color="#666666", line_dash="dashed"))


def _learnt(panels: Panels, band: curves.Band, label: str, colour: str) -> None:
    t_ns, state, sigma = band
    panel = panels.add(label, limits=learnt_limits(state, sigma))
    panels.band(panel, t_ns, state - 2.0 * sigma, state + 2.0 * sigma, colour)
    panels.line(panel, label.split(" [")[0], t_ns, state, colour)


def _fused_last(tracks: dict[str, YawTrack]) -> Iterable[tuple[str, YawTrack]]:
    """So that it is drawn in front."""
    return sorted(tracks.items(), key=lambda item: item[0] == FUSED)
