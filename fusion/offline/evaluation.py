"""From the arguments of ``visual-compass evaluate`` to its text."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from fusion.offline.bag import BagError
from fusion.offline.evaluate import Outcome, evaluate_bag, evaluate_experiments
from fusion.offline.staging import staged_file
from fusion.offline.summary import warning_lines
from fusion.offline.topics import TopicRequest
from fusion.offline.verdicts import as_json, drift_table, full_table, short_table, summarise_outcomes, verdict_lines
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS
from fusion.simulation.experiments import find_experiment


def run_evaluation(
    what: Sequence[str],
    seeds: int,
    settings: Settings,
    request: TopicRequest,
    metric: str = "all",
    json_file: Path | None = None,
    workers: int | None = None,
    smooth: bool = False,
) -> str:
    """Evaluate experiments and bags; give the table and the verdicts.

    Raises
    ------
    VisualCompassError
        An experiment is unknown or a bag cannot be used.
    """
    bags = [Path(name) for name in what if name not in EXPERIMENTS and Path(name).exists()]
    names = [find_experiment(name).name for name in what if Path(name) not in bags]
    if not what:
        names = list(EXPERIMENTS)
    outcomes: list[Outcome] = []
    if names:
        outcomes += evaluate_experiments(names, seeds, settings, workers or os.cpu_count() or 1, smooth)
    drifts, warnings = {}, {}
    for bag in bags:
        found = evaluate_bag(bag, settings, request, smooth)
        if not found.outcomes and not found.drifts:
            raise BagError(f"{bag}: nothing to score: no yaw has two times in common with the truth, or with GPS fixes")
        outcomes += found.outcomes
        drifts[str(bag)], warnings[str(bag)] = found.drifts, found.warnings
    default = settings.compass.method
    summaries = summarise_outcomes(outcomes)
    if json_file is not None:
        with staged_file(json_file) as staged:
            content = as_json(outcomes, summaries, drifts, default) | {"warnings": warnings}
            staged.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    parts = []
    if outcomes:
        shown = full_table(summaries, default) if metric == "all" else short_table(summaries, default, metric)
        parts.append(f"errors in deg, {seeds} seed{'s' if seeds > 1 else ''}\n{shown}")
        parts.append("\n".join(verdict_lines(summaries, default)))
    parts += [drift_table(bag, drift, default) for bag, drift in drifts.items() if drift]
    parts += [
        "\n".join((bag, *warning_lines(wrong, "the summary.json of fuse"))) for bag, wrong in warnings.items() if wrong
    ]
    return "\n\n".join(part for part in parts if part)
