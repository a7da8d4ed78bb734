"""The accuracy section of docs/benchmarks.md: outcomes of an evaluation as Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from compass.errors import VisualCompassError
from fusion.offline.evaluation.outcome import Outcome
from fusion.offline.evaluation.summary import Summary, summarise_outcomes
from fusion.offline.evaluation.tables import drift_rows
from fusion.offline.evaluation.tracks import PAPER
from fusion.offline.evaluation.verdicts import verdict_lines
from fusion.offline.gps import Drift
from fusion.offline.markdown import markdown_table
from fusion.offline.scores import COMPASS, FUSED, GYRO, SMOOTHED, TRACKS
from fusion.simulation import EXPERIMENTS
from fusion.simulation.experiment import Experiment

SECTION, HEADLINES = "accuracy", "results"
KINDS = "turns on the spot", "straight ahead", "the paper's free drives", "other drives"
OWN_PLACE = "own place"  # of an experiment

Summaries = dict[str, dict[str, Summary]]

_COLUMNS = {
    "published": "what the paper reports of the real robot in the experiment of that name, magnitude",
    PAPER: "the paper's method: shift of each row to whole columns",
    "sectors": "the paper's future work: median of the shifts of 32 sectors",
    "corners": "tracked corners whose parallax has one sign",
    COMPASS: "the compass as it is published, by the stamps of its images; the methods are informed of the exposures",
    GYRO: "the rate of the gyro integrated, bias included",
    TRACKS: "the yaw of the track odometry",
    FUSED: "the extended Kalman filter, causal: each yaw from what came before it",
    SMOOTHED: "the fixed-interval (RTS) smoother over the same filter",
}


def accuracy_section(outcomes: Sequence[Outcome], drifts: Mapping[str, Mapping[str, Drift]], default: str) -> str:
    """All tables of an evaluation."""
    sources = _sources(summarise_outcomes([replace(one, drive="") for one in outcomes]))
    parts = [
        "## Accuracy",
        "Errors are those of the yaw against the truth, both zero at the first common time. Several seeds of a drive"
        " count together: root mean square of their errors at the end, root mean square and largest magnitude of all"
        " their errors. The last line of a table is the median over its drives.",
        markdown_table(
            ("column", "what it is"),
            [
                (f"`{name}`", _COLUMNS.get(name, "a method or a yaw of the user's own"))
                for name in ("published", *sources)
            ],
            left=2,
        ),
    ]
    simulated = [one for one in outcomes if one.world]
    for held_out in (True, False):
        parts += _drives([one for one in simulated if one.held_out is held_out], default)
    for drive in dict.fromkeys(one.drive for one in outcomes if not one.world):
        parts += _bag(drive, [one for one in outcomes if one.drive == drive and not one.world], default)
    for bag, found in drifts.items():
        if found:
            heading = f"### {Path(bag).name}: drift against the GPS course"
            parts += [heading, markdown_table(("source", "deg/min", "95 %"), drift_rows(found, default))]
    return "\n\n".join(parts)


def headline_section(outcomes: Sequence[Outcome]) -> str:
    """Six lines on simulated drives: the median over those of each kind, and the median and the worst of all.

    Raises
    ------
    VisualCompassError
        There are no simulated drives.
    """
    outcomes = [one for one in outcomes if one.drive in EXPERIMENTS and not EXPERIMENTS[one.drive].rolled]
    if not outcomes:
        raise VisualCompassError("--headline sums up simulated drives, and there are none; name experiments")
    held_out = any(one.held_out for one in outcomes)
    outcomes = [one for one in outcomes if one.held_out is held_out]
    summaries, seeds = summarise_outcomes(outcomes), len({one.seed for one in outcomes})
    kinds: dict[str, list[str]] = {kind: [] for kind in KINDS}
    for drive in summaries:
        kinds[_kind(EXPERIMENTS[drive])].append(drive)
    rows = [(f"{kind}, median of {len(drives)}", drives, 50.0) for kind, drives in kinds.items() if drives]
    rows += [(f"all {len(summaries)}, median", list(summaries), 50.0), ("all, the worst", list(summaries), 100.0)]
    columns = {"paper's method": PAPER, "raw compass": COMPASS, "gyro": GYRO, "tracks": TRACKS, "fused": FUSED}
    cells = []
    for text, drives, percentile in rows:
        columns_of = [[abs(value) for drive in drives if (value := _published(drive)) is not None]]
        for source in columns.values():
            columns_of.append([abs(summaries[drive][source].final) for drive in drives if source in summaries[drive]])
        cells.append((text, *(_deg(float(np.percentile(each, percentile))) if each else "" for each in columns_of)))
    where = "worlds in which no constant was chosen" if held_out else "the experiments' own worlds"
    return f"""Error of the yaw at the end of simulated drives, deg; {seeds} seed{"s"[: seeds > 1]} each, in {where}.
`published` is what the paper reports of the real robot.

{markdown_table(("drives", "published", *columns), cells)}"""


def _kind(experiment: Experiment) -> str:
    if experiment.mixed:
        return KINDS[2] if experiment.published_deg is not None else KINDS[3]
    return KINDS[1] if experiment.turns < 0.5 else KINDS[0]


def _drives(outcomes: Sequence[Outcome], default: str) -> list[str]:
    """The tables of simulated drives in one kind of worlds."""
    if not outcomes:
        return []
    held_out, seeds = outcomes[0].held_out, sorted({one.seed for one in outcomes})
    summaries = summarise_outcomes(outcomes)
    drives = len({(one.drive, one.seed) for one in outcomes})
    which = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
    if held_out:
        heading, worlds = "### Held-out worlds", "No constant of the estimator was chosen in these worlds."
    else:
        heading, worlds = "### The experiments' own worlds", "Constants of the estimator were chosen in these worlds."
    return [
        heading,
        f"{len(summaries)} experiments, {which}, {drives} drives. {worlds}",
        "\n".join(f"- {_sentence(line)}" for line in verdict_lines(summaries, default)),
        "#### Error at the end, deg",
        _metric_table(summaries, "final"),
        "#### Root mean square error, deg",
        _metric_table(summaries, "rms"),
        "#### Largest error, deg",
        _metric_table(summaries, "worst"),
        "#### Are the variances true?",
        "Mean of squared error over variance (normalised error squared, 1 when the variance is true), and the share of"
        f" errors inside the claimed 95 % interval: of the increments of `{default}` and of the yaw for the filter."
        f" `answered`: share of images with an increment of `{default}`.",
        _variance_table(summaries, default),
        "#### Root mean square error by world, deg",
        _world_table(outcomes),
    ]


def _bag(bag: str, outcomes: Sequence[Outcome], default: str) -> list[str]:
    summaries = summarise_outcomes(outcomes)
    rows = [
        (f"`{source}`", *(_deg(value) for value in (one.final, one.rms, one.worst)), _plain(one.honesty))
        for source, one in summaries[bag].items()
    ]
    header = ("source", "at the end, deg", "RMS, deg", "largest, deg", "error^2 / variance")
    return [f"### {Path(bag).name}", markdown_table(header, rows)]


def _metric_table(summaries: Summaries, metric: str) -> str:
    """One metric: a line per drive, a column per source, and the medians over the drives."""
    sources = _sources(summaries)
    published = metric == "final" and any(_published(drive) is not None for drive in summaries)
    rows = []
    for drive, found in summaries.items():
        figure = _published(drive)
        paper = [] if not published else ["" if figure is None else _deg(abs(figure))]
        values = [_deg(abs(getattr(found[s], metric))) if s in found else "" for s in sources]
        rows.append((f"`{drive}`", *paper, *values))
    if len(summaries) > 1:
        medians = [
            _deg(float(np.median([abs(getattr(one[s], metric)) for one in summaries.values() if s in one])))
            for s in sources
        ]
        rows.append(("median", *([""] if published else []), *medians))
    return markdown_table(("drive", *(["published"] if published else []), *sources), rows)


def _variance_table(summaries: Summaries, default: str) -> str:
    claims = [s for s in (default, FUSED, SMOOTHED) if s in _sources(summaries)]
    header = ["drive", "answered, %", *(cell for s in claims for cell in (s, "in 95 %"))]
    rows = []
    for drive, found in summaries.items():
        answered = found[default].given if default in found else math.nan
        cells = [_plain(100.0 * answered, 1)]
        for source in claims:
            one = found.get(source)
            cells += ["", ""] if one is None else [_plain(one.honesty), _plain(100.0 * one.coverage, 1)]
        rows.append((f"`{drive}`", *cells))
    return markdown_table(header, rows)


def _world_table(outcomes: Sequence[Outcome]) -> str:
    """RMS of every source by world, all drives in it taken together."""
    named = [replace(one, drive=one.world if one.held_out else OWN_PLACE) for one in outcomes]
    by_world = summarise_outcomes(named)
    drives = {
        world: len({(one.drive, one.seed) for one, name in zip(outcomes, named, strict=True) if name.drive == world})
        for world in by_world
    }
    sources = _sources(by_world)
    rows = [
        (f"`{world}`", str(drives[world]), *(_deg(found[s].rms) if s in found else "" for s in sources))
        for world, found in sorted(by_world.items())
    ]
    return markdown_table(("world", "drives", *sources), rows)


def _sources(summaries: Summaries) -> list[str]:
    return list(dict.fromkeys(source for found in summaries.values() for source in found))


def _published(drive: str) -> float | None:
    return EXPERIMENTS[drive].published_deg if drive in EXPERIMENTS else None


def _sentence(line: str) -> str:
    return f"{line[0].upper()}{line[1:]}."


def _deg(value: float) -> str:
    """An angle to about two digits that count: 0.021, 9.33, 126."""
    return _plain(value, 3 if value < 1.0 else 2 if value < 100.0 else 0)


def _plain(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
