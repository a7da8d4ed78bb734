"""A video or a folder of images as a recording, with CSV files for the other sensors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from compass.errors import VisualCompassError
from fusion.checks.warnings import Warning, WarningLog, most_serious_first
from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.offline.sensor_csv import SensorFileError, read_gyro, read_odometry, read_truth
from fusion.offline.stamp_check import Span
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack, Times, TruthTrack

EMBEDDED = "embedded"  # the gyro that the camera wrote into its video
NEAR_ZERO_NS = 6_000_000_000  # the largest offset between clocks that the filter's own check finds and names
LOST = 0.01  # of all images; single ones may be damaged
NO_GYRO = GyroTrack.of(())
NO_ODOMETRY = OdometryTrack(np.zeros(0, np.int64), *np.zeros((3, 0)))


class ImageFileError(VisualCompassError):
    """A video or a folder of images that cannot be used."""


@dataclass(frozen=True, slots=True)
class SensorFiles:
    """Files of the other sensors, beside a video or a folder of images.

    Attributes
    ----------
    gyro : Path or ``"embedded"`` or None
        CSV file, or the gyro inside the video.
    odometry, truth : Path or None
        CSV files.
    video_start_ns : int or None
        Time of the video's first frame by the clock of the CSV files, ns; None: both begin at about zero.
    """

    gyro: Path | str | None = None
    odometry: Path | None = None
    truth: Path | None = None
    video_start_ns: int | None = None

    def __bool__(self) -> bool:
        return self != SensorFiles()

    @property
    def paths(self) -> list[Path]:
        """Those that are files."""
        return [Path(one) for one in (self.gyro, self.odometry, self.truth) if one is not None and one != EMBEDDED]


class Images(Protocol):
    """Where panoramas come from."""

    @property
    def path(self) -> Path:
        """What the user named."""

    @property
    def kind(self) -> str:
        """`video` or `folder`."""

    @property
    def count(self) -> int:
        """How many there should be."""

    @property
    def faults(self) -> list[str]:
        """What was found to be wrong and yet no reason to stop."""

    def span(self) -> Span:
        """From when to when."""

    def frames(self, columns: int, dropped: Counter[str]) -> Iterator[Frame]:
        """Each by its time, no larger than `columns` need; what cannot be used is counted in `dropped`."""

    def gyro_readings(self) -> tuple[Times, np.ndarray]:
        """The gyro inside: stamps (N,), and (N, 6) rad/s and m/s^2."""


@dataclass(slots=True)
class ImageRecording:
    """A video or a folder of images as a `Recording`.

    Attributes
    ----------
    images : Images
        The panoramas.
    columns : int
        Width the compass works at.
    files : SensorFiles
        Where the other sensors came from.
    gyro, odometry, truth
        As read; empty tracks where there is no file.
    vertical, vertical_words : str
        Where the gyro's vertical came from at the end (see `ImuConfig.up`), and in words.
    dropped : Counter of str
        Images and rows that could not be used, by reason.
    found : list of Warning
        What was wrong with the IMU.
    window : Span or None
        Time from which frames are given; None: all.
    """

    images: Images
    columns: int
    files: SensorFiles
    gyro: GyroTrack = NO_GYRO
    odometry: OdometryTrack = NO_ODOMETRY
    truth: TruthTrack | None = None
    vertical: str = "none"
    vertical_words: str = ""
    dropped: Counter[str] = field(default_factory=Counter)
    found: list[Warning] = field(default_factory=list)
    window: Span | None = None

    @property
    def image_span(self) -> Span | None:
        """From when to when there are panoramas."""
        return self.images.span()

    @property
    def path(self) -> Path:
        """What the user named."""
        return self.images.path

    @property
    def topics(self) -> dict[str, str | None]:
        """The file of each sensor."""
        files = self.files
        return {"image": str(self.path), **{n: _name(getattr(files, n)) for n in ("gyro", "odometry", "truth")}}

    @property
    def frame_count(self) -> int:
        """How many panoramas there should be."""
        return self.images.count

    @property
    def warnings(self) -> list[Warning]:
        """What is wrong with it as far as it was read, most serious first."""
        rows = self.gyro.t_ns.size + self.odometry.t_ns.size + self.images.count
        faults = list(self.images.faults)
        if self.dropped.total() > LOST * rows:
            faults += [f"{count} unusable: {reason}" for reason, count in sorted(self.dropped.items())]
        lost = [Warning("samples_lost", "recording", self.images.span().first_ns, "; ".join(faults))] if faults else []
        return most_serious_first([*self.found, *lost])

    def frames(self) -> Iterator[Frame]:
        """Panoramas by time."""
        usable = 0
        for frame in self.images.frames(self.columns, self.dropped):
            usable += 1
            if self.window is None or self.window.first_ns <= frame.t_ns <= self.window.last_ns:
                yield frame
        if not usable:
            why = ", ".join(self.dropped) or "it is empty"
            raise ImageFileError(f"{self.path}: no usable image: {why}")


def _name(file: Path | str | None) -> str | None:
    return None if file is None else str(file)


def read_image_recording(images: Images, files: SensorFiles, imu: ImuConfig, columns: int) -> ImageRecording:
    """Read the sensors' files; the panoramas are streamed later.

    Raises
    ------
    SensorFileError
        A file cannot be used, or has no time in common with the panoramas.
    """
    recording = ImageRecording(images, columns, files)
    level, log = ImuLevel(imu), WarningLog()
    if files.gyro == EMBEDDED:
        recording.gyro = _embedded(images, level, log)
    elif files.gyro is not None:
        recording.gyro = read_gyro(Path(files.gyro), level, log, recording.dropped)
    if files.odometry is not None:
        recording.odometry = read_odometry(files.odometry, recording.dropped)
    if files.truth is not None:
        recording.truth = read_truth(files.truth, recording.dropped)
    recording.vertical, recording.vertical_words, recording.found = level.source, level.vertical, log.all()
    truth = recording.truth.t_ns if recording.truth else np.zeros(0, np.int64)
    tracks = {files.gyro: recording.gyro.t_ns, files.odometry: recording.odometry.t_ns, files.truth: truth}
    for file, t_ns in tracks.items():
        if file is not None and t_ns.size:
            _check_time(images, files, str(file), Span(int(t_ns[0]), int(t_ns[-1])))
    return recording


def _check_time(images: Images, files: SensorFiles, name: str, span: Span) -> None:
    """Refuse a file by another clock than the panoramas, as far as that shows."""
    seen = images.span()
    spans = f"{images.path.name} {seen.words()}, {Path(name).name} {span.words()}"
    if images.kind == "video" and files.video_start_ns is None and span.first_ns > NEAR_ZERO_NS:
        raise SensorFileError(
            f"{images.path}: a video's own time begins at zero: {spans}; give --video-start, the time of its first "
            "frame by the clock of the CSV files, s"
        )
    if not seen.meets(span):
        remedy = "see to --video-start" if images.kind == "video" else "stamp all by one clock"
        raise SensorFileError(f"{images.path}: no time in common: {spans}; {remedy}")


def _embedded(images: Images, level: ImuLevel, log: WarningLog) -> GyroTrack:
    """The gyro inside a video, levelled."""
    from fusion.offline.columns import levelled

    t_ns, readings = images.gyro_readings()
    unknown = np.full((len(t_ns), 4), np.nan)
    return GyroTrack.of(levelled((t_ns, np.hstack([readings, unknown])), level, log))
