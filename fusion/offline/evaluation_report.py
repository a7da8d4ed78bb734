"""Outcomes of an evaluation in one table, in a few sentences, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fusion.offline.console import table
from fusion.offline.evaluate import PAPER, Honesty, Outcome
from fusion.offline.gps import Drift
from fusion.offline.scores import COMPASS, FUSED, GYRO, SMOOTHED, TRACKS, Score
from fusion.simulation import EXPERIMENTS

NEGLIGIBLE = 0.01  # deg RMS; of single sensors better than this nobody needs to be told that fusion is no better


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


def full_table(summaries: dict[str, dict[str, Summary]], default: str) -> str:
    """All metrics: a line per drive and source, the paper's published figure in front."""
    header = ("drive", "source", "final", "RMS", "worst", "deg/m", "deg/turn", "err^2/var", "in 95 %", "given")
    rows = []
    for drive, sources in summaries.items():
        published = EXPERIMENTS[drive].published_deg if drive in EXPERIMENTS else None
        if published is not None:
            rows.append([drive, "paper, published", f"{published:.2f}", *[""] * 7])
        for source, one in sources.items():
            rows.append([drive, _label(source, default), *_cells(one)])
    previous = ""
    for row in rows:
        previous, row[0] = row[0], "" if row[0] == previous else row[0]
    return table(header, rows, 2)


def _cells(one: Summary) -> list[str]:
    numbers = [_number(value, 2) for value in (one.final, one.rms, one.worst)]
    numbers += [_number(value, 3) for value in (one.per_m, one.per_turn)]
    return [*numbers, _number(one.honesty, 2), *(_number(100.0 * value, 0) for value in (one.coverage, one.given))]


def short_table(summaries: dict[str, dict[str, Summary]], default: str, metric: str) -> str:
    """One metric: a line per drive, a column per source."""
    sources = list(dict.fromkeys(source for found in summaries.values() for source in found))
    header = ["drive", "published", *(_label(source, default) for source in sources)]
    rows = []
    for drive, found in summaries.items():
        published = EXPERIMENTS[drive].published_deg if drive in EXPERIMENTS else None
        figure = "" if published is None or metric != "final" else f"{published:.2f}"
        digits = 3 if metric.startswith("per_") else 2
        values = [_number(getattr(found[source], metric), digits) if source in found else "" for source in sources]
        rows.append([drive, figure, *values])
    return table(header, rows)


def _label(source: str, default: str) -> str:
    """Methods by name, with what they are to the reader."""
    roles = [role for role, name in (("paper's", PAPER), ("default", default)) if name == source]
    return f"{source} ({', '.join(roles)})" if roles else source


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""


def verdict_lines(summaries: dict[str, dict[str, Summary]], default: str) -> list[str]:
    """What the table says of the aims: default against the paper's method, fused against the best single sensor."""
    return [
        line
        for line in (
            _paper_line(summaries, default),
            _fused_line(summaries, default),
            _honesty_line(summaries, default),
            _honesty_line(summaries, FUSED),
        )
        if line
    ]


def _paper_line(summaries: dict[str, dict[str, Summary]], default: str) -> str:
    ratios = {
        drive: abs(found[default].final / found[PAPER].final)
        for drive, found in summaries.items()
        if PAPER in found and default in found and abs(found[PAPER].final) > 2.0
    }
    if not ratios:
        return ""
    worst = max(ratios, key=ratios.__getitem__)
    return (
        f"final error of {default} over the paper's method, where that errs by more than 2 deg ({len(ratios)} drives):"
        f" {_median(ratios):.3f} in the median, {ratios[worst]:.3f} at worst in {worst}"
    )


def _fused_line(summaries: dict[str, dict[str, Summary]], default: str) -> str:
    published, informed = _over_best_single(summaries, COMPASS), _over_best_single(summaries, default)
    ratios = published or informed
    if not ratios:
        return ""
    line = (
        f"RMS of fused over the best single sensor (where that errs by more than {NEGLIGIBLE:g} deg):"
        f" {_below_one(ratios)}"
    )
    mixed = {drive: ratio for drive, ratio in ratios.items() if drive in EXPERIMENTS and EXPERIMENTS[drive].mixed}
    if mixed:
        worst = max(mixed, key=mixed.__getitem__)
        line += f"; mixed drives {_median(mixed):.2f} in the median, {mixed[worst]:.2f} at worst in {worst}"
    if published and informed:
        line += f"; with the compass informed when its images were exposed, and fused not: {_below_one(informed)}"
    return line


def _over_best_single(summaries: dict[str, dict[str, Summary]], compass: str) -> dict[str, float]:
    """RMS of fused over that of the best of `compass`, gyro and tracks, by drive."""
    ratios = {}
    for drive, found in summaries.items():
        singles = [found[source].rms for source in (compass, GYRO, TRACKS) if source in found]
        if singles and FUSED in found and min(singles) > NEGLIGIBLE:
            ratios[drive] = found[FUSED].rms / min(singles)
    return ratios


def _below_one(ratios: dict[str, float]) -> str:
    worst = max(ratios, key=ratios.__getitem__)
    better = sum(ratio < 1.0 for ratio in ratios.values())
    return f"below 1 in {better} of {len(ratios)}, {ratios[worst]:.2f} at worst in {worst}"


def _honesty_line(summaries: dict[str, dict[str, Summary]], source: str) -> str:
    ratios = {drive: found[source].honesty for drive, found in summaries.items() if source in found}
    ratios = {drive: ratio for drive, ratio in ratios.items() if math.isfinite(ratio)}
    if not ratios:
        return ""
    low, high = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    return (
        f"squared error over variance of {source}: {np.mean(list(ratios.values())):.2f} on average,"
        f" from {ratios[low]:.2f} in {low} to {ratios[high]:.2f} in {high}"
    )


def _median(values: dict[str, float]) -> float:
    return float(np.median(list(values.values())))


def drift_table(bag: str, drifts: Mapping[str, Drift], default: str) -> str:
    """Drift of every source against the GPS course."""
    shown = table(("source", "deg/min", "95 %"), drift_rows(drifts, default))
    return f"{bag}: drift against the GPS course\n{shown}"


def drift_rows(drifts: Mapping[str, Drift], default: str) -> list[list[str]]:
    """Source, drift in deg/min and its 95 % interval."""
    per_minute = 60.0 * math.degrees(1.0)
    return [
        [
            _label(name, default),
            f"{per_minute * one.slope:+.2f}",
            f"{per_minute * one.low:+.2f} .. {per_minute * one.high:+.2f}",
        ]
        for name, one in drifts.items()
    ]


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
