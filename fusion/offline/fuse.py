"""``visual-compass fuse``: a bag in, a folder of results out."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fusion.offline.atomic_output import staged_folder
from fusion.offline.bag import Bag, BagError
from fusion.offline.console import progress_bar
from fusion.offline.crop import cropped
from fusion.offline.earlier_results import OPTIONAL, check_place, settings_hash
from fusion.offline.plot import plot_run
from fusion.offline.recording import read_recording
from fusion.offline.results import write_results
from fusion.offline.run import FusedRun, fuse_recording, smooth_run
from fusion.offline.source import source_of
from fusion.offline.streams import Progress
from fusion.offline.summary import provenance, summarise
from fusion.offline.topics import TopicRequest, choose_topics, settings_as_asked
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
    force: bool = False,
    inputs: Sequence[Path] = (),
    known_as: str = "",
    progress: Progress | None = None,
) -> Fused:
    """Fuse a bag and write the results.

    Parameters
    ----------
    path : Path
        ROS 1 bag, MCAP, sqlite3 file or rosbag2 folder.
    out : Path or None
        Folder for the results; None puts it into the current folder, named after the bag.
    settings : Settings
        Of compass, filter, IMU, topics, and what of the bag to fuse.
    request : TopicRequest, optional
        Topics asked for by name.
    smooth : bool
        Whether to add the smoothed yaw, whatever the settings say.
    force : bool
        Whether `out` may be a folder with something else in it than earlier results of this bag.
    inputs : sequence of Path
        Other files that are read, such as that of the settings; never replaced.
    known_as : str
        Where the bag came from if `path` is a copy.
    progress : callable, optional
        Takes the finished part, 0..1; otherwise it is shown.

    Raises
    ------
    VisualCompassError
        The bag or the place for the results cannot be used; nothing is written then.
    """
    out = out or Path(f"{path.resolve().stem}_yaw")
    request = request or TopicRequest()
    used = settings_as_used(settings, request, smooth=smooth)
    source = source_of(path, known_as)
    inputs = (path, *inputs, *([Path(settings.compass.mask)] if settings.compass.mask else []))

    def check() -> None:
        check_place(out, source, force=force, inputs=inputs)

    check()
    with Bag(path) as bag:
        choice = choose_topics(bag, settings.topics, request)
        for role in ("image", "gyro", "odometry", "truth"):
            topic = getattr(choice, role)
            log.info("%s: %s", role, f"{topic.name} ({topic.short_type}, {topic.count})" if topic else "none")
        with staged_folder(out, OPTIONAL) as staging:
            with _shown("reading samples", progress, 0.0, 0.1) as part:
                recording = read_recording(bag, choice, settings.imu, settings.compass.columns, part)
            recording = cropped(recording, used.offline)
            with _shown("fusing", progress, 0.1, 1.0) as part:
                run = fuse_recording(recording, settings, part)
            if not run.rows:
                raise BagError(f"{path}: no sample was usable: {_reasons(recording.dropped + run.fusion_counts)}")
            if used.offline.smooth:
                smooth_run(run, settings)
            summary = provenance(source, settings_hash(used)) | summarise(run, recording)
            write_results(staging, run, used, summary)
            plot_run(run, staging / "yaw.png", f"{path.name}: yaw")
            check()  # it may have been filled meanwhile
    for reason, count in recording.dropped.items():
        log.warning("%d unusable: %s", count, reason)
    return Fused(out, run, summary)


def settings_as_used(settings: Settings, request: TopicRequest, *, smooth: bool = False) -> Settings:
    """The settings that repeat a run by themselves, without what was asked for beside them."""
    offline = replace(settings.offline, smooth=smooth or settings.offline.smooth)
    return replace(settings, topics=settings_as_asked(settings.topics, request), offline=offline)


@contextmanager
def _shown(title: str, progress: Progress | None, begin: float, end: float) -> Iterator[Progress]:
    """Progress of a step, from `begin` to `end` of the whole where somebody asked for that, else on the screen."""
    if progress is None:
        with progress_bar(title) as shown:
            yield shown
    else:
        yield lambda part: progress(begin + (end - begin) * part)


def _reasons(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
