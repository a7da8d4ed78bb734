"""``visual-compass fuse``: a bag in, a folder of results out."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion.offline.atomic_output import staged_folder
from fusion.offline.bag import Bag, BagError
from fusion.offline.console import progress_bar
from fusion.offline.plot import plot_run
from fusion.offline.recording import read_recording
from fusion.offline.results import OPTIONAL, write_results
from fusion.offline.run import FusedRun, fuse_recording, smooth_run
from fusion.offline.summary import summarise
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import Settings

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Fused:
    """A finished `fuse`: the folder, the run and its summary."""

    folder: Path
    run: FusedRun
    summary: dict[str, Any]


def fuse_bag(
    path: Path, out: Path | None, settings: Settings, request: TopicRequest | None = None, *, smooth: bool = False
) -> Fused:
    """Fuse a bag and write the results.

    Parameters
    ----------
    path : Path
        ROS 1 bag, MCAP, sqlite3 file or rosbag2 folder.
    out : Path or None
        Folder for the results; None puts it into the current folder, named after the bag.
    settings : Settings
        Of compass, filter, IMU and topics.
    request : TopicRequest, optional
        Topics asked for by name.
    smooth : bool
        Whether to add the yaw that knows the future.

    Raises
    ------
    VisualCompassError
        The bag or the place for the results cannot be used; nothing is written then.
    """
    out = out or Path(f"{path.resolve().stem}_yaw")
    with Bag(path) as bag:
        choice = choose_topics(bag, settings.topics, request)
        for role in ("image", "gyro", "odometry", "truth"):
            topic = getattr(choice, role)
            log.info("%s: %s", role, f"{topic.name} ({topic.short_type}, {topic.count})" if topic else "none")
        with staged_folder(out, OPTIONAL) as staging:
            with progress_bar("reading samples") as progress:
                recording = read_recording(bag, choice, settings.imu, settings.compass.decoded_columns, progress)
            with progress_bar("fusing") as progress:
                run = fuse_recording(recording, settings, progress)
            if not run.rows:
                raise BagError(f"{path}: no sample was usable: {_reasons(recording.dropped + run.fusion_counts)}")
            if smooth:
                smooth_run(run, settings)
            summary = summarise(run, recording)
            write_results(staging, run, settings, summary)
            plot_run(run, staging / "yaw.png", f"{path.name}: yaw")
    for reason, count in recording.dropped.items():
        log.warning("%d unusable: %s", count, reason)
    return Fused(out, run, summary)


def _reasons(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
