"""Yaws of all sources on one scale, and their errors against the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion.offline.run import FusedRun
from fusion.offline.streams import Floats, GyroTrack, OdometryTrack, Times, TruthTrack, unwrap

COMPASS, GYRO, TRACKS, FUSED, SMOOTHED = "raw compass", "gyro alone", "tracks alone", "fused", "smoothed"


@dataclass(frozen=True, slots=True)
class YawTrack:
    """Accumulated yaw of one source: `t_ns` (N,), `yaw` (N,) rad, `sigma` (N,) rad or None where it claims none."""

    t_ns: Times
    yaw: Floats
    sigma: Floats | None = None


@dataclass(frozen=True, slots=True)
class Score:
    """Error of one source against the truth, aligned where both begin.

    Attributes
    ----------
    final, rms, worst : float
        Signed error at the end, root mean square and largest magnitude, rad.
    """

    final: float
    rms: float
    worst: float


def yaw_tracks(run: FusedRun) -> dict[str, YawTrack]:
    """The yaw of each source that has one, accumulated from its own start."""
    tracks = {}
    seen = [row for row in run.rows if row.compass and math.isfinite(row.compass.yaw)]
    if seen:
        values = np.array([(row.compass.yaw, row.compass.sigma) for row in seen if row.compass])
        tracks[COMPASS] = YawTrack(np.array([row.t_ns for row in seen], np.int64), *values.T)
    if run.gyro.t_ns.size:
        tracks[GYRO] = gyro_alone(run.gyro)
    if run.odometry.t_ns.size:
        tracks[TRACKS] = tracks_alone(run.odometry)
    for name, estimates in (
        (FUSED, [row.fused for row in run.rows if row.fused]),
        (SMOOTHED, [row.smoothed for row in run.rows if row.smoothed]),
    ):
        if estimates:
            values = np.array([(one.yaw, math.sqrt(max(one.yaw_variance, 0.0))) for one in estimates])
            tracks[name] = YawTrack(np.array([one.t_ns for one in estimates], np.int64), *values.T)
    return tracks


def gyro_alone(gyro: GyroTrack) -> YawTrack:
    """The gyro's rate integrated, bias and all."""
    return YawTrack(gyro.t_ns, _integral(gyro.t_ns, gyro.yaw_rate))


def tracks_alone(odometry: OdometryTrack) -> YawTrack:
    """The yaw the track odometry itself reports; its rate integrated where it reports none."""
    if np.isfinite(odometry.yaw).all() and np.ptp(odometry.yaw) > 0.0:
        return YawTrack(odometry.t_ns, unwrap(odometry.yaw))
    return YawTrack(odometry.t_ns, _integral(odometry.t_ns, odometry.yaw_rate))


def errors(track: YawTrack, truth: TruthTrack) -> YawTrack | None:
    """Error of a track at its times within the truth, zero at the first; None without two common times.

    Times at which the truth or the track is NaN are left out.
    """
    error = track.yaw - yaw_at(truth, track.t_ns)
    inside = (track.t_ns >= truth.t_ns[0]) & (track.t_ns <= truth.t_ns[-1]) & np.isfinite(error)
    if np.count_nonzero(inside) < 2:
        return None
    error = error[inside]
    sigma = None if track.sigma is None else track.sigma[inside]
    return YawTrack(track.t_ns[inside], error - error[0], sigma)


def score(track: YawTrack, truth: TruthTrack) -> Score | None:
    """Final, RMS and worst error of a track; None without two common times."""
    error = errors(track, truth)
    if error is None:
        return None
    with np.errstate(over="ignore"):  # of a gyro's nonsense, integrated
        return Score(float(error.yaw[-1]), float(np.sqrt(np.mean(error.yaw**2))), float(np.max(np.abs(error.yaw))))


def scores(run: FusedRun) -> Mapping[str, Score]:
    """Score of every source; empty without truth."""
    if run.truth is None:
        return {}
    found = {name: score(track, run.truth) for name, track in yaw_tracks(run).items()}
    return {name: one for name, one in found.items() if one}


def yaw_at(track: YawTrack | TruthTrack, t_ns: npt.NDArray[np.int64]) -> Floats:
    """Yaw at other times, linear between samples."""
    origin = track.t_ns[0]
    yaw: Floats = np.interp((t_ns - origin) * 1e-9, (track.t_ns - origin) * 1e-9, track.yaw)
    return yaw


def _integral(t_ns: Times, rate: Floats) -> Floats:
    """Trapezoids over the finite rates, from 0."""
    rate = np.where(np.isfinite(rate), rate, 0.0)
    steps = np.diff(t_ns) * 1e-9 * 0.5 * (rate[1:] + rate[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])
