"""``visual-compass fuse``: a recording in, a folder of results out."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compass.errors import ArgumentError
from compass.files import real
from compass.images.orientation import rows_used
from fusion.offline.atomic_output import staged_folder
from fusion.offline.bag import BagError
from fusion.offline.compass_process import CompassProcess, can_have_process
from fusion.offline.console import progress_bar
from fusion.offline.crop import cropped
from fusion.offline.earlier_results import OPTIONAL, check_place, settings_hash
from fusion.offline.image_files import SensorFiles
from fusion.offline.image_results import ImageResults
from fusion.offline.loading import load_in_turn
from fusion.offline.open_recording import Opened, open_recording
from fusion.offline.plot import LIBRARY, plot_run
from fusion.offline.recording import BagRecording
from fusion.offline.report.page import FILE as REPORT
from fusion.offline.report.page import check_bokeh, write_report
from fusion.offline.report.thumbnails import Thumbnails
from fusion.offline.rerun_export import FILE as RERUN
from fusion.offline.rerun_export import check_rerun, write_rerun
from fusion.offline.results import write_results
from fusion.offline.run import FusedRun, fuse_recording, smooth_run
from fusion.offline.source import Source, source_of
from fusion.offline.streams import Progress
from fusion.offline.summary import provenance, summarise
from fusion.offline.topics import TopicRequest, settings_as_asked
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
    sensors: SensorFiles | None = None,
    report: bool = False,
    rerun: bool = False,
    two_processes: bool = True,
) -> Fused:
    """Fuse a bag, a video or a folder of images and write the results.

    Parameters
    ----------
    path : Path
        ROS 1 bag, MCAP, sqlite3 file or rosbag2 folder; video; folder of images with a ``times.csv``.
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
    sensors : SensorFiles, optional
        CSV files of the other sensors, beside a video or a folder of images.
    report, rerun : bool
        Whether to write ``report.html``, and ``run.rrd`` for the Rerun viewer, too.
    two_processes : bool
        Whether the compass may have a process of its own; the results are the same.

    Raises
    ------
    VisualCompassError
        The bag or the place for the results cannot be used; nothing is written then.
    """
    for name, value in (("path", path), ("out", out or Path())):
        if not isinstance(value, Path):
            given = f"{name} is {value!r}, a {type(value).__name__}"
            raise ArgumentError(f"{given}; give pathlib.Path, or call fusion.offline.fuse, which takes both")
    if report:
        check_bokeh()
    if rerun:
        check_rerun()
    out = out or Path(f"{real(path).stem}_yaw")
    request, sensors = request or TopicRequest(), sensors or SensorFiles()
    used = settings_as_used(settings, request, smooth=smooth)
    source = source_of(path, known_as)
    inputs = (path, *inputs, *sensors.paths, *([Path(settings.compass.mask)] if settings.compass.mask else []))

    def check() -> None:
        check_place(out, source, force=force, inputs=inputs)

    check()
    with open_recording(path, settings, request, sensors) as opened, staged_folder(out, OPTIONAL) as staging:
        run, summary, watched = fuse_opened(
            path, opened, used, source, progress, whole=report or rerun, two_processes=two_processes, load=LIBRARY
        )
        write_results(staging, run, used, summary, watched.pictures)
        plot_run(run, staging / "yaw.png", f"{path.name}: yaw")
        if report:
            write_report(staging / REPORT, run, summary, path.name, watched)
        if rerun:
            write_rerun(staging / RERUN, run, watched)
        check()  # it may have been filled meanwhile
    return Fused(out, run, summary)


def fuse_opened(
    path: Path,
    opened: Opened,
    used: Settings,
    source: Source,
    progress: Progress | None = None,
    *,
    whole: bool = False,
    two_processes: bool = True,
    load: Sequence[str] = (),
) -> tuple[FusedRun, dict[str, Any], Thumbnails]:
    """The run, the summary and small pictures of a recording that is open; nothing is written.

    The pictures show the `whole` of the panoramas, or what of them the compass sees, which is quicker. Modules that the
    caller needs later are loaded meanwhile, where the compass has a process of its own.

    Raises
    ------
    VisualCompassError
        It is damaged, or none of its samples can be used.
    """
    with ExitStack() as stack:
        measure = None
        if two_processes and can_have_process(used.compass, opened.panoramas):
            measure = stack.enter_context(CompassProcess(used.compass)).measure
        with _shown("reading samples", progress, 0.0, 0.1) as part:
            recording = cropped(opened.read(part), used.offline)
        bottom = 1.0
        if isinstance(recording, BagRecording) and not whole:
            bottom = recording.bottom = rows_used(used.compass)
        watched = Thumbnails(recording, bottom)
        results = ImageResults(watched, used, measure)
        if measure is not None:
            results.measure_ahead_while(load_in_turn("fusion.pipeline", *load))
        with _shown("fusing", progress, 0.1, 1.0) as part:
            run = fuse_recording(watched, used, part, results)
    if not run.rows:
        raise BagError(f"{path}: no sample was usable: {_reasons(recording.dropped + run.fusion_counts)}")
    if used.offline.smooth:
        smooth_run(run, used)
    for reason, count in recording.dropped.items():
        log.warning("%d unusable: %s", count, reason)
    return run, provenance(source, settings_hash(used)) | summarise(run, recording), watched


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
