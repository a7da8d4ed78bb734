"""Simulated drives, each scored in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import cv2

from compass.config import METHODS
from compass.methods.registry import MethodEntry, adopt_methods, own_methods
from fusion.offline.console import progress_bar
from fusion.offline.evaluation.outcome import Outcome, score_tracks
from fusion.offline.evaluation.tracks import all_tracks
from fusion.offline.simulated import SimulatedRecording
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS, simulate
from fusion.simulation.worlds import HELD_OUT_WORLDS, choose_world


def evaluate_experiments(
    names: Sequence[str],
    seeds: Sequence[int],
    settings: Settings,
    workers: int,
    smooth: bool,
    worlds: str = HELD_OUT_WORLDS,
    methods: Sequence[str] = METHODS,
) -> list[Outcome]:
    """The named experiments, each with all of `seeds`; the same seed gives the same outcomes, whatever else is run.

    Parameters
    ----------
    worlds : str
        See `choose_world`.
    methods : sequence of str
        Of the compass; those that were registered are scored as well.
    """
    _render(names, seeds, worlds)
    tasks = [(name, seed, worlds, settings, smooth, methods) for name in names for seed in seeds]
    outcomes: list[Outcome] = []
    with progress_bar("evaluating") as progress:
        for count, found in enumerate(_map(tasks, workers), start=1):
            outcomes += found
            progress(count / len(tasks))
    return outcomes


# experiment, seed, worlds, settings, whether to smooth, methods
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
    recording = SimulatedRecording(simulate(name, seed, worlds=worlds, keep=False), settings.imu)
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


def _render(names: Sequence[str], seeds: Sequence[int], worlds: str) -> None:
    """Bring the frames of worlds that several seeds share into the cache; others are rendered as they are used."""
    sharing: dict[tuple[str, bytes], list[int]] = {}
    for name in names:
        for seed in seeds:
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
