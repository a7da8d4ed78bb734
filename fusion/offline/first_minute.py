"""The first minute of a bag, fused to see what is wrong with its sensors: what `inspect` says before anybody fuses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, takewhile

from fusion import Warning
from fusion.offline.bag import Bag, BagError
from fusion.offline.console import progress_bar
from fusion.offline.image_files import ImageRecording
from fusion.offline.recording import BagRecording, read_recording
from fusion.offline.run import fuse_recording
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import Settings

# what is said of stamps and files by looking at all of them
REPORTED, APART = ("stamps_not_increasing", "stamps_wrong", "samples_lost"), "no time in common"
LENGTH_NS = 60_000_000_000  # of the drive, counted from when the last sensor begins
MOST_IMAGES = 600  # some seconds of work; a robot that is shown to a camera turns within them


@dataclass(frozen=True, slots=True)
class Beginning:
    """A recording that ends early."""

    whole: BagRecording | ImageRecording
    gyro: GyroTrack
    odometry: OdometryTrack
    end_ns: int
    truth: None = None

    @property
    def frame_count(self) -> int:
        """How many panoramas there should be."""
        return min(self.whole.frame_count, MOST_IMAGES)

    @property
    def warnings(self) -> list[Warning]:
        """What is wrong with the recording."""
        return self.whole.warnings

    def frames(self) -> Iterator[Frame]:
        """Panoramas by time, until the end of the beginning."""
        return islice(takewhile(lambda frame: frame.t_ns <= self.end_ns, self.whole.frames()), MOST_IMAGES)


def first_minute(bag: Bag, settings: Settings, request: TopicRequest | None = None) -> list[str]:
    """What is wrong with the sensors of an open bag, a sentence each; beyond faults of its files and topics."""
    try:
        choice = choose_topics(bag, settings.topics, request)
    except BagError:
        return []  # reported already
    try:
        recording = read_recording(bag, choice, settings.imu, settings.compass.decoded_columns)
        with progress_bar("looking at the first minute") as progress:
            run = fuse_recording(_beginning(recording), settings, progress)
    except BagError as error:
        return [] if APART in str(error) else [f"fuse would stop: {error}"]
    found = (one.warning for one in run.warnings)
    return [
        f"{one.text} [{one.code}, {one.sensor}]" for one in found if one.code not in REPORTED and APART not in one.text
    ]


def _beginning(recording: BagRecording) -> Beginning:
    """Until `LENGTH_NS` after the last sensor's first sample, or until the last image that is looked at."""
    firsts = [int(track.t_ns[0]) for track in (recording.gyro, recording.odometry) if track.t_ns.size]
    images = list(islice(recording.image_stamps(), MOST_IMAGES))
    end_ns = max([*firsts, *images[:1]], default=0) + LENGTH_NS
    if len(images) == MOST_IMAGES:
        end_ns = min(end_ns, images[-1])
    return Beginning(recording, recording.gyro.until(end_ns), recording.odometry.until(end_ns), end_ns)
