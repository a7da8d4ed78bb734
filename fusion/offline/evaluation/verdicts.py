"""What the tables say of the aims, in a few sentences."""

from __future__ import annotations

import math

import numpy as np

from fusion.offline.evaluation.summary import Summary
from fusion.offline.evaluation.tracks import PAPER
from fusion.offline.scores import COMPASS, FUSED, GYRO, TRACKS
from fusion.simulation import EXPERIMENTS

NEGLIGIBLE = 0.01  # deg RMS; of single sensors better than this nobody needs to be told that fusion is no better


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
