"""A user's bag, scored against its truth and its GPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compass.config import METHODS
from fusion.offline.bag import Bag, BagError
from fusion.offline.console import progress_bar
from fusion.offline.evaluation.outcome import Outcome, score_tracks
from fusion.offline.evaluation.tracks import all_tracks
from fusion.offline.gps import Drift, drift, read_course
from fusion.offline.recording import read_recording
from fusion.offline.scores import YawTrack, score
from fusion.offline.summary import warning_facts
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import Settings


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
    methods: Sequence[str] = METHODS,
    yaws: Mapping[str, YawTrack] | None = None,
) -> BagOutcome:
    """All `methods` on a user's bag, which needs truth or GPS, and `yaws` of the user's own.

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
