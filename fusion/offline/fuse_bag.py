"""``visual-compass fuse``: a bag in, a folder of results out."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compass.errors import ArgumentError
from fusion.offline.atomic_output import staged_folder
from fusion.offline.bag import BagError
from fusion.offline.console import progress_bar
from fusion.offline.image_files import SensorFiles
from fusion.offline.open_recording import Read, open_recording
from fusion.offline.plot import plot_run
from fusion.offline.report.page import FILE as REPORT
from fusion.offline.report.page import check_bokeh, write_report
from fusion.offline.report.thumbnails import Thumbnails
from fusion.offline.rerun_export import FILE as RERUN
from fusion.offline.rerun_export import check_rerun, write_rerun
from fusion.offline.results import OPTIONAL, write_results
from fusion.offline.run import FusedRun, fuse_recording, smooth_run
from fusion.offline.summary import summarise
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Fused:
    """A finished `fuse`: the folder, the run and its summary."""

    folder: Path
    run: FusedRun
    summary: dict[str, Any]


def fuse_bag(
    path: Path,
    out: Path | None,
    settings: Settings,
    request: TopicRequest | None = None,
    *,
    smooth: bool = False,
    sensors: SensorFiles | None = None,
    report: bool = False,
    rerun: bool = False,
) -> Fused:
    """Fuse a bag, a video or a folder of images and write the results.

    Parameters
    ----------
    path : Path
        ROS 1 bag, MCAP, sqlite3 file or rosbag2 folder; video; folder of images with a ``times.csv``.
    out : Path or None
        Folder for the results; None puts it into the current folder, named after the bag.
    settings : Settings
        Of compass, filter, IMU and topics.
    request : TopicRequest, optional
        Topics asked for by name.
    smooth : bool
        Whether to add the yaw that knows the future.
    sensors : SensorFiles, optional
        CSV files of the other sensors, beside a video or a folder of images.
    report : bool
        Whether to write ``report.html``, too.
    rerun : bool
        Whether to write ``run.rrd`` for the Rerun viewer, too.

    Raises
    ------
    VisualCompassError
        The bag or the place for the results cannot be used; nothing is written then.
    """
    if not isinstance(path, Path):
        told = f"path is {path!r}, a {type(path).__name__}"
        raise ArgumentError(f"{told}; give pathlib.Path, or call fusion.offline.fuse, which takes both")
    out = out or Path(f"{path.resolve().stem}_yaw")
    pictures: list[Thumbnails] = []
    if report:
        check_bokeh()
    if rerun:
        check_rerun()
    with open_recording(path, settings, request, sensors) as read, staged_folder(out, OPTIONAL) as staging:
        run, summary = fuse_opened(path, read, settings, smooth=smooth, pictures=pictures if report or rerun else None)
        write_results(staging, run, settings, summary)
        plot_run(run, staging / "yaw.png", f"{path.name}: yaw")
        if report:
            write_report(staging / REPORT, run, summary, path.name, *pictures)
        if rerun:
            write_rerun(staging / RERUN, run, *pictures)
    return Fused(out, run, summary)


def fuse_opened(
    path: Path, read: Read, settings: Settings, *, smooth: bool = False, pictures: list[Thumbnails] | None = None
) -> tuple[FusedRun, dict[str, Any]]:
    """The run and the summary of a recording that is open; nothing is written.

    A list of `pictures` gets the recording's thumbnails.

    Raises
    ------
    VisualCompassError
        It is damaged, or none of its samples can be used.
    """
    with progress_bar("reading samples") as progress:
        recording = read(progress)
    with progress_bar("fusing") as progress:
        watched = recording if pictures is None else Thumbnails(recording)
        run = fuse_recording(watched, settings, progress)
    if pictures is not None and isinstance(watched, Thumbnails):
        pictures.append(watched)
    if not run.rows:
        raise BagError(f"{path}: no sample was usable: {_reasons(recording.dropped + run.fusion_counts)}")
    if smooth:
        smooth_run(run, settings)
    summary = summarise(run, recording)
    for reason, count in recording.dropped.items():
        log.warning("%d unusable: %s", count, reason)
    return run, summary


def _reasons(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
