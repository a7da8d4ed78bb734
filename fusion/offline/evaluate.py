"""``visual-compass evaluate``: every method on every experiment, or on a bag that holds the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from compass import VisualCompass, YawIncrement, wrap_angle
from compass.config import METHODS
from compass.methods.registry import MethodEntry, adopt_methods, find_method, own_methods
from compass.tilt import Vector
from fusion import Warning
from fusion.offline.bag import Bag, BagError
from fusion.offline.console import progress_bar
from fusion.offline.gps import Drift, drift, read_course
from fusion.offline.recording import read_recording
from fusion.offline.run import FusedRun, fuse_recording, smooth_run
from fusion.offline.scores import COMPASS, FUSED, SMOOTHED, Score, YawTrack, errors, score, yaw_at, yaw_tracks
from fusion.offline.simulated import SimulatedRecording
from fusion.offline.streams import Floats, Frame, Progress, Recording, TruthTrack
from fusion.offline.summary import warning_facts
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS, simulate
from fusion.simulation.worlds import HELD_OUT_WORLDS, choose_world

PAPER = "rows"  # the paper's method, which has the camera alone


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


class _Watched:
    """A recording whose frames are shown to further compasses on their way: every method sees the same frames."""

    def __init__(self, recording: Recording, compasses: Mapping[str, VisualCompass]) -> None:
        self._recording = recording
        self._compasses = compasses
        self.gyro, self.odometry, self.truth = recording.gyro, recording.odometry, recording.truth
        self.yaws: dict[str, list[tuple[int, float]]] = {name: [] for name in compasses}
        self.increments: dict[str, list[YawIncrement]] = {name: [] for name in compasses}
        self.frame_count = recording.frame_count

    @property
    def warnings(self) -> Iterable[Warning]:
        return self._recording.warnings

    def frames(self) -> Iterator[Frame]:
        for frame in self._recording.frames():
            for name, compass in self._compasses.items():
                increment = compass.update(frame.t_ns, frame.image, frame.encoding)
                if increment is not None:
                    self.increments[name].append(increment)
                if increment is not None or not self.yaws[name]:
                    self.yaws[name].append((frame.t_ns, compass.yaw))
            yield frame


@dataclass(frozen=True, slots=True)
class Tracks:
    """The yaw of every source on one recording, the run they come from and the increments of each method."""

    run: FusedRun
    yaws: Mapping[str, YawTrack]
    increments: Mapping[str, list[YawIncrement]]


def all_tracks(
    recording: Recording,
    settings: Settings,
    progress: Progress = lambda part: None,
    *,
    smooth: bool = False,
    exposed_ns: Mapping[int, int] | None = None,
    methods: Sequence[str] = (),
) -> Tracks:
    """Run every method of the compass and the filter, each frame shown to all of them; and `methods`, of the user.

    Where it is known when images were exposed, by their stamps, the methods are told: nobody but them is to blame for
    their errors. The raw compass, as the configured method is published, goes by the stamps all the same, as does the
    fused yaw, which has to find out.
    """
    when = exposed_ns or {}

    def up_exposed(t_ns: int) -> Vector | None:
        return recording.gyro.up_at(when.get(t_ns, t_ns))

    names = dict.fromkeys((*METHODS, settings.compass.method, *own_methods(), *(find_method(m)[0] for m in methods)))
    configs = {name: replace(settings.compass, method=name) for name in names}
    compasses = {name: VisualCompass(c, None if name == PAPER else up_exposed) for name, c in configs.items()}
    watched = _Watched(recording, compasses)
    run = fuse_recording(watched, settings, progress)
    if smooth:
        smooth_run(run, settings)
    yaws = dict(yaw_tracks(run))
    if exposed_ns is None:
        yaws.pop(COMPASS, None)  # the same as the configured method's
    for name, seen in watched.yaws.items():
        if len(seen) > 1:
            t_ns = np.array([when.get(t, t) for t, _ in seen], np.int64)
            yaws[name] = YawTrack(t_ns, np.array([yaw for _, yaw in seen]))
    increments = {
        name: [replace(i, t_ref_ns=when.get(i.t_ref_ns, i.t_ref_ns), t_ns=when.get(i.t_ns, i.t_ns)) for i in found]
        for name, found in watched.increments.items()
    }
    return Tracks(run, yaws, increments)


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


# ---------------------------------------------------------------- what to evaluate


def evaluate_experiments(
    names: Sequence[str],
    seeds: int,
    settings: Settings,
    workers: int,
    smooth: bool,
    worlds: str = HELD_OUT_WORLDS,
    methods: Sequence[str] = (),
) -> list[Outcome]:
    """All methods on the named experiments, each with `seeds` seeds; the same seeds give the same outcomes.

    Parameters
    ----------
    worlds : str
        See `choose_world`.
    methods : sequence of str
        Beside the compass's own and those that were registered.
    """
    _render(names, seeds, worlds)
    tasks = [(name, seed, worlds, settings, smooth, methods) for name in names for seed in range(seeds)]
    outcomes: list[Outcome] = []
    with progress_bar("evaluating") as progress:
        for count, found in enumerate(_map(tasks, workers), start=1):
            outcomes += found
            progress(count / len(tasks))
    return outcomes


# experiment, seed, worlds, settings, whether to smooth, further methods
Task = tuple[str, int, str, Settings, bool, Sequence[str]]


def _map(tasks: Sequence[Task], workers: int) -> Iterator[list[Outcome]]:
    if workers == 1:
        yield from map(_evaluate_experiment, tasks)
        return
    # Fresh processes: a fork would copy the locks of threads that it does not copy.
    with ProcessPoolExecutor(workers, get_context("spawn"), _start_worker, (own_methods(),)) as pool:
        try:
            yield from pool.map(_evaluate_experiment, tasks)
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker(methods: dict[str, MethodEntry]) -> None:
    """In a new process: what the first one has told OpenCV and the compass."""
    cv2.setNumThreads(1)
    adopt_methods(methods)


def _evaluate_experiment(task: Task) -> list[Outcome]:
    name, seed, worlds, settings, smooth, methods = task
    recording = SimulatedRecording(simulate(name, seed, worlds=worlds), settings.imu)
    experiment = EXPERIMENTS[name]
    world = choose_world(experiment, seed, worlds)
    tracks = all_tracks(recording, settings, smooth=smooth, exposed_ns=recording.exposed_ns, methods=methods)
    outcomes = score_tracks(name, seed, tracks, recording.truth, recording.frame_count)
    return [
        replace(
            outcome,
            distance=experiment.distance,
            turns=experiment.turns,
            world=world.name,
            held_out=world.held_out,
        )
        for outcome in outcomes
    ]


def _render(names: Sequence[str], seeds: int, worlds: str) -> None:
    """Bring the frames of worlds that several seeds share into the cache; others are rendered where they are used."""
    sharing: dict[tuple[str, bytes], list[int]] = {}
    for name in names:
        for seed in range(seeds):
            sharing.setdefault((name, choose_world(EXPERIMENTS[name], seed, worlds).key), []).append(seed)
    shared = [(name, several[0]) for (name, _), several in sharing.items() if len(several) > 1]
    if not shared:
        return
    with progress_bar("rendering") as progress:
        for count, (name, seed) in enumerate(shared):
            drive = simulate(name, seed, worlds=worlds)

            def told(done: int, of: int, before: int = count) -> None:
                progress((before + done / of) / len(shared))

            drive.prepare(told)


@dataclass(frozen=True, slots=True)
class BagOutcome:
    """How all sources did on a bag: against its truth, against its GPS, and what was wrong with it."""

    outcomes: list[Outcome]
    drifts: dict[str, Drift]
    warnings: list[dict[str, Any]]


def evaluate_bag(
    path: Path,
    settings: Settings,
    request: TopicRequest,
    smooth: bool,
    methods: Sequence[str] = (),
    yaws: Mapping[str, YawTrack] | None = None,
) -> BagOutcome:
    """All methods on a user's bag, which needs truth or GPS, and `methods` and `yaws` of the user's own.

    Raises
    ------
    BagError
        The bag has neither.
    """
    with Bag(path) as bag:
        choice = choose_topics(bag, settings.topics, request)
        with progress_bar("reading samples") as progress:
            recording = read_recording(bag, choice, settings.imu, settings.compass.decoded_columns, progress)
        course = read_course(bag, recording.odometry)
        if recording.truth is None and course is None:
            raise BagError(f"{path}: no ground truth and no GPS; name the truth's topic with --truth-topic")
        with progress_bar(f"evaluating {path.name}") as progress:
            tracks = all_tracks(recording, settings, progress, smooth=smooth, methods=methods)
    for name, track in (yaws or {}).items():
        if recording.truth is not None and score(track, recording.truth) is None:
            raise BagError(f"{name}: no two times in common with the truth of {path}; give seconds of the same clock")
    tracks = replace(tracks, yaws={**tracks.yaws, **(yaws or {})})
    outcomes, drifts = [], {}
    if recording.truth is not None:
        outcomes = score_tracks(str(path), 0, tracks, recording.truth, recording.frame_count)
    if course is not None:
        found = {name: drift(track, course) for name, track in tracks.yaws.items()}
        drifts = {name: one for name, one in found.items() if one}
    return BagOutcome(outcomes, drifts, warning_facts(tracks.run))
