"""Run all and write docs/faults.md: ``make torture``, or ``PYTHONPATH=tests python -m torture --only "GT G deg/s"``."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import logging
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from torture.drawn import drawn
from torture.report import _outcome, report
from torture.rows import all_rows
from torture.verdict import DRIVES, Result, try_on, try_row

# Without a fault these drives stay within 3 sigma, so that what fails is the fault; of 30 seeds the mean of
# error^2 / variance at the end is 1.1 (slow camera) and 0.9 (stop and go).
SEEDS = dict(zip(DRIVES, (1, 1, 2), strict=True))
CONTROL_SEEDS = 2, 3, 4
DRAWN = 200
PAGE = Path(__file__).parents[2] / "docs" / "faults.md"


def jobs(only: str = "", drives: Sequence[str] = DRIVES, others: int = 0) -> list[tuple[int, str, int]]:
    """Index of the row, drive and seed of all that is tried; `others`: what to add to all seeds."""
    return [
        (index, name, one + others)
        for index, row in enumerate(all_rows())
        if only in f"{row.who} {row.faulty} {row.name}"
        for name in drives
        for one in (CONTROL_SEEDS if not row.faulty else (SEEDS[name],))
    ]


def run_drawn(seed: int) -> Result:
    """Try what is drawn for a seed."""
    logging.disable(logging.WARNING)
    row, ride = drawn(seed)
    result = try_on(row, ride, f"drawn {seed}", seed)
    result.row = replace(row, make=None)  # type: ignore[arg-type]  # a row's functions cannot be pickled
    return result


def run_job(job: tuple[int, str, int]) -> Result:
    """Try a row on a drive."""
    logging.disable(logging.WARNING)
    index, name, seed = job
    result = try_row(all_rows()[index], name, seed)
    result.row = index  # type: ignore[assignment]  # a row's functions cannot be pickled
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description="every sensor times every fault")
    parser.add_argument("--only", default="", help="only lines that contain this text: 'GT G deg/s'")
    parser.add_argument("--drive", choices=DRIVES, action="append", help="only this drive")
    parser.add_argument("--others", type=int, default=0, help="add to all seeds: drives on which nothing was mended")
    parser.add_argument("--drawn", type=int, help=f"faults of random size after the table  [of all of it: {DRAWN}]")
    parser.add_argument("--first-drawn", type=int, default=0, help="their first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=PAGE)
    args = parser.parse_args()
    began, rows = time.monotonic(), all_rows()
    with ProcessPoolExecutor(args.jobs) as pool:
        results = list(pool.map(run_job, jobs(args.only, args.drive or DRIVES, args.others), chunksize=3))
        count = args.drawn if args.drawn is not None else 0 if args.only or args.drive else DRAWN
        seeds = range(args.first_drawn, args.first_drawn + count)
        at_random = list(pool.map(run_drawn, seeds, chunksize=3))
    for one in results:
        one.row = rows[one.row]  # type: ignore[call-overload]
        if one.faults:
            print(f"FAIL {one.row.who} {one.row.faulty or '-'} {one.row.name}, {one.drive}: {_outcome(one)}")
    for one in at_random:
        if one.over4 > 1.0:
            print(f"WRONG {one.row.who} {one.row.faulty} {one.row.name}, {one.drive}: {_outcome(one)}")
    failed = sum(bool(one.faults) for one in results)
    args.out.write_text(report(results, at_random))
    print(f"{len(results) - failed} of {len(results)} pass, {time.monotonic() - began:.0f} s: {args.out}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
