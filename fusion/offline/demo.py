"""``visual-compass demo`` and ``simulate``: a simulated drive as a real bag, and that bag fused."""

from __future__ import annotations

from pathlib import Path

from fusion.offline.atomic_output import refuse_existing
from fusion.offline.console import progress_bar
from fusion.offline.earlier_results import earlier_result
from fusion.offline.fuse_bag import Fused, fuse_bag
from fusion.offline.simulated import record_drive
from fusion.offline.source import source_of
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS, simulate


def simulate_bag(experiment: str, seed: int, out: Path, settings: Settings, *, force: bool = False) -> None:
    """Simulate an experiment and write it as a bag with ground truth in it.

    Raises
    ------
    VisualCompassError
        There is no such experiment, or `out` cannot be written: without `force` not even a file that exists.
    """
    refuse_existing(out, force=force)
    drive = simulate(experiment, seed)
    with progress_bar(f"rendering {experiment}") as progress:
        drive.prepare(lambda done, count: progress(done / count))
    with progress_bar(f"writing {out.name}") as progress:
        record_drive(drive, out, settings, progress)


def run_demo(folder: Path, settings: Settings, *, force: bool = False) -> Fused:
    """Simulate the demo drive into ``folder/demo.mcap`` and fuse that bag into ``folder/yaw``.

    Raises
    ------
    VisualCompassError
        `folder` cannot be written, or has, without `force`, another bag of that name than an earlier demo left.
    """
    bag, results = folder / "demo.mcap", folder / "yaw"
    earlier = earlier_result(results)
    ours = force or (earlier is not None and bag.is_file() and earlier.source.same_as(source_of(bag)))
    simulate_bag("demo", 0, bag, settings, force=ours)
    return fuse_bag(bag, results, settings, force=ours)


def experiment_list() -> str:
    """Names and summaries of all experiments, one per line."""
    width = max(map(len, EXPERIMENTS))
    return "\n".join(f"{name.ljust(width)}  {one.summary}" for name, one in EXPERIMENTS.items())
