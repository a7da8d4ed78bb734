"""One picture of a run: yaw, errors, confidence, what the filter learnt, and whether it may be believed."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion.buffer.events import Sensor
from fusion.offline.bands import shade_warnings
from fusion.offline.run import FusedRun, Row
from fusion.offline.scores import COMPASS, FUSED, GYRO, SMOOTHED, TRACKS, YawTrack, errors, yaw_at, yaw_tracks
from fusion.offline.streams import Floats, Times

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe & Ito's colours: told apart by colour-blind readers, too.
COLOURS = {FUSED: "#D55E00", COMPASS: "#0072B2", GYRO: "#009E73", TRACKS: "#CC79A7", SMOOTHED: "#56B4E9"}
SENSOR_COLOURS = {Sensor.COMPASS: COLOURS[COMPASS], Sensor.GYRO: COLOURS[GYRO], Sensor.TRACKS: COLOURS[TRACKS]}
WIDTH = 11.0  # inches
LARGEST = 1e9  # on an axis, in its unit; beyond, numbers are nonsense, and matplotlib finds no ticks
MOST_POINTS = 2000  # per curve; more cannot be seen

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

    panels = _panels(run)
    heights = [2.2 if draw is _yaws else 1.2 for draw in panels]
    height = 1.35 * sum(heights) + 1.4
    figure = Figure(figsize=(WIDTH, height))
    FigureCanvasAgg(figure)
    figure.suptitle(title, y=1.0 - 0.3 / height, fontsize=13, fontweight="bold")
    clock = _Clock(run.rows[0].t_ns)
    axes = figure.subplots(len(panels), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    # Fixed margins in inches: matplotlib's own layout would draw everything twice to find them.
    figure.subplots_adjust(
        left=1.0 / WIDTH, right=1.0 - 2.6 / WIDTH, bottom=0.6 / height, top=1.0 - 0.6 / height, hspace=0.12
    )
    for axis, draw in zip(axes, panels, strict=True):
        draw(axis, run, clock)
        axis.grid(color="0.9", linewidth=0.8)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    figure.align_ylabels(axes)
    axes[-1].set_xlabel("time since start [s]")
    axes[-1].set_xlim(0.0, max(float(clock(run.t_ns)[-1]), 1e-3))
    shade_warnings(axes, run.warnings, run.rows[0].t_ns)
    figure.savefig(path, dpi=110)


def _panels(run: FusedRun) -> list[Panel]:
    """The panels there is something to show in."""
    panels: list[Panel] = [_yaws]
    tracks = yaw_tracks(run)
    if _true_errors(run):
        panels.append(_errors)
    elif len(tracks) > 1 and FUSED in tracks:
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
        axis.plot(clock(t_ns), np.degrees(yaw - _first(run.truth.yaw)), color="0.7", linewidth=5, label="truth")
    for name, track in yaw_tracks(run).items():
        t_ns, yaw = _thin(track.t_ns, track.yaw)
        start = _start(run, track)
        axis.plot(clock(t_ns), np.degrees(yaw - _first(track.yaw) + start), **_style(name))
    axis.set_ylabel("yaw [deg]\nleft is positive")


def _start(run: FusedRun, track: YawTrack) -> float:
    """How far the robot had turned when a track began: by the truth, else by the fused yaw."""
    reference = run.truth or yaw_tracks(run).get(FUSED)
    if reference is None:
        return 0.0
    turned = float(yaw_at(reference, track.t_ns[:1])[0] - _first(reference.yaw))
    return turned if math.isfinite(turned) else 0.0


def _first(values: Floats) -> float:
    """The first number that is one; 0 where none is."""
    known = values[np.isfinite(values)]
    return float(known[0]) if known.size else 0.0


def _most(values: Floats) -> float:
    """The largest magnitude of the numbers that are ones; 0 where none is."""
    return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))


def _true_errors(run: FusedRun) -> dict[str, YawTrack]:
    """Errors of the sources that have two times in common with a truth."""
    if run.truth is None:
        return {}
    found = {name: errors(track, run.truth) for name, track in yaw_tracks(run).items()}
    return {name: error for name, error in found.items() if error}


def _errors(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Errors against the truth; the fused one with the error the filter itself expects."""
    _deviations(axis, _true_errors(run), clock)
    axis.set_ylabel("error [deg]\nagainst truth")


def _differences(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Without truth: how far each source strays from the fused yaw."""
    tracks = yaw_tracks(run)
    fused = tracks.pop(FUSED)
    strayed = {FUSED: YawTrack(fused.t_ns, np.zeros(fused.t_ns.size), fused.sigma)}
    for name, track in tracks.items():
        difference = track.yaw - yaw_at(fused, track.t_ns)
        strayed[name] = YawTrack(track.t_ns, difference - _first(difference))
    _deviations(axis, strayed, clock)
    axis.set_ylabel("difference [deg]\nto fused yaw")


def _deviations(axis: Axes, tracks: dict[str, YawTrack], clock: _Clock) -> None:
    """Curves about zero; the view keeps to the good ones: sources far off leave it, and so does a wide band."""
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    reach = {name: _most(np.degrees(track.yaw)) for name, track in tracks.items()}
    good = [reach[name] for name in (FUSED, COMPASS) if name in reach]
    for name, track in tracks.items():
        t_ns, yaw = _thin(track.t_ns, np.degrees(track.yaw))
        label = f"{name}: {yaw[-1]:+.2f} at the end"
        axis.plot(clock(t_ns), yaw, **(_style(name) | {"label": label}))
        if name == FUSED and track.sigma is not None:
            _, sigma = _thin(track.t_ns, np.degrees(2.0 * track.sigma))
            axis.fill_between(clock(t_ns), -sigma, sigma, **_band("fused, expected (95 %)"))
            # a sigma that grows without end must not flatten the curves
            good.append(min(_most(sigma), 4.0 * max(reach.values()) or math.inf))
    most = max((*reach.values(), *good), default=0.0)
    limit = 1.1 * min(max(min(most, 4.0 * max(good, default=math.inf)), 1e-3), LARGEST)
    axis.set_ylim(-limit, limit)


def _confidence(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Peak correlation of each image; images without an increment on the floor, by reason."""
    given = [(row.t_ns, row.compass.increment.confidence) for row in run.rows if row.compass and row.compass.increment]
    if given:
        t_ns, confidence = (np.array(values) for values in zip(*given, strict=True))
        axis.plot(clock(t_ns), confidence, ".", markersize=2.5, color=COLOURS[COMPASS], label="confidence")
    refused: dict[str, list[int]] = {}
    for row in run.rows:
        if row.compass and not row.compass.increment and row.compass.status.name != "FIRST_FRAME":
            refused.setdefault(row.compass.status.name.lower().replace("_", " "), []).append(row.t_ns)
    for (reason, times), mark in zip(refused.items(), "xv^s*dP", strict=False):
        seconds = clock(np.array(times))
        axis.plot(seconds, np.zeros(len(times)), mark, color=COLOURS[FUSED], markersize=5, label=reason)
    axis.set_ylim(-0.08, 1.05)
    axis.set_ylabel("compass\nconfidence")


def _bias(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Gyro bias with its 95 % band."""
    values = [(row.t_ns, row.fused.gyro_bias, row.fused.gyro_bias_variance) for row in run.rows if row.fused]
    _learnt(axis, clock, values, math.degrees(1.0), COLOURS[GYRO], "gyro bias")
    axis.set_ylabel("gyro bias\n[deg/s]")


def _scale(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """Track scale with its 95 % band."""
    values = [(row.t_ns, row.fused.track_scale, row.fused.track_scale_variance) for row in run.rows if row.fused]
    _learnt(axis, clock, values, 1.0, COLOURS[TRACKS], "track scale")
    axis.set_ylabel("tracks' claimed\nover true turn")


def _learnt(
    axis: Axes, clock: _Clock, values: list[tuple[int, float, float]], unit: float, colour: str, name: str
) -> None:
    """A state with its band, the view fitted to where it has settled."""
    t_ns, _ = _thin(np.array([t for t, _, _ in values], np.int64), np.zeros(len(values)))
    _, state = _thin(t_ns, np.array([value for _, value, _ in values]) * unit, of=len(values))
    variances = np.array([variance for _, _, variance in values], np.float64)
    _, sigma = _thin(t_ns, np.sqrt(np.maximum(variances, 0.0)) * unit, of=len(values))
    axis.plot(clock(t_ns), state, color=colour, label=name)
    axis.fill_between(clock(t_ns), state - 2.0 * sigma, state + 2.0 * sigma, color=colour, alpha=0.2, linewidth=0)
    settled = slice(len(state) // 10, None)
    known = np.isfinite(state[settled]) & np.isfinite(sigma[settled])
    if known.any():
        seen, wide = state[settled][known], 3.0 * float(np.median(sigma[settled][known]))
        low, high = np.clip((seen.min() - wide, seen.max() + wide), -LARGEST, LARGEST).tolist()
        margin = 1e-9 + 1e-6 * max(abs(low), abs(high))
        axis.set_ylim(low - margin, high + margin)


def _innovations(axis: Axes, run: FusedRun, clock: _Clock) -> None:
    """What each sensor said against what was expected, in standard deviations: 95 % belong between the lines."""
    for sensor, colour in SENSOR_COLOURS.items():
        seen = [(row.t_ns, _normalised(row, sensor)) for row in run.rows if sensor in row.gates]
        if not seen:
            continue
        t_ns, value = (np.array(values) for values in zip(*seen, strict=True))
        inside = 100.0 * float(np.mean(np.abs(value) <= 1.96))
        axis.plot(
            clock(t_ns), np.clip(value, -6.0, 6.0), ".", markersize=2.0, alpha=0.6, color=colour,
            label=f"{sensor.value}: {inside:.0f} % inside",
        )  # fmt: skip
    for bound in (-1.96, 1.96):
        axis.axhline(bound, color="0.3", linewidth=0.9, linestyle="--")
    axis.set_ylim(-6.3, 6.3)
    axis.set_ylabel("innovations [sigma]\n95 % between lines")


def _normalised(row: Row, sensor: Sensor) -> float:
    report = row.gates[sensor]
    return report.innovation / report.innovation_sigma if report.innovation_sigma > 0.0 else math.nan


def _style(name: str) -> dict[str, Any]:
    """Line of a source; the fused one in front."""
    front = name == FUSED
    return {"color": COLOURS[name], "linewidth": 1.8 if front else 1.1, "zorder": 3 if front else 2, "label": name}


def _band(label: str) -> dict[str, Any]:
    return {"color": COLOURS[FUSED], "alpha": 0.18, "linewidth": 0, "label": label}


def _thin(t_ns: Times, values: Floats, of: int = 0) -> tuple[Times, Floats]:
    """Every so many-th point, the last one included."""
    count = of or len(t_ns)
    kept = np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(np.int64))
    return (t_ns[kept] if len(t_ns) == count else t_ns), values[kept]
