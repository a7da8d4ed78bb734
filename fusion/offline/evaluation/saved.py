"""An evaluation as JSON, and read again."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from compass.errors import VisualCompassError
from fusion.offline.evaluation.outcome import Honesty, Outcome
from fusion.offline.evaluation.summary import Summary
from fusion.offline.gps import Drift
from fusion.offline.scores import Score
from fusion.simulation import EXPERIMENTS


def as_json(
    outcomes: Sequence[Outcome],
    summaries: dict[str, dict[str, Summary]],
    drifts: Mapping[str, Mapping[str, Drift]],
    default: str,
) -> dict[str, Any]:
    """Every outcome (rad), every summary (deg) and every drift against GPS (rad/s), ready for JSON."""
    return {
        "default_method": default,
        "published_deg": {drive: EXPERIMENTS[drive].published_deg for drive in summaries if drive in EXPERIMENTS},
        "summaries_deg": _finite(
            {drive: {s: asdict(one) for s, one in found.items()} for drive, found in summaries.items()}
        ),
        "drifts_rad_s": {bag: {name: asdict(one) for name, one in found.items()} for bag, found in drifts.items()},
        "outcomes_rad": _finite([asdict(outcome) for outcome in outcomes]),
    }


def _finite(value: Any) -> Any:
    """NaN is not JSON: None instead."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True, slots=True)
class SavedEvaluation:
    """What a file of `as_json` holds."""

    outcomes: list[Outcome]
    drifts: dict[str, dict[str, Drift]]
    default: str


def from_json(content: Any) -> SavedEvaluation:
    """What `as_json` was given.

    Raises
    ------
    ValueError
        The content is not what `as_json` gives.
    """
    try:
        outcomes = [_outcome(one) for one in content["outcomes_rad"]]
        drifts = {b: {name: Drift(**one) for name, one in f.items()} for b, f in content["drifts_rad_s"].items()}
        return SavedEvaluation(outcomes, drifts, str(content["default_method"]))
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"no outcomes of an evaluation: {error!r}") from error


def _outcome(fields: Mapping[str, Any]) -> Outcome:
    """An outcome from its fields; what is null was NaN."""
    numbers = {name: math.nan if fields[name] is None else fields[name] for name in ("distance", "turns", "given")}
    honesty = fields["honesty"] and Honesty(**fields["honesty"])
    return Outcome(**{**fields, **numbers, "score": Score(**fields["score"]), "honesty": honesty})


def read_saved(path: Path) -> SavedEvaluation:
    """The evaluation in a file; `VisualCompassError` where it is none."""
    try:
        return from_json(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:  # also what is no JSON, and no UTF-8
        raise VisualCompassError(f"{path}: {error}; give a file that evaluate --json wrote") from error


def join_saved(paths: Sequence[Path]) -> SavedEvaluation | None:
    """Evaluations of different seeds or bags as one; None of no files.

    Raises
    ------
    VisualCompassError
        A file is no evaluation, or two do not belong together: other methods, or the same drive in both.
    """
    found = [read_saved(path) for path in paths]
    if not found:
        return None
    of_drive: dict[tuple[str, int, str], Path] = {}
    for path, one in zip(paths, found, strict=True):
        if one.default != found[0].default:
            raise VisualCompassError(
                f"{path}: its default method is {one.default}, that of {paths[0]} {found[0].default}; join runs of one"
            )
        for drive, seed, world in {(o.drive, o.seed, o.world) for o in one.outcomes}:
            if (drive, seed, world) in of_drive:
                raise VisualCompassError(
                    f"{path}: {drive} of seed {seed} is in {of_drive[drive, seed, world]}, too; give each drive once"
                )
            of_drive[drive, seed, world] = path
    simulated = [({o.source for o in one.outcomes if o.world}, path) for path, one in zip(paths, found, strict=True)]
    simulated = [(sources, path) for sources, path in simulated if sources]
    for sources, path in simulated[1:]:
        if sources != simulated[0][0]:
            odd = ", ".join(sorted(sources ^ simulated[0][0]))
            raise VisualCompassError(
                f"{path}: {odd} only in one of it and {simulated[0][1]}; join runs of the same sources"
            )
    outcomes = [outcome for one in found for outcome in one.outcomes]
    return SavedEvaluation(outcomes, {b: d for one in found for b, d in one.drifts.items()}, found[0].default)
