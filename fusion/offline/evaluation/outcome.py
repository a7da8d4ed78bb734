"""One source on one drive: its errors, and whether the variances that it claims are true."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compass import YawIncrement, wrap_angle
from fusion.offline.evaluation.tracks import Tracks
from fusion.offline.run import FusedRun
from fusion.offline.scores import FUSED, SMOOTHED, Score, YawTrack, errors, score, yaw_at
from fusion.offline.streams import Floats, TruthTrack


@dataclass(frozen=True, slots=True)
class Honesty:
    """Whether claimed variances are true: of increments for a compass, of the yaw for the filter.

    Attributes
    ----------
    ratio : float
        Mean of squared error over variance; 1 is honest.
    coverage : float
        Share of errors inside the claimed 95 % interval.
    count : int
        Number of claims.
    """

    ratio: float
    coverage: float
    count: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """One source on one drive.

    Attributes
    ----------
    drive : str
        Experiment or bag.
    seed : int
        Of the simulation; 0 for a bag.
    source : str
        Method of the compass, a sensor alone, or the fused yaw.
    score : Score
        Its errors, rad.
    distance, turns : float
        Way driven, m, and turning done, full turns; NaN where unknown.
    honesty : Honesty or None
        None where nothing is claimed.
    given : float
        Share of images with an increment; NaN where it is no compass.
    world : str
        Of the simulation: which of the experiment's own, or the held-out place.
    held_out : bool
        Whether no constant may be chosen on that world.
    """

    drive: str
    seed: int
    source: str
    score: Score
    distance: float
    turns: float
    honesty: Honesty | None = None
    given: float = math.nan
    world: str = ""
    held_out: bool = False


def score_tracks(drive: str, seed: int, tracks: Tracks, truth: TruthTrack, frames: int) -> list[Outcome]:
    """Score every source against the truth; `frames` is the number of images."""
    distance, turns = _way(tracks.run, truth)
    outcomes = []
    for name, track in tracks.yaws.items():
        found = score(track, truth)
        if found is None:
            continue
        increments = tracks.increments.get(name, [])
        claimed = name in (FUSED, SMOOTHED)
        honesty = fused_honesty(track, truth) if claimed else increment_honesty(increments, truth)
        given = len(increments) / max(frames - 1, 1) if name in tracks.increments else math.nan
        outcomes.append(Outcome(drive, seed, name, found, distance, turns, honesty, given))
    return outcomes


def _way(run: FusedRun, truth: TruthTrack) -> tuple[float, float]:
    """Way and turning: metres by the tracks' speed, full turns by the truth, seen once a second against its noise."""
    seconds = np.arange(truth.t_ns[0], truth.t_ns[-1] + 1, 1_000_000_000)
    turns = float(np.abs(np.diff(yaw_at(truth, seconds))).sum() / math.tau)
    if not run.odometry.t_ns.size:
        return math.nan, turns
    dt = np.diff(run.odometry.t_ns) * 1e-9
    return float(np.sum(dt * np.abs(run.odometry.speed[1:]))), turns


def increment_honesty(increments: Sequence[YawIncrement], truth: TruthTrack) -> Honesty | None:
    """Whether increments err as much as their variances say; None without increments."""
    if not increments:
        return None
    ends = yaw_at(truth, np.array([increment.t_ns for increment in increments], np.int64))
    starts = yaw_at(truth, np.array([increment.t_ref_ns for increment in increments], np.int64))
    error = wrap_angle(np.array([increment.yaw for increment in increments]) - (ends - starts))
    return _honesty(error, np.array([increment.variance for increment in increments]))


def fused_honesty(track: YawTrack, truth: TruthTrack) -> Honesty | None:
    """Whether a yaw errs as much as its sigma says, relative to its start."""
    error = errors(track, truth)
    if error is None or error.sigma is None:
        return None
    return _honesty(error.yaw[1:], error.sigma[1:] ** 2)


def _honesty(error: Floats, variance: Floats) -> Honesty:
    squared = error**2 / variance
    return Honesty(float(squared.mean()), float(np.mean(squared < 1.96**2)), int(squared.size))
