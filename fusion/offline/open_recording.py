"""What a path names: a bag, a video or a folder of images; each opened as a `Recording`."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fusion.offline.bag import Bag, BagError
from fusion.offline.folder import TIMES, ImageFolder, refuse_pictures
from fusion.offline.image_files import ImageFileError, ImageRecording, Images, SensorFiles, read_image_recording
from fusion.offline.recording import BagRecording, read_recording
from fusion.offline.streams import Progress
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.offline.video_file import VideoFile
from fusion.settings import Settings

log = logging.getLogger(__name__)

FileRecording = BagRecording | ImageRecording


@dataclass(frozen=True, slots=True)
class Opened:
    """A recording that is open: what reads all but the panoramas, and how many of these there are."""

    read: Callable[[Progress], FileRecording]
    panoramas: int


def images_of(path: Path, video_start_ns: int | None = None) -> Images | None:
    """A video or a folder of images; None for what may be a bag.

    Raises
    ------
    ImageFileError
        It cannot be used, or is a folder of images without times.
    """
    if ImageFolder.is_one(path):
        return ImageFolder(path)
    return VideoFile(path, video_start_ns or 0) if VideoFile.is_one(path) else None


@contextmanager
def open_recording(
    path: Path, settings: Settings, request: TopicRequest | None = None, sensors: SensorFiles | None = None
) -> Iterator[Opened]:
    """Open a bag, a video or a folder of images.

    Parameters
    ----------
    path : Path
        ROS 1 bag, MCAP, sqlite3 file or rosbag2 folder; video file; folder with a ``times.csv``.
    settings : Settings
        Of compass, IMU and topics.
    request : TopicRequest, optional
        Topics of a bag asked for by name.
    sensors : SensorFiles, optional
        Files of the other sensors beside a video or a folder.

    Raises
    ------
    VisualCompassError
        It cannot be opened, or was given what does not fit it.
    """
    sensors, columns = sensors or SensorFiles(), settings.compass.decoded_columns
    images = images_of(path, sensors.video_start_ns)
    if images is not None:
        if request is not None and request != TopicRequest():
            raise ImageFileError(f"{path}: no bag and so without topics; give --gyro and --odometry CSV files")
        if images.kind == "folder" and sensors.video_start_ns is not None:
            raise ImageFileError(f"{path}: --video-start is for videos; the times of images are in {TIMES}")
        for role, file in (("image", path), ("gyro", sensors.gyro), ("odometry", sensors.odometry)):
            log.info("%s: %s", role, file or "none")
        yield Opened(lambda progress: read_image_recording(images, sensors, settings.imu, columns), images.count)
        return
    if sensors:
        raise BagError(f"{path}: --gyro, --odometry, --truth and --video-start go with a video or a folder of images")
    refuse_pictures(path)
    with Bag(path) as bag:
        choice = choose_topics(bag, settings.topics, request)
        for role in ("image", "gyro", "odometry", "truth"):
            topic = getattr(choice, role)
            log.info("%s: %s", role, f"{topic.name} ({topic.short_type}, {topic.count})" if topic else "none")
        panoramas = choice.image.count if choice.image else 0
        yield Opened(lambda progress: read_recording(bag, choice, settings.imu, columns, progress), panoramas)
