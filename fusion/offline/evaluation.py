"""From the arguments of ``visual-compass evaluate`` to its text."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from compass.errors import VisualCompassError
from compass.methods import find_method
from fusion.offline.bag import BagError
from fusion.offline.console import table
from fusion.offline.evaluate import Outcome, evaluate_bag, evaluate_experiments
from fusion.offline.foreign import read_yaws
from fusion.offline.staging import staged_file
from fusion.offline.summary import warning_lines
from fusion.offline.topics import TopicRequest
from fusion.offline.verdicts import as_json, drift_table, full_table, short_table, summarise_outcomes, verdict_lines
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
) -> str:
    """Evaluate experiments and bags; give the table and the verdicts.

    Parameters
    ----------
    methods : sequence of str
        Further methods of the compass, ``"module:function"``.
    yaws : sequence of Path
        TUM files of somebody else's yaw, scored beside ours on the bag.

    Raises
    ------
    VisualCompassError
        An experiment or a world is unknown, or a bag cannot be used.
    """
    bags = [Path(name) for name in what if name not in EXPERIMENTS and Path(name).exists()]
    names = [find_experiment(name).name for name in what if Path(name) not in bags]
    if not what:
        names = list(EXPERIMENTS)
    for name in methods:
        find_method(name)  # before hours have passed
    foreign = read_yaws(yaws)
    if foreign and len(bags) != 1:
        raise VisualCompassError(f"--yaw belongs to one bag, and {len(bags)} are given; name the one it was driven in")
    default = settings.compass.method
    outcomes: list[Outcome] = []
    parts: list[str] = []
    for kind in ((TUNED_WORLDS, HELD_OUT_WORLDS) if worlds == ALL_WORLDS else (worlds,)) if names else ():
        found = evaluate_experiments(names, seeds, settings, workers or os.cpu_count() or 1, smooth, kind, methods)
        parts += _tables(found, default, metric, f"{seeds} seed{'s' if seeds > 1 else ''}, {kind} worlds")
        outcomes += found
    if names:
        parts.append(world_table(outcomes))
    drifts, warnings = {}, {}
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
    parts += [drift_table(bag, drift, default) for bag, drift in drifts.items() if drift]
    parts += [
        "\n".join((bag, *warning_lines(wrong, "the summary.json of fuse"))) for bag, wrong in warnings.items() if wrong
    ]
    return "\n\n".join(part for part in parts if part)


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
