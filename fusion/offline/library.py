"""Fusion for programs: ``run = fuse("drive.mcap")``, and what came of it as tables and numbers."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from compass.errors import ArgumentError
from fusion.checks.warnings import Warning
from fusion.offline.fuse_bag import fuse_bag, fuse_opened, settings_as_used
from fusion.offline.image_files import EMBEDDED, SensorFiles
from fusion.offline.open_recording import open_recording
from fusion.offline.results import table_of
from fusion.offline.run import FusedRun
from fusion.offline.source import source_of
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings, load_settings

if TYPE_CHECKING:
    import pandas as pd

PathLike = str | os.PathLike[str]
WORDS = ("compass_status", "warnings")  # columns of text
LATEST_S = 1e11  # s, year 5138; later ones are meant in other units


@dataclass(frozen=True, slots=True)
class Run:
    """A finished run.

    Attributes
    ----------
    summary : dict
        What ``summary.json`` holds.
    warnings : tuple of Warning
        What was wrong, most serious first.
    folder : Path or None
        Where the result files are, if they were asked for.
    details : FusedRun
        All that the run knows, row by row.
    """

    summary: dict[str, Any]
    warnings: tuple[Warning, ...]
    folder: Path | None
    details: FusedRun = field(repr=False)

    @property
    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """The columns of ``yaw.csv``, each (N,), in rad and s, left positive, NaN where unknown; and `t_ns`, int."""
        names, rows = table_of(self.details)
        cells = list(rows)
        table: dict[str, npt.NDArray[Any]] = {"t_ns": self.details.t_ns}
        for name in names:
            column = [row.get(name, "") for row in cells]
            table[name] = np.array(column if name in WORDS else [float(cell or "nan") for cell in column])
        return table

    @property
    def yaw(self) -> pd.DataFrame:
        """`columns` as a table, a row per estimate, `t_ns` as the index.

        Raises
        ------
        ArgumentError
            pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise ArgumentError("run.yaw needs pandas: pip install pandas; run.columns goes without") from None
        return pd.DataFrame(self.columns).set_index("t_ns")


def fuse(
    path: PathLike,
    *,
    config: PathLike | Settings | None = None,
    image_topic: str | None = None,
    gyro_topic: str | None = None,
    odometry_topic: str | None = None,
    truth_topic: str | None = None,
    gyro: PathLike | None = None,
    odometry: PathLike | None = None,
    truth: PathLike | None = None,
    video_start: float | None = None,
    smooth: bool = False,
    out: PathLike | None = None,
    report: bool = False,
) -> Run:
    """Fuse a bag, a video or a folder of images.

    Parameters
    ----------
    path : str or Path
        ROS 1 bag, MCAP, sqlite3 file or rosbag2 folder; video file; folder of images with a ``times.csv``.
    config : str, Path or Settings, optional
        Parameters: a YAML file in ROS form, or `fusion.settings.Settings`.
    image_topic, gyro_topic, odometry_topic, truth_topic : str, optional
        Topics of a bag, each found by its type when left out; ``"none"`` leaves the sensor out.
    gyro, odometry, truth : str or Path, optional
        CSV files beside a video or a folder of images; ``gyro="embedded"`` takes the gyro inside the video.
    video_start : float, optional
        Time of the video's first frame by the clock of the CSV files, s.
    smooth : bool
        Whether to add the fixed-interval smoother.
    out : str or Path, optional
        Folder for the result files of the command; None writes nothing.
    report : bool
        Whether ``report.html`` is among them.

    Returns
    -------
    Run
        With the yaw as a table, the summary and the warnings.

    Raises
    ------
    VisualCompassError
        The recording or a file cannot be used, in one line; `ArgumentError` for an argument of a wrong type or unit.

    Examples
    --------
    >>> run = fuse("drive.mcap")  # doctest: +SKIP
    >>> run.yaw.fused_yaw.iloc[-1], run.summary["yaw"]["fused"], run.warnings  # doctest: +SKIP
    """
    where = _path("path", path)
    settings = config if isinstance(config, Settings) else load_settings(_optional_path("config", config))
    files = SensorFiles(
        EMBEDDED if gyro == EMBEDDED else _optional_path("gyro", gyro),
        _optional_path("odometry", odometry),
        _optional_path("truth", truth),
        _start_ns(video_start),
    )
    request = TopicRequest(image_topic, gyro_topic, odometry_topic, truth_topic)
    for name in TopicRequest.__dataclass_fields__:
        if not isinstance(topic := getattr(request, name), str | None):
            raise ArgumentError(f"{name}_topic is {topic!r}; give the name of a topic")
    if report and out is None:
        raise ArgumentError("report=True writes a file; give out, the folder for it")
    if out is None:
        with open_recording(where, settings, request, files) as opened:
            used = settings_as_used(settings, request, smooth=smooth)
            details, summary, _ = fuse_opened(where, opened, used, source_of(where))
        return _finished(details, summary, None)
    done = fuse_bag(where, _path("out", out), settings, request, smooth=smooth, sensors=files, report=report)
    return _finished(done.run, done.summary, done.folder)


def _finished(details: FusedRun, summary: dict[str, Any], folder: Path | None) -> Run:
    return Run(summary, tuple(one.warning for one in details.warnings), folder, details)


def _path(name: str, value: Any) -> Path:
    if not isinstance(value, str | os.PathLike):
        raise ArgumentError(f"{name} is {value!r}; give a path, as str or pathlib.Path")
    if not os.fspath(value):
        raise ArgumentError(f"{name} is empty; give a path")
    if "\0" in str(value):
        raise ArgumentError(f"{name} is {str(value)!r}; no name of a file holds a NUL")
    return Path(value)


def _optional_path(name: str, value: Any) -> Path | None:
    return None if value is None else _path(name, value)


def _start_ns(seconds: Any) -> int | None:
    """Seconds as nanoseconds; an error where they cannot be seconds."""
    if seconds is None:
        return None
    if isinstance(seconds, bool) or not isinstance(seconds, int | float | np.number):
        raise ArgumentError(f"video_start is {seconds!r}; give seconds")
    if not 0.0 <= float(seconds) < LATEST_S:
        hint = f"; are these nanoseconds? give {float(seconds) * 1e-9:.9g}" if float(seconds) >= LATEST_S else ""
        raise ArgumentError(f"video_start is {seconds} s, not a time from 0 to {LATEST_S:g} s{hint}")
    return round(float(seconds) * 1e9)
