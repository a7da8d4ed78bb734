"""Sound robots of all kinds: is the yaw within its sigma, and is nobody named for nothing?

    PYTHONPATH=tests python -m tools.robots_table [--first-seed 0] [--robots 100] [--sensors GTC GC GT] [--jobs 2]

A line for each drive that is not: beyond four deviations for more than a second in all, somebody named for more than a
second, or an end known to no better than five degrees; then all drives together.
"""

import argparse
import math
from dataclasses import asdict
from functools import partial
from multiprocessing import Pool

import numpy as np
from sound_robots import drive, fused, sound_robot


def one(task):
    """A robot's number, its sensors, and how it ended."""
    seed, who = task
    return seed, who, fused(drive(sound_robot(seed), seed), who)


def line(seed, who, result):
    """One drive in words."""
    robot = ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in asdict(sound_robot(seed)).items()
    )
    named = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in result.named.items())
    error, sigma, worst = (math.degrees(value) for value in (result.error, result.sigma, result.worst))
    return (
        f"{seed} {who}: ends {error:.2f} +- {sigma:.2f} deg, {worst:.1f} at worst, {result.ratio:.1f} sigma at worst,"
        f" beyond 4 for {result.over4:.1f} s; {named or 'nobody named'}; {robot}"
    )


def main():
    """Fuse all of them, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = partial(parser.add_argument, type=int)
    add("--first-seed", default=0)
    add("--robots", default=100)
    add("--jobs", default=2)
    parser.add_argument("--sensors", nargs="+", default=["GTC", "GC", "GT"])
    args = parser.parse_args()
    tasks = [(seed, who) for who in args.sensors for seed in range(args.first_seed, args.first_seed + args.robots)]
    results = {who: [] for who in args.sensors}
    with Pool(args.jobs) as pool:
        for seed, who, result in pool.imap(one, tasks):
            results[who].append(result)
            if result.over4 > 1.0 or max(result.named.values(), default=0.0) > 1.0 or math.degrees(result.sigma) > 5.0:
                print(line(seed, who, result), flush=True)
    for who, all_of_them in results.items():
        over, total = sum(r.over4 > 1.0 for r in all_of_them), sum(r.over4 for r in all_of_them)
        ends = math.degrees(np.median([r.error for r in all_of_them]))
        print(
            f"{who}: {over} of {len(all_of_them)} beyond 4 sigma for more than a second; {total:.1f} s in all;", end=" "
        )
        print(f"{sum(bool(r.named) for r in all_of_them)} name somebody; end {ends:.2f} deg off in the median")


if __name__ == "__main__":
    main()
