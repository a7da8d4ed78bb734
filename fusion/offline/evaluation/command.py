"""From the arguments of ``visual-compass evaluate`` to its text."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from compass.config import METHODS
from compass.errors import VisualCompassError
from compass.methods.registry import find_method
from fusion.offline.atomic_output import refuse_existing, staged_file
from fusion.offline.bag import BagError
from fusion.offline.evaluation.accuracy import HEADLINES, SECTION, accuracy_section, headline_section
from fusion.offline.evaluation.bags import evaluate_bag
from fusion.offline.evaluation.experiments import evaluate_experiments
from fusion.offline.evaluation.outcome import Outcome
from fusion.offline.evaluation.saved import as_json, join_saved, read_saved
from fusion.offline.evaluation.summary import summarise_outcomes
from fusion.offline.evaluation.tables import drift_table, full_table, short_table, world_table
from fusion.offline.evaluation.verdicts import verdict_lines
from fusion.offline.foreign_yaw import read_yaws
from fusion.offline.gps import Drift
from fusion.offline.markdown import write_section
from fusion.offline.summary import warning_lines
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS
from fusion.simulation.experiments import find_experiment
from fusion.simulation.worlds import HELD_OUT_WORLDS, TUNED_WORLDS, choose_world

ALL_WORLDS = "all"


def run_evaluation(
    what: Sequence[str],
    seeds: Sequence[int],
    settings: Settings,
    request: TopicRequest,
    metric: str = "all",
    json_file: Path | None = None,
    workers: int | None = None,
    smooth: bool = False,
    worlds: str = HELD_OUT_WORLDS,
    methods: Sequence[str] = METHODS,
    yaws: Sequence[Path] = (),
    markdown_file: Path | None = None,
    headline_file: Path | None = None,
    force: bool = False,
) -> str:
    """Evaluate experiments and bags; give the table and the verdicts.

    Parameters
    ----------
    what : sequence of str
        Names of experiments, bags with ground truth, and files that `json_file` wrote before, which are joined.
    seeds : sequence of int
        Of the experiments.
    methods : sequence of str
        Of the compass, by name or as ``"module:function"``.
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
        An experiment, a world or a method is unknown, or a bag or a file cannot be used.
    """
    if json_file is not None and os.path.exists(json_file) and not force:
        _read_earlier(json_file)
    refuse_existing(json_file, force=True, inputs=[*map(Path, what), *yaws])
    files = [Path(name) for name in what if name not in EXPERIMENTS and Path(name).exists()]
    earlier = [path for path in files if path.suffix == ".json"]
    saved = join_saved(earlier)
    bags = [path for path in files if path.suffix != ".json"]
    names = [find_experiment(name).name for name in what if Path(name) not in files]
    if not what:
        names = list(EXPERIMENTS)
    kinds = ((TUNED_WORLDS, HELD_OUT_WORLDS) if worlds == ALL_WORLDS else (worlds,)) if names else ()
    drives = product(names, seeds, kinds)
    planned = {(name, seed, choose_world(EXPERIMENTS[name], seed, kind).name) for name, seed, kind in drives}
    for one in saved.outcomes if saved else ():
        if (one.drive, one.seed, one.world) in planned:
            raise VisualCompassError(
                f"{one.drive} of seed {one.seed} is in a file already; go on with --first-seed {max(seeds) + 1}"
            )
    for name in methods:
        find_method(name)  # before hours have passed
    foreign = read_yaws(yaws)
    if foreign and len(bags) != 1:
        raise VisualCompassError(f"--yaw belongs to one bag, and {len(bags)} are given; name the one it was driven in")
    default = saved.default if saved else settings.compass.method
    outcomes: list[Outcome] = []
    parts: list[str] = []
    for kind in kinds:
        found = evaluate_experiments(names, seeds, settings, workers or os.cpu_count() or 1, smooth, kind, methods)
        parts += _tables(found, default, metric, f"{len(seeds)} seed{'s'[: len(seeds) > 1]}, {kind} worlds")
        outcomes += found
    drifts: dict[str, dict[str, Drift]] = {}
    warnings = {}
    if saved:
        parts += _tables(saved.outcomes, default, metric, ", ".join(map(str, earlier))) if saved.outcomes else []
        outcomes += saved.outcomes
        drifts |= saved.drifts
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


def _read_earlier(path: Path) -> None:
    """Refuse a file that no evaluation wrote."""
    try:
        read_saved(path)
    except VisualCompassError:
        refuse_existing(path)


def _tables(outcomes: Sequence[Outcome], default: str, metric: str, what: str) -> list[str]:
    """The table of the outcomes, and what it says of the aims."""
    summaries = summarise_outcomes(outcomes)
    shown = full_table(summaries, default) if metric == "all" else short_table(summaries, default, metric)
    return [f"errors in deg, {what}\n{shown}", "\n".join(verdict_lines(summaries, default))]
