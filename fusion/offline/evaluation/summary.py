"""One source on one drive over all seeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fusion.offline.evaluation.outcome import Outcome
from fusion.offline.scores import COMPASS, FUSED, GYRO, SMOOTHED, TRACKS


@dataclass(frozen=True, slots=True)
class Summary:
    """One source on one drive over all seeds; angles in deg.

    Attributes
    ----------
    final : float
        Error at the end: signed for a single seed, else root mean square over the seeds.
    rms, worst : float
        Root mean square and largest magnitude over all times and seeds.
    per_m, per_turn : float
        `final` over the way and over the turning; NaN where there is less than half a metre or half a turn.
    honesty, coverage : float
        Squared error over claimed variance, and share inside the claimed 95 %; NaN where nothing is claimed.
    given : float
        Share of images with an increment; NaN where it is no compass.
    """

    final: float
    rms: float
    worst: float
    per_m: float
    per_turn: float
    honesty: float
    coverage: float
    given: float


def summarise_outcomes(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Summary]]:
    """Summary by drive and source, in the order of the outcomes."""
    groups: dict[str, dict[str, list[Outcome]]] = {}
    for outcome in outcomes:
        groups.setdefault(outcome.drive, {}).setdefault(outcome.source, []).append(outcome)
    return {
        drive: {source: _summary(group) for source, group in sorted(sources.items(), key=_place)}
        for drive, sources in groups.items()
    }


def _place(item: tuple[str, list[Outcome]]) -> int:
    """Methods of the compass first, the fused yaw last."""
    return {COMPASS: 1, GYRO: 2, TRACKS: 3, FUSED: 4, SMOOTHED: 5}.get(item[0], 0)


def _summary(group: Sequence[Outcome]) -> Summary:
    finals = [outcome.score.final for outcome in group]
    final = math.degrees(finals[0] if len(finals) == 1 else _rms(finals))
    claims = [outcome.honesty for outcome in group if outcome.honesty]
    weights = [claim.count for claim in claims]
    distance, turns = group[0].distance, group[0].turns
    return Summary(
        final=final,
        rms=math.degrees(_rms(outcome.score.rms for outcome in group)),
        worst=math.degrees(max(outcome.score.worst for outcome in group)),
        per_m=final / distance if distance > 0.5 else math.nan,
        per_turn=final / turns if turns > 0.5 else math.nan,
        honesty=float(np.average([claim.ratio for claim in claims], weights=weights)) if claims else math.nan,
        coverage=float(np.average([claim.coverage for claim in claims], weights=weights)) if claims else math.nan,
        given=float(np.mean([outcome.given for outcome in group])),
    )


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))
