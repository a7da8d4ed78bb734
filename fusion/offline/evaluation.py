"""From the arguments of ``visual-compass evaluate`` to its text."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from compass.errors import VisualCompassError
from compass.methods.registry import find_method
from fusion.offline.accuracy import HEADLINES, SECTION, accuracy_section, headline_section
from fusion.offline.atomic_output import refuse_existing, staged_file
from fusion.offline.bag import BagError
from fusion.offline.console import table
from fusion.offline.evaluate import Outcome, evaluate_bag, evaluate_experiments
from fusion.offline.evaluation_report import (
    SavedEvaluation,
    as_json,
    drift_table,
    from_json,
    full_table,
    short_table,
    summarise_outcomes,
    verdict_lines,
)
from fusion.offline.foreign_yaw import read_yaws
from fusion.offline.gps import Drift
from fusion.offline.markdown import write_section
from fusion.offline.summary import warning_lines
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS
from fusion.simulation.experiments import find_experiment
from fusion.simulation.worlds import HELD_OUT_WORLDS, TUNED_WORLDS

ALL_WORLDS = "all"


def run_evaluation(
    what: Sequence[str],
    seeds: int,
    settings: Settings,
    request: TopicRequest,
    metric: str = "all",
    json_file: Path | None = None,
    workers: int | None = None,
    smooth: bool = False,
    worlds: str = HELD_OUT_WORLDS,
    methods: Sequence[str] = (),
    yaws: Sequence[Path] = (),
    markdown_file: Path | None = None,
    headline_file: Path | None = None,
    force: bool = False,
) -> str:
    """Evaluate experiments and bags; give the table and the verdicts.

    Parameters
    ----------
    what : sequence of str
        Names of experiments, bags with ground truth, and files that `json_file` wrote before.
    methods : sequence of str
        Further methods of the compass, ``"module:function"``.
    yaws : sequence of Path
        TUM files of somebody else's yaw, scored beside ours on the bag.
    markdown_file : Path or None
        Whose accuracy section to write.
    headline_file : Path or None
        Whose section of six lines on the simulated drives to write.
    force : bool
        Whether `json_file` may replace a file that is no earlier evaluation.

    Raises
    ------
    VisualCompassError
        An experiment or a world is unknown, or a bag or a file cannot be used.
    """
    if json_file is not None and json_file.exists() and not force:
        _read_earlier(json_file)
    files = [Path(name) for name in what if name not in EXPERIMENTS and Path(name).exists()]
    saved = [_read_saved(path) for path in files if path.suffix == ".json"]
    bags = [path for path in files if path.suffix != ".json"]
    names = [find_experiment(name).name for name in what if Path(name) not in files]
    if not what:
        names = list(EXPERIMENTS)
    for name in methods:
        find_method(name)  # before hours have passed
    foreign = read_yaws(yaws)
    if foreign and len(bags) != 1:
        raise VisualCompassError(f"--yaw belongs to one bag, and {len(bags)} are given; name the one it was driven in")
    default = saved[0].default if saved else settings.compass.method
    outcomes: list[Outcome] = []
    parts: list[str] = []
    for kind in ((TUNED_WORLDS, HELD_OUT_WORLDS) if worlds == ALL_WORLDS else (worlds,)) if names else ():
        found = evaluate_experiments(names, seeds, settings, workers or os.cpu_count() or 1, smooth, kind, methods)
        parts += _tables(found, default, metric, f"{seeds} seed{'s' if seeds > 1 else ''}, {kind} worlds")
        outcomes += found
    drifts: dict[str, dict[str, Drift]] = {}
    warnings = {}
    for path, one in zip((path for path in files if path.suffix == ".json"), saved, strict=True):
        parts += _tables(one.outcomes, default, metric, str(path)) if one.outcomes else []
        outcomes += one.outcomes
        drifts |= one.drifts
    if any(one.world for one in outcomes):
        parts.append(world_table([one for one in outcomes if one.world]))
    for bag in bags:
        scored = evaluate_bag(bag, settings, request, smooth, methods, foreign)
        if not scored.outcomes and not scored.drifts:
            raise BagError(f"{bag}: nothing to score: no yaw has two times in common with the truth, or with GPS fixes")
        drifts[str(bag)], warnings[str(bag)] = scored.drifts, scored.warnings
        parts += _tables(scored.outcomes, default, metric, str(bag)) if scored.outcomes else []
        outcomes += scored.outcomes
    if json_file is not None:
        with staged_file(json_file) as staged:
            content = as_json(outcomes, summarise_outcomes(outcomes), drifts, default) | {"warnings": warnings}
            staged.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if markdown_file is not None:
        write_section(markdown_file, SECTION, accuracy_section(outcomes, drifts, default))
    if headline_file is not None:
        write_section(headline_file, HEADLINES, headline_section(outcomes))
    parts += [drift_table(bag, drift, default) for bag, drift in drifts.items() if drift]
    parts += [
        "\n".join((bag, *warning_lines(wrong, "the summary.json of fuse"))) for bag, wrong in warnings.items() if wrong
    ]
    return "\n\n".join(part for part in parts if part)


def _read_saved(path: Path) -> SavedEvaluation:
    try:
        return from_json(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:  # also what is no JSON, and no UTF-8
        raise VisualCompassError(f"{path}: {error}; give a file that evaluate --json wrote") from error


def _read_earlier(path: Path) -> None:
    """Refuse a file that no evaluation wrote."""
    try:
        _read_saved(path)
    except VisualCompassError:
        refuse_existing(path)


def _tables(outcomes: Sequence[Outcome], default: str, metric: str, what: str) -> list[str]:
    """The table of the outcomes, and what it says of the aims."""
    summaries = summarise_outcomes(outcomes)
    shown = full_table(summaries, default) if metric == "all" else short_table(summaries, default, metric)
    return [f"errors in deg, {what}\n{shown}", "\n".join(verdict_lines(summaries, default))]


def world_table(outcomes: Sequence[Outcome]) -> str:
    """RMS of every source by world, all drives in it taken together; the experiments' own places in one line."""
    own = "own place (tuned)"
    by_world = summarise_outcomes([replace(one, drive=one.world if one.held_out else own) for one in outcomes])
    sources = list(dict.fromkeys(source for found in by_world.values() for source in found))
    drives = {
        world: len({(one.drive, one.seed) for one in outcomes if (one.world if one.held_out else own) == world})
        for world in by_world
    }
    rows = [
        [world, str(drives[world]), *(f"{found[source].rms:.2f}" if source in found else "" for source in sources)]
        for world, found in sorted(by_world.items())
    ]
    return f"RMS in deg by world\n{table(('world', 'drives', *sources), rows)}"
