"""Curves of a run, for plots and reports: on one scale, and thinned without losing what stands out."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from fusion.buffer.events import Sensor
from fusion.offline.run import FusedRun, Row
from fusion.offline.scores import FUSED, YawTrack, errors, yaw_at, yaw_tracks
from fusion.offline.streams import Floats, Times

Curve = tuple[Times, Floats]
Band = tuple[Times, Floats, Floats]  # times, values, standard deviations


def aligned_yaws(run: FusedRun) -> dict[str, YawTrack]:
    """The yaw of each source, rad, which begins where the robot had turned to by then."""
    return {
        name: YawTrack(track.t_ns, track.yaw - first(track.yaw) + _start(run, track), track.sigma)
        for name, track in yaw_tracks(run).items()
    }


def _start(run: FusedRun, track: YawTrack) -> float:
    """How far the robot had turned when a track began: by the truth, else by the fused yaw."""
    reference = run.truth or yaw_tracks(run).get(FUSED)
    if reference is None:
        return 0.0
    turned = float(yaw_at(reference, track.t_ns[:1])[0] - first(reference.yaw))
    return turned if math.isfinite(turned) else 0.0


def true_errors(run: FusedRun) -> dict[str, YawTrack]:
    """Errors, rad, of the sources that have two times in common with a truth."""
    if run.truth is None:
        return {}
    found = {name: errors(track, run.truth) for name, track in yaw_tracks(run).items()}
    return {name: error for name, error in found.items() if error}


def differences(run: FusedRun) -> dict[str, YawTrack]:
    """How far each source deviates from the fused yaw, rad; empty without one, or beside nothing else."""
    tracks = yaw_tracks(run)
    if FUSED not in tracks or len(tracks) < 2:
        return {}
    fused = tracks.pop(FUSED)
    differing = {FUSED: YawTrack(fused.t_ns, np.zeros(fused.t_ns.size), fused.sigma)}
    for name, track in tracks.items():
        difference = track.yaw - yaw_at(fused, track.t_ns)
        differing[name] = YawTrack(track.t_ns, difference - first(difference))
    return differing


def confidences(run: FusedRun) -> Curve:
    """Confidence of the images that gave an increment."""
    given = [(row.t_ns, row.compass.increment.confidence) for row in run.rows if row.compass and row.compass.increment]
    return np.array([t for t, _ in given], np.int64), np.array([value for _, value in given], np.float64)


def refused_images(run: FusedRun) -> dict[str, Times]:
    """Times of the images without an increment, by reason."""
    refused: dict[str, list[int]] = {}
    for row in run.rows:
        if row.compass and not row.compass.increment and row.compass.status.name != "FIRST_FRAME":
            refused.setdefault(row.compass.status.name.lower().replace("_", " "), []).append(row.t_ns)
    return {reason: np.array(times, np.int64) for reason, times in refused.items()}


def gyro_bias(run: FusedRun) -> Band:
    """What the filter takes the gyro's bias for, deg/s."""
    values = [(row.t_ns, row.fused.gyro_bias, row.fused.gyro_bias_variance) for row in run.rows if row.fused]
    return _band(values, math.degrees(1.0))


def track_scale(run: FusedRun) -> Band:
    """What the filter takes the tracks' claimed over true turn for."""
    return _band([(r.t_ns, r.fused.track_scale, r.fused.track_scale_variance) for r in run.rows if r.fused], 1.0)


def _band(values: list[tuple[int, float, float]], unit: float) -> Band:
    t_ns = np.array([t for t, _, _ in values], np.int64)
    state = np.array([value for _, value, _ in values], np.float64) * unit
    variance = np.array([variance for _, _, variance in values], np.float64)
    return t_ns, state, np.sqrt(np.maximum(variance, 0.0)) * unit


def innovations(run: FusedRun) -> dict[Sensor, Curve]:
    """What each sensor said against what was expected, in standard deviations."""
    found = {}
    for sensor in Sensor:
        seen = [(row.t_ns, _normalised(row, sensor)) for row in run.rows if sensor in row.gates]
        if seen:
            found[sensor] = np.array([t for t, _ in seen], np.int64), np.array([value for _, value in seen])
    return found


def _normalised(row: Row, sensor: Sensor) -> float:
    report = row.gates[sensor]
    return report.innovation / report.innovation_sigma if report.innovation_sigma > 0.0 else math.nan


def first(values: Floats) -> float:
    """The first number that is one; 0 where none is."""
    known = values[np.isfinite(values)]
    return float(known[0]) if known.size else 0.0


def most(values: Floats) -> float:
    """The largest magnitude of the numbers that are ones; 0 where none is."""
    return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))


def thinned(values: Floats, points: int) -> npt.NDArray[np.int64]:
    """Indices of at most `points` of the values (N,), in order: of each of equal pieces the least and the greatest.

    So a jump or a spike of one sample stays in sight; the first and the last value are always there.
    """
    if values.size <= points:
        return np.arange(values.size, dtype=np.int64)
    edges = np.linspace(0, values.size, (points - 2) // 2 + 1).astype(np.int64)
    low, high = np.nan_to_num(values, nan=math.inf), np.nan_to_num(values, nan=-math.inf)
    kept = {0, values.size - 1}
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        kept.add(begin + int(low[begin:end].argmin()))
        kept.add(begin + int(high[begin:end].argmax()))
    return np.array(sorted(kept), np.int64)
