"""One picture of a run: yaw, errors, confidence, what the filter learnt, and whether it may be believed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion.buffer.events import Sensor
from fusion.offline.bands import shade_warnings
from fusion.offline.curves import (
    Band,
    aligned_yaws,
    confidences,
    differences,
    first,
    gyro_bias,
    innovations,
    most,
    refused_images,
    thinned,
    track_scale,
    true_errors,
)
from fusion.offline.run import FusedRun
from fusion.offline.scores import COMPASS, FUSED, GYRO, SMOOTHED, TRACKS, YawTrack
from fusion.offline.streams import Floats, Times

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe & Ito's colours: told apart by colour-blind readers, too.
COLOURS = {FUSED: "#D55E00", COMPASS: "#0072B2", GYRO: "#009E73", TRACKS: "#CC79A7", SMOOTHED: "#56B4E9"}
SENSOR_COLOURS = {Sensor.COMPASS: COLOURS[COMPASS], Sensor.GYRO: COLOURS[GYRO], Sensor.TRACKS: COLOURS[TRACKS]}
WIDTH = 11.0  # inches
LABELS = 0.4  # inches from the left edge to the panels' labels; between them and the panels are the ticks'
LARGEST = 1e9  # on an axis, in its unit; beyond, numbers are nonsense, and matplotlib finds no ticks
LIBRARY = ("matplotlib.figure", "matplotlib.backends.backend_agg")  # loaded when a plot is drawn
MOST_POINTS = 2000  # per curve; more cannot be seen
CJK_FONTS = (
    *("Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Serif CJK JP", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei"),
    *("IPAexGothic", "IPAGothic", "Droid Sans Fallback", "Hiragino Sans", "Microsoft YaHei", "Malgun Gothic"),
)

Panel = Callable[["Axes", FusedRun, "_Clock"], None]


class _Clock:
    """Nanoseconds to seconds since the run's start."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns

    def __call__(self, t_ns: Times) -> Floats:
        return 1e-9 * np.asarray(np.asarray(t_ns, np.int64) - self._start_ns, np.float64)


def plot_run(run: FusedRun, path: Path, title: str) -> None:
    """Draw `run` into a PNG at `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox, blended_transform_factory

    panels = _panels(run)
    heights = [2.2 if draw is _yaws else 1.2 for draw in panels]
    height = 1.35 * sum(heights) + 1.4
    figure = Figure(figsize=(WIDTH, height), dpi=110)
    canvas = FigureCanvasAgg(figure)
    title, fonts = drawable(" ".join(title.split()))
    heading = figure.suptitle(title, y=1.0 - 0.3 / height, fontsize=13, fontweight="bold", parse_math=False)
    if fonts:
        heading.set_fontfamily(fonts)
    clock = _Clock(run.rows[0].t_ns)
    axes = figure.subplots(len(panels), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    # Fixed margins in inches: matplotlib's own layout would draw everything twice to find them.
    figure.subplots_adjust(
        left=1.0 / WIDTH, right=1.0 - 2.6 / WIDTH, bottom=0.6 / height, top=1.0 - 0.6 / height, hspace=0.12
    )
    for axis, draw in zip(axes, panels, strict=True):
        draw(axis, run, clock)
        # One line for all labels; matplotlib would measure every panel's ticks for every other panel to find it.
        axis.yaxis.set_label_coords(LABELS / WIDTH, 0.5, blended_transform_factory(figure.transFigure, axis.transAxes))
        axis.grid(color="0.9", linewidth=0.8)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    axes[-1].set_xlabel("time since start [s]")
    axes[-1].set_xlim(0.0, max(float(clock(run.t_ns)[-1]), 1e-3))
    shade_warnings(axes, run.warnings, run.rows[0].t_ns)
    # No legend is cut off, no room left for one; "tight" would mean the same, and draw everything once to find out.
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    beside = [heading, *filter(None, (axis.get_legend() for axis in axes))]
    within = Bbox.from_extents(0.0, 0.0, axes[0].bbox.x1, figure.bbox.y1)
    box = Bbox.union([within, *(one.get_window_extent(renderer) for one in beside)])
    figure.savefig(path, bbox_inches=box.transformed(figure.dpi_scale_trans.inverted()).padded(0.1))


def _panels(run: FusedRun) -> list[Panel]:
    """The panels there is something to show in."""
    panels: list[Panel] = [_yaws]
    if true_errors(run):
        panels.append(_errors)
    elif differences(run):
        panels.append(_differences)
    if any(row.compass for row in run.rows):
        panels.append(_confidence)
    estimated = any(row.fused for row in run.rows)
    if run.gyro.t_ns.size and estimated:
        panels.append(_bias)
    if run.odometry.t_ns.size and estimated:
        panels.append(_scale)
    panels.append(_innovations)
    return panels


def _yaws(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Accumulated yaw of all sources."""
    if run.truth is not None:
        t_ns, yaw = _thin(run.truth.t_ns, run.truth.yaw)
        axis.plot(clock(t_ns), np.degrees(yaw - first(run.truth.yaw)), color="0.7", linewidth=5, label="truth")
    for name, track in aligned_yaws(run).items():
        t_ns, yaw = _thin(track.t_ns, track.yaw)
        axis.plot(clock(t_ns), np.degrees(yaw), **_style(name))
    axis.set_ylabel("yaw [deg]\nleft is positive")


def _errors(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Errors against the truth; the fused one with the error the filter itself expects."""
    _deviations(axis, true_errors(run), clock)
    axis.set_ylabel("error [deg]\nagainst truth")


def _differences(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Without truth: how far each source deviates from the fused yaw."""
    _deviations(axis, differences(run), clock)
    axis.set_ylabel("difference [deg]\nto fused yaw")


def _deviations(axis: Axes, tracks: dict[str, YawTrack], clock: _Clock) -> None:
    """Curves about zero; the view keeps to the good ones: sources far off leave it, and so does a wide band."""
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    expected = 0.0
    for name, track in tracks.items():
        t_ns, yaw = _thin(track.t_ns, np.degrees(track.yaw))
        label = f"{name}: {yaw[-1]:+.2f} at the end"
        axis.plot(clock(t_ns), yaw, **(_style(name) | {"label": label}))
        if name == FUSED and track.sigma is not None:
            t_ns, sigma = _thin(track.t_ns, np.degrees(2.0 * track.sigma))
            axis.fill_between(clock(t_ns), -sigma, sigma, **_band("fused, expected (95 %)"))
            expected = most(sigma)
    limit = deviation_limit({name: most(np.degrees(track.yaw)) for name, track in tracks.items()}, expected)
    axis.set_ylim(-limit, limit)


def deviation_limit(reach: dict[str, float], expected: float) -> float:
    """How far a panel of deviations shows, deg, from how far each source and the expected error reach.

    The good sources fill a third of it or more: no sigma without end and no runaway sensor flattens them.
    """
    good = max((reach[name] for name in (FUSED, COMPASS) if reach.get(name)), default=0.0)
    whole = max((*reach.values(), expected), default=0.0)
    most_of_it = 3.0 * (good or max(reach.values(), default=0.0)) or whole
    return 1.1 * min(max(min(whole, most_of_it), 1e-3), LARGEST)


def _confidence(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Peak correlation of each image; images without an increment on the floor, by reason."""
    t_ns, confidence = confidences(run)
    if t_ns.size:
        axis.plot(clock(t_ns), confidence, ".", markersize=2.5, color=COLOURS[COMPASS], label="confidence")
    for (reason, times), mark in zip(refused_images(run).items(), "xv^s*dP", strict=False):
        axis.plot(clock(times), np.zeros(times.size), mark, color=COLOURS[FUSED], markersize=5, label=reason)
    axis.set_ylim(-0.08, 1.05)
    axis.set_ylabel("compass\nconfidence")


def _bias(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Gyro bias with its 95 % band."""
    _learnt(axis, clock, gyro_bias(run), COLOURS[GYRO], "gyro bias")
    axis.set_ylabel("gyro bias\n[deg/s]")


def _scale(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Track scale with its 95 % band."""
    _learnt(axis, clock, track_scale(run), COLOURS[TRACKS], "track scale")
    axis.set_ylabel("tracks' claimed\nover true turn")


def _learnt(axis: Axes, clock: _Clock, band: Band, colour: str, name: str) -> None:
    """A state with its band."""
    kept = thinned(band[1], MOST_POINTS)
    t_ns, state, sigma = band[0][kept], band[1][kept], band[2][kept]
    axis.plot(clock(t_ns), state, color=colour, label=name)
    axis.fill_between(clock(t_ns), state - 2.0 * sigma, state + 2.0 * sigma, color=colour, alpha=0.2, linewidth=0)
    limits = learnt_limits(state, sigma)
    if limits:
        axis.set_ylim(*limits)


def learnt_limits(state: Floats, sigma: Floats) -> tuple[float, float] | None:
    """The view of a learnt state (N,) with its sigma (N,): where it has settled; None where nothing is known.

    The band is seen to 3 sigma of the quarter of the time in which it is narrowest: one that grows without end leaves
    the view.
    """
    settled = slice(len(state) // 10, None)
    known = np.isfinite(state[settled]) & np.isfinite(sigma[settled])
    if not known.any():
        return None
    seen, wide = state[settled][known], 3.0 * float(np.quantile(sigma[settled][known], 0.25))
    low, high = np.clip((seen.min() - wide, seen.max() + wide), -LARGEST, LARGEST).tolist()
    margin = 1e-9 + 1e-6 * max(abs(low), abs(high))
    return low - margin, high + margin


def _innovations(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """What each sensor said against what was expected, in standard deviations: 95 % belong between the lines."""
    for sensor, (t_ns, value) in innovations(run).items():
        inside = 100.0 * float(np.mean(np.abs(value) <= 1.96))
        axis.plot(
            clock(t_ns), np.clip(value, -6.0, 6.0), ".", markersize=2.0, alpha=0.6, color=SENSOR_COLOURS[sensor],
            label=f"{sensor.value}: {inside:.0f} % inside",
        )  # fmt: skip
    for bound in (-1.96, 1.96):
        axis.axhline(bound, color="0.3", linewidth=0.9, linestyle="--")
    axis.set_ylim(-6.3, 6.3)
    axis.set_ylabel("innovations [sigma]\n95 % between lines")


def _style(name: str) -> dict[str, Any]:
    """Line of a source; the fused one in front."""
    front = name == FUSED
    return {"color": COLOURS[name], "linewidth": 1.8 if front else 1.1, "zorder": 3 if front else 2, "label": name}


def _band(label: str) -> dict[str, Any]:
    return {"color": COLOURS[FUSED], "alpha": 0.18, "linewidth": 0, "label": label}


def _thin(t_ns: Times, values: Floats) -> tuple[Times, Floats]:
    kept = thinned(values, MOST_POINTS)
    return t_ns[kept], values[kept]


def drawable(text: str) -> tuple[str, list[str]]:
    """A text as the installed fonts can draw it, and their names: of the first one, and of one that knows the rest.

    Characters that no font knows (Chinese, Japanese and Korean ones without a font for them) become boxes.
    """
    from matplotlib.font_manager import FontProperties, findfont, fontManager, get_font

    plain = get_font(findfont(FontProperties())).get_charmap()
    foreign = {ord(letter) for letter in text} - plain.keys()
    if not foreign:
        return text, []
    for name in CJK_FONTS:
        entry = next((one for one in fontManager.ttflist if one.name == name), None)
        if entry is not None and foreign <= get_font(entry.fname).get_charmap().keys():
            return text, [FontProperties().get_family()[0], name]
    return "".join("\u25a1" if ord(letter) in foreign else letter for letter in text), []
