"""From the arguments of ``visual-compass fuse`` to its text: one bag, or many."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from compass.errors import VisualCompassError
from fusion.offline.batch import fuse_bags
from fusion.offline.batch_table import CSV
from fusion.offline.find_bags import absolute, find_bags
from fusion.offline.fuse_bag import fuse_bag
from fusion.offline.image_files import ImageFileError, SensorFiles
from fusion.offline.report.table import report_of_folder
from fusion.offline.summary import remarks, warning_lines, yaw_table
from fusion.offline.topics import TopicRequest
from fusion.offline.verbosity import say
from fusion.settings import Settings


def fuse_named(
    words: Sequence[str],
    out: Path | None,
    settings: Settings,
    request: TopicRequest,
    sensors: SensorFiles | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    force: bool = False,
    inputs: Sequence[Path] = (),
    report: bool = False,
    rerun: bool = False,
) -> None:
    """Fuse what `words` name: one bag into `out`, or many into folders in `out` (see `find_bags`, `fuse_bags`).

    `sensors` are files beside one video or folder of images.

    Raises
    ------
    VisualCompassError
        Nothing can be fused, or at least one of many failed.
    """
    found, many = _bags(words, out)
    options: dict[str, Any] = {"force": force, "inputs": inputs, "report": report, "rerun": rerun}
    if not (many or jobs or scheduler):
        _fuse_one(Path(words[0]), out, settings, request, sensors=sensors, **options)
        return
    if sensors:
        raise ImageFileError("--gyro, --odometry, --truth and --video-start go with one video or folder of images")
    workers: dict[str, Any] = {"jobs": jobs or os.cpu_count() or 1, "scheduler": scheduler}
    _fuse_many(found, out or Path(), settings, request, **options, **workers)


def _bags(words: Sequence[str], out: Path | None) -> tuple[list[str], bool]:
    """The bags that are named, and whether they are fused as many are: not where one file or folder is one bag."""
    found = find_bags(words, out)
    return found, len(words) > 1 or found != [absolute(Path(words[0]))]


def _fuse_one(bag: Path, out: Path | None, settings: Settings, request: TopicRequest, **options: Any) -> None:
    fused = fuse_bag(bag, out, settings, request, **options)
    say(yaw_table(fused.summary))
    for line in (*warning_lines(fused.summary["warnings"]), *remarks(fused.summary)):
        say(line)
    say(f"results in {fused.folder}/, plot in {fused.folder / 'yaw.png'}")


def _fuse_many(bags: Sequence[str], out: Path, settings: Settings, request: TopicRequest, **options: Any) -> None:
    result = fuse_bags(bags, out, settings, request, **options)
    say(str(result))
    if options["report"]:
        say(f"table of all in {report_of_folder(out)[0]}")
    if result.failed:
        raise VisualCompassError(f"{result.failed} of {len(bags)} bags failed; {out / CSV} says why")
