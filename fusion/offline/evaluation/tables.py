"""Outcomes of an evaluation as tables on the screen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from fusion.offline.console import table
from fusion.offline.evaluation.outcome import Outcome
from fusion.offline.evaluation.summary import Summary, summarise_outcomes
from fusion.offline.evaluation.tracks import PAPER
from fusion.offline.gps import Drift
from fusion.simulation import EXPERIMENTS


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
