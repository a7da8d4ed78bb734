"""What does a sample cost the filter, and what an image that comes late?

A drive with gyro at 200 Hz, odometry at 50 Hz and increments at 30 Hz, fused in the order of the stamps; then again
with every tenth increment late by some time. A late one replays what followed it: its cost grows with how late it is
and is bounded by `lag_window`, as older ones are refused. Processor time, best of three. `--markdown FILE` writes
the section of that file as well.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compass import YawIncrement
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion
from fusion.buffer.events import Sample
from fusion.offline.markdown import markdown_table, write_section

SECONDS = 8.0
LATENESS = (0.1, 0.3, 1.0)  # s
RATE = 0.4  # rad/s


@dataclass(frozen=True)
class Costs:
    """Processor time, s: mean of a sample in order; mean and most of a late increment."""

    in_order: float
    late: float
    worst: float


def drive() -> list[Sample]:
    """A steady turn seen by all three sensors."""
    rng = np.random.default_rng(0)
    samples: list[Sample] = [GyroSample(i * 5_000_000, RATE + 0.003 * rng.normal()) for i in range(int(200 * SECONDS))]
    samples += [
        OdometrySample(i * 20_000_000, 1.3 * RATE, 0.3, 1.3 * RATE * i / 50.0) for i in range(int(50 * SECONDS))
    ]
    stamps = [i * 1_000_000_000 // 30 for i in range(int(30 * SECONDS))]
    for i in range(1, len(stamps)):
        reference = stamps[(i - 1) // 10 * 10]
        turn = RATE * (stamps[i] - reference) * 1e-9 + 5e-4 * rng.normal()
        samples.append(YawIncrement(reference, stamps[i], turn, 25e-8, 0.9))
    return sorted(samples, key=lambda sample: sample.t_ns)


def with_late_increments(samples: list[Sample], late: float) -> list[tuple[Sample, bool]]:
    """Samples in the order of their arrival, and which of them are late."""
    arrivals, count = [], 0
    for sample in samples:
        count += isinstance(sample, YawIncrement)
        is_late = isinstance(sample, YawIncrement) and count % 10 == 5
        arrivals.append((sample.t_ns + is_late * round(late * 1e9), is_late, sample))
    arrivals.sort(key=lambda arrival: arrival[:2])
    return [(sample, is_late) for _, is_late, sample in arrivals]


def costs(arrivals: list[tuple[Sample, bool]]) -> Costs:
    """Feed a filter sample by sample and take the time of each."""
    fusion = YawFusion(FusionConfig(lag_window=1.0))
    times: dict[bool, list[float]] = {False: [], True: []}
    for sample, is_late in arrivals:
        start = time.process_time()
        fusion.add(sample)
        times[is_late].append(time.process_time() - start)
    late = times[True] or [math.nan]
    return Costs(float(np.mean(times[False])), float(np.mean(late)), max(late))


def main() -> None:
    """Print the costs."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--markdown", type=Path, help="write the section of this file, too")
    page = arguments.parse_args().markdown
    samples = drive()
    plain = min((costs([(sample, False) for sample in samples]) for _ in range(3)), key=lambda c: c.in_order)
    rate, share = len(samples) / SECONDS, 100 * plain.in_order * len(samples) / SECONDS
    print(f"gyro 200 Hz, odometry 50 Hz, images 30 Hz: {rate:.0f} samples a second")
    print(f"a sample in order         {1e3 * plain.in_order:8.2f} ms   {share:.0f} % of a core")
    rows = []
    for late in LATENESS:
        found = min((costs(with_late_increments(samples, late)) for _ in range(3)), key=lambda c: c.late)
        replayed, aim = found.late / plain.in_order, 1.5 * late * rate + 20
        print(
            f"an image late by {late:3.1f} s    {1e3 * found.late:7.2f} ms   worst {1e3 * found.worst:.1f} ms"
            f"   as {replayed:.0f} samples in order   aim: at most {aim:.0f}"
        )
        worst = found.worst / plain.in_order
        rows.append((f"{late:g} s", f"{late * rate:.0f}", f"{replayed:.0f}", f"{worst:.0f}", f"{aim:.0f}"))
    if page:
        text = f"""## Cost of a late image

Gyro at 200 Hz, odometry at 50 Hz, increments at 30 Hz: {rate:.0f} samples a second, in order of their stamps
{share:.0f} % of a core. An increment that is late replays what followed it. Processor time of a late increment as a
multiple of a sample in order, of one run.

{markdown_table(("late by", "samples replayed", "mean", "dearest", "aim of the mean"), rows)}"""
        write_section(page, "late images", text)


if __name__ == "__main__":
    main()
