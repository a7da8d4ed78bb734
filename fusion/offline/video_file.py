"""A video file: 360-degree cameras write MP4. Frames and their times through PyAV."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from compass.files import is_folder
from compass.images.decode import MOST_PIXELS
from fusion.offline.image_files import ImageFileError
from fusion.offline.stamp_check import Span
from fusion.offline.streams import Floats, Frame, Times

if TYPE_CHECKING:
    import av

SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".3gp", ".ogv"),
    *(".insv", ".360", ".lrv"),
)
MISSING = 0.01  # of the frames that the container counts, or of its duration where it does not
HALVINGS = (8, 4, 2)


class VideoFile:
    """Frames of a video by the times of its container; see `fusion.offline.image_files.Images`.

    Parameters
    ----------
    path : Path
        Anything FFmpeg reads.
    start_ns : int
        Time of the first frame, ns.

    Raises
    ------
    ImageFileError
        PyAV is not installed, the file is no video, or one that shows no panorama as it stands.
    """

    kind = "video"

    def __init__(self, path: Path, start_ns: int = 0) -> None:
        self.path, self.faults, self._start_ns = path, list[str](), start_ns
        with self._opened() as (container, stream):
            if stream.width * stream.height > MOST_PIXELS or not stream.width * stream.height:
                raise ImageFileError(f"{path}: frames of {stream.width} x {stream.height} pixels are not decoded")
            seconds = float((stream.duration or 0) * (stream.time_base or 0)) or (container.duration or 0) * 1e-6
            rate = float(stream.average_rate or stream.guessed_rate or 0)
            self._counted = bool(stream.frames)  # Matroska does not, and a rate may be any mean
            self.count = int(stream.frames) or round(seconds * rate)
            self._duration_ns = round(seconds * 1e9)

    @staticmethod
    def is_one(path: Path) -> bool:
        """Whether a path is named as videos are."""
        return path.suffix.lower() in SUFFIXES and not is_folder(path)

    @contextmanager
    def _opened(self) -> Iterator[tuple[Any, av.VideoStream]]:
        try:
            import av
        except ImportError:
            raise ImageFileError(
                f"{self.path}: videos are read with PyAV, which is not installed: pip install 'visual-compass[video]'"
            ) from None
        if not os.path.isfile(self.path):
            raise ImageFileError(f"{self.path}: {'no regular' if os.path.exists(self.path) else 'no such'} file")
        try:
            container = av.open(str(self.path), metadata_errors="replace")
        except (av.error.FFmpegError, OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or type(error).__name__
            raise ImageFileError(
                f"{self.path}: cannot be read as a video: {why}; was its recording finished?"
            ) from None
        with container:
            streams = [one for one in container.streams.video if "attached_pic" not in str(one.disposition)]
            if not streams:
                raise ImageFileError(f"{self.path}: holds no video")
            if len(streams) > 1:
                raise ImageFileError(
                    f"{self.path}: holds {len(streams)} video streams, a camera's own format; export it as one "
                    "equirectangular video with the camera's program"
                )
            yield container, streams[0]

    def span(self) -> Span:
        """From when to when, by the container's header."""
        return Span(self._start_ns, self._start_ns + self._duration_ns)

    def frames(self, columns: int, dropped: Counter[str]) -> Iterator[Frame]:
        """Each by its time in grey, reduced while it stays at least `columns` wide; damaged ones are counted."""
        seen, shown_ns, longest_ns = 0, 0, 0
        with self._opened() as (container, stream):
            stream.thread_type = "AUTO"
            stream.codec_context.options = {"err_detect": "explode"}  # else damage is filled in
            first = stream.start_time or 0
            for frame in _decoded(container, stream, dropped):
                if frame.pts is None or frame.pts < first:
                    dropped["video: frame without a time"] += 1
                    continue
                seen += 1
                since_ns = round((frame.pts - first) * frame.time_base * 1_000_000_000)
                longest_ns, shown_ns = max(longest_ns, since_ns - shown_ns), since_ns
                yield Frame(self._start_ns + since_ns, self._grey(frame, columns))
        if self._counted and seen < (1.0 - MISSING) * self.count:
            self.faults.append(f"{self.path.name}: {seen} of {self.count} frames could be read")
        unseen_ns = self._duration_ns - shown_ns
        if not self._counted and unseen_ns > max(MISSING * self._duration_ns, 2 * longest_ns):
            until = f"up to {shown_ns * 1e-9:.1f} of {self._duration_ns * 1e-9:.1f} s"
            self.faults.append(f"{self.path.name}: {seen} frames could be read, {until}")

    def _grey(self, frame: Any, columns: int) -> Any:
        """The picture as it is meant to be shown, upright, in grey."""
        factor = next((n for n in HALVINGS if columns and frame.width >= n * columns), 1)
        size = {"width": frame.width // factor, "height": frame.height // factor} if factor > 1 else {}
        grey = frame.to_ndarray(format="gray", **size, **({"interpolation": "AREA"} if size else {}))
        rotation = int(getattr(frame, "rotation", 0)) % 360  # PyAV 14 and newer
        if rotation not in (0, 180):
            raise ImageFileError(f"{self.path}: is to be shown turned by {rotation} deg: no panorama as it stands")
        return np.ascontiguousarray(grey[::-1, ::-1]) if rotation else grey

    def gyro_readings(self) -> tuple[Times, Floats]:
        """The gyro that GoPro, Insta360 and others write into their videos: stamps, rad/s and m/s^2.

        Raises
        ------
        ImageFileError
            telemetry-parser is not installed, or finds none in the file.
        """
        try:
            from telemetry_parser import Parser
        except ImportError:
            raise ImageFileError(
                f"{self.path}: the gyro inside a video is read with telemetry-parser, which is not installed: "
                "pip install 'visual-compass[telemetry]'"
            ) from None
        try:
            readings = [one for one in Parser(str(self.path)).normalized_imu() if one["gyro"]]
        except (OSError, RuntimeError, ValueError) as error:
            raise ImageFileError(f"{self.path}: no gyro found inside: {error}; give --gyro a CSV file") from None
        if not readings:
            raise ImageFileError(f"{self.path}: no gyro found inside; give --gyro a CSV file")
        t_ns = np.array([round(1e6 * one["timestamp_ms"]) for one in readings], np.int64) + self._start_ns
        rates = np.radians([one["gyro"] for one in readings])
        forces = np.array([one["accl"] or (np.nan,) * 3 for one in readings], np.float64)
        return t_ns, np.hstack([rates, forces])


def _decoded(container: Any, stream: Any, dropped: Counter[str]) -> Iterator[Any]:
    """All sound frames; the damaged, and those made from them, are counted; a file that ends too early ends."""
    import av

    packets, waits = container.demux(stream), False
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError as error:
            dropped[f"video: damaged ({error.strerror})"] += 1
            return
        if packet is None:
            return
        try:
            frames = packet.decode()
        except av.error.FFmpegError as error:
            dropped[f"video: frame damaged ({error.strerror})"] += 1
            waits = True
            continue
        for frame in frames:
            waits = frame.is_corrupt or (waits and not frame.key_frame)
            if waits:
                dropped["video: frame made from one that is damaged, until the next key frame"] += 1
            else:
                yield frame
