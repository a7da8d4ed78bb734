"""The results as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import groupby

from torture.rows import NONE, Row
from torture.verdict import Result

HEAD = (
    "| sensors | fault of | fault | drive | final error | final sigma | worst error | worst ratio | > 3 for | > 4 for "
    "| warnings given (s) | named after | expected | result |"
)
TITLES = {"": "Without a fault", "G": "Gyro", "T": "Tracks", "C": "Compass"}


def _number(value: float, digits: int = 2) -> str:
    return "-" if not math.isfinite(value) else f"{value:.{digits}f}"


def _expected(row: Row) -> str:
    if row.words == NONE:
        return "none"
    codes = ", ".join(row.codes)
    return codes or ("-" if row.words == "may" else "any") if row.words != "may" or not codes else f"({codes})"


def _line(result: Result, drive: str, ok: str) -> str:
    row = result.row
    said = ", ".join(f"{key} ({seconds:.1f})" for key, seconds in sorted(result.warnings.items(), key=lambda x: -x[1]))
    after = "" if result.named_after is None else f"{result.named_after:.1f}"
    numbers = [_number(value) for value in (result.error, result.sigma, result.worst)]
    numbers += [_number(value, 1) for value in (result.ratio, result.over3, result.over4)]
    cells = [row.who, row.faulty, row.name, drive, *numbers, said, after, _expected(row), ok]
    return "| " + " | ".join(cells) + " |"


def _outcome(result: Result) -> str:
    notes = f" ({'; '.join(result.notes)})" if result.notes else ""
    return ("**" + "; ".join(result.faults) + "**" if result.faults else "ok") + notes


def _seriousness(result: Result) -> tuple[float, float]:
    """Largest first: confidently wrong, by how much it was too sure; then what is only not said."""
    return result.over4, result.over3


def _lines(results: Iterable[Result]) -> list[str]:
    return [HEAD, "|" + "---|" * HEAD.count(" | ") + "---|"] + [_line(one, one.drive, _outcome(one)) for one in results]


def _worst(results: Sequence[Result]) -> str:
    """One line of all drives: of each number the worst."""
    worst = max(results, key=_seriousness)
    merged = Result(worst.row, "", 0)
    merged.error = max((one.error for one in results), key=abs)
    for name in ("sigma", "worst", "ratio", "over3", "over4"):
        setattr(merged, name, max(getattr(one, name) for one in results))
    for one in results:
        for key, seconds in one.warnings.items():
            merged.warnings[key] = max(seconds, merged.warnings.get(key, 0.0))
    named = [one.named_after for one in results]
    merged.named_after = None if None in named else max(one for one in named if one is not None)
    failed = sum(bool(one.faults) for one in results)
    ok = "ok" if not failed else f"**{failed} of {len(results)} fail**"
    return _line(merged, str(len(results)), ok)


def report(results: Sequence[Result], drawn: Sequence[Result] = ()) -> str:
    """The whole page; `drawn`: faults of random size on random drives."""
    failed = sorted((one for one in results if one.faults), key=_seriousness, reverse=True)
    lasting = [one for one in failed if one.over4 > 1.0]
    brief = [one for one in failed if one not in lasting and (one.ratio > 4.0 or one.over3 > 2.0)]
    parts = [
        "# Faults",
        "Every sensor times every fault, over three simulated drives of 40 s, through `YawPipeline`; made by"
        " `make torture`. A fault begins at 14 s unless it says from the start. Angles in degrees, times in seconds;"
        " ratio: |error| over the larger of sigma and 0.02 deg, of the estimate after every sample. G gyro, T tracks,"
        " C compass.",
        "It passes where the ratio is never beyond 4, and beyond 3 for at most 2 s; where the final sigma is at most"
        " 3 deg if two sound sensors remain (else it must cover the truth, however large); and where a warning names"
        " the faulty sensor of a fault that lasts 2 s or more. Expected codes in brackets: a warning may be given, but"
        " need not. Without a fault no warning may be given. Notes in brackets do not fail: `other code` is none of"
        " the expected ones, `blames` names a sound sensor alone for 2 s or more.",
        f"{len(results) - len(failed)} of {len(results)} pass; {len(lasting)} are confidently wrong (beyond 4"
        f" sigma) for more than a second in all, {len(brief)} for less, beyond 3 sigma for long, or until they are"
        f" found out; {len(failed) - len(lasting) - len(brief)} keep inside sigma but say too little, or are too"
        " unsure.",
    ]
    if failed:
        parts += ["## What fails, worst first", "\n".join(_lines(failed))]
    if drawn:
        parts += _drawn(drawn)
    parts += ["## All, the worst of three drives", "\n".join(_sections(results))]
    return "\n\n".join(parts) + "\n"


def _drawn(results: Sequence[Result]) -> list[str]:
    """What became of faults that were drawn."""
    lasting = sorted((one for one in results if one.over4 > 1.0), key=_seriousness, reverse=True)
    brief = [one for one in results if one.over4 <= 1.0 and one.ratio > 4.0]
    most = max((one.over4 for one in brief), default=0.0)
    parts = [
        "## Drawn at random",
        f"{len(results)} faults of random kind, size, onset and length, each on a drive of its own: sensors, rates,"
        " noises, legs and stops are drawn, too (`tests/torture/drawn.py`). Only the sigma is judged.",
        f"{len(lasting)} are confidently wrong (beyond 4 sigma) for more than a second in all, {len(brief)} for less"
        f" ({most:.1f} s at most), {len(results) - len(lasting) - len(brief)} never.",
    ]
    return [*parts, "\n".join(_lines(lasting))] if lasting else parts


def _sections(results: Sequence[Result]) -> list[str]:
    lines = [HEAD.replace("| drive |", "| drives |"), "|" + "---|" * HEAD.count(" | ") + "---|"]
    for _, group in groupby(results, key=lambda one: (one.row.who, one.row.faulty, one.row.name)):
        lines.append(_worst(list(group)))
    return lines
