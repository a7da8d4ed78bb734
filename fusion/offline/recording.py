"""A bag's sensors ordered by ``header.stamp``: small samples at once, panoramas one by one."""

from __future__ import annotations

import heapq
import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from compass.errors import ImageError
from fusion.buffer.events import Sensor
from fusion.checks.warnings import Warning, WarningLog, most_serious_first
from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.messages import NO_GYRO, MessageError, image_of
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import VIDEOS, Message, Topic
from fusion.offline.clock_steps import ClockSteps, Recorded
from fusion.offline.columns import Columns, levelled, sorted_rows
from fusion.offline.common_time import of_common_time
from fusion.offline.decode import decode_ahead
from fusion.offline.reasons import count_reason
from fusion.offline.stamp_check import Span, wrong_stamps
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack, Progress, TruthTrack, unwrap
from fusion.offline.topics import TopicChoice
from fusion.pictures import PictureStream, packet_of

log = logging.getLogger(__name__)

FRAMES_OUT_OF_ORDER = 8  # images are put in order within so many; further ones the compass refuses and counts
LOST = 0.01  # of all messages; single ones are dropped by any link
ELSEWHERE = "image: its stamp is from another time"
CLOCK_SET = "image: its clock was set in mid drive"
HOPELESS = 300  # images, none of them usable, that are tried: ten seconds of what a camera sends before it sees


@dataclass(slots=True)
class BagRecording:
    """A bag as a `Recording`.

    Attributes
    ----------
    bag : Bag
        Open while frames are read.
    choice : TopicChoice
        The topics it came from.
    columns : int
        Width the compass works at; frames are decoded no larger than it needs.
    bottom : float
        Share of the frames' height, from the top, that is looked at; the rest may be left black.
    gyro, odometry, truth
        As read; empty tracks where there is no topic.
    vertical : str
        Where the gyro's vertical came from at the end (see `ImuConfig.up`).
    dropped : Counter of str
        Messages that could not be used, by reason.
    found : list of Warning
        What was wrong with clocks and the IMU.
    vertical_words : str
        Where the gyro's vertical came from at the end, in words.
    witnesses : sequence of Recorded
        When the samples of gyro and tracks were recorded.
    within : Span or None
        Time of the recording by most sensors' stamps.
    window : Span or None
        Part of that time from which frames are given; None: all.
    """

    bag: Bag
    choice: TopicChoice
    columns: int
    gyro: GyroTrack
    odometry: OdometryTrack
    truth: TruthTrack | None
    vertical: str
    dropped: Counter[str] = field(default_factory=Counter)
    found: list[Warning] = field(default_factory=list)
    vertical_words: str = ""
    witnesses: Sequence[Recorded] = ()
    within: Span | None = None
    bottom: float = 1.0
    window: Span | None = None

    @property
    def warnings(self) -> list[Warning]:
        """What is wrong with it as far as it was read, most serious first; messages that are missing included."""
        since_ns = next((int(track.t_ns[0]) for track in (self.gyro, self.odometry) if track.t_ns.size), 0)
        told = list(self.bag.faults)
        # halves of messages and clocks have warnings of their own
        known = NO_GYRO, CLOCK_SET, ELSEWHERE
        dropped = {why: count for why, count in sorted(self.dropped.items()) if not any(one in why for one in known)}
        if sum(dropped.values()) > LOST * sum(topic.count for topic in self.choice):
            told += [f"{count} unusable: {reason}" for reason, count in dropped.items()]
        lost = [Warning("samples_lost", "recording", since_ns, "; ".join(told))] if told else []
        return most_serious_first([*self.found, *lost])

    @property
    def path(self) -> Path:
        """The bag."""
        return self.bag.path

    @property
    def topics(self) -> dict[str, str | None]:
        """The topic of each sensor."""
        choice = self.choice
        named = (("image", choice.image), ("gyro", choice.gyro), ("odometry", choice.odometry), ("truth", choice.truth))
        return {role: topic.name if topic else None for role, topic in named}

    @property
    def frame_count(self) -> int:
        """Images in the bag, usable or not."""
        return self.choice.image.count if self.choice.image else 0

    def frames(self) -> Iterator[Frame]:
        """Panoramas by stamp, decoded ahead in threads."""
        topic = self.choice.image
        if topic is None:
            return
        usable, unusable = 0, 0
        for frame, fault in self._decoded(topic):
            if frame is not None:
                usable += 1
                if self.window is None or self.window.first_ns <= frame.t_ns <= self.window.last_ns:
                    yield frame
                continue
            unusable += 1
            count_reason(self.dropped, f"image: {fault}")
            if not usable and unusable == HOPELESS:
                break
        if unusable and not usable:
            found = f"{self.bag.path}: {topic.name}: no usable image among the first {unusable}: {fault}"
            raise BagError(f"{found}; choose another topic, or none")

    def _decoded(self, topic: Topic) -> Iterator[tuple[Frame | None, str]]:
        """Frames, and why there is none; a video's packets are decoded one after another, as they were recorded."""
        first = next(iter(self.bag.messages(topic.name)), None)
        if first is None or not _is_video(self.bag, first):
            yield from decode_ahead(self._stamped_images(topic), self._decode)
            return
        stream = PictureStream(self.columns)

        def add(message: Message | None) -> list[tuple[Frame | None, str]]:
            try:
                pictures = stream.rest() if message is None else stream.add(self.bag.deserialize(message))
            except (ImageError, MessageError) as error:
                return [(None, str(error))]
            return [(Frame(one.t_ns, one.image, one.encoding), "") for one in pictures]

        for found in decode_ahead(chain(self._of_one_clock(topic), [None]), add, threads=1):
            yield from found

    @property
    def image_span(self) -> Span | None:
        """From the first panorama of the recording's time on, for as long as was recorded."""
        near = self.within.near if self.within else lambda t_ns: np.array(True)
        first = next((t_ns for t_ns in self.image_stamps() if near(np.array(t_ns))), None)
        return None if first is None else Span(first, first + self.bag.end_ns - self.bag.start_ns)

    def image_stamps(self) -> Iterator[int]:
        """Stamps of the panoramas that have any, ns, as recorded."""
        if self.choice.image:
            yield from (m.stamp_ns for m in self.bag.messages(self.choice.image.name) if m.stamp_ns > 0)

    def _stamped_images(self, topic: Topic) -> Iterator[tuple[int, Any]]:
        """Stamps and messages, ordered by stamp within a bounded window."""
        window = self.window
        for message in in_order(self._of_one_clock(topic), FRAMES_OUT_OF_ORDER):
            if window and message.stamp_ns > 0 and not window.first_ns <= message.stamp_ns <= window.last_ns:
                continue
            try:
                yield message.stamp_ns, self.bag.deserialize(message)
            except MessageError as error:
                yield 0, error

    def _of_one_clock(self, topic: Topic) -> Iterator[Message]:
        """Messages of the recording's time, as long as their clock is that of the first one."""
        clock, found = ClockSteps(Sensor.COMPASS, self.witnesses), list(self.found)
        elsewhere: list[int] = []
        for message in self.bag.messages(topic.name):
            t_ns = message.stamp_ns
            if t_ns > 0 and self.within and not self.within.near(np.array(t_ns)):
                elsewhere.append(t_ns)
                self.dropped[ELSEWHERE] += 1
                wrong = [wrong_stamps(Sensor.COMPASS, len(elsewhere), elsewhere[0], self.within)]
            elif t_ns <= 0 or clock.follows(t_ns, message.record_ns):
                yield message
                continue
            else:
                self.dropped[CLOCK_SET] += 1
            self.found = found + clock.warnings() + (wrong if elsewhere else [])

    def _decode(self, stamped: tuple[int, Any]) -> tuple[Frame | None, str]:
        """The frame, or why there is none. Runs in a thread."""
        t_ns, message = stamped
        if isinstance(message, MessageError):
            return None, str(message)
        if t_ns <= 0:
            return None, "header.stamp is zero or negative"
        try:
            image, encoding = image_of(message, self.columns, self.bottom)
        except ImageError as error:
            return None, str(error)
        return Frame(t_ns, image, encoding), ""


def read_recording(
    bag: Bag, choice: TopicChoice, imu: ImuConfig, columns: int, progress: Progress = lambda part: None
) -> BagRecording:
    """Read all small samples of a bag; the panoramas stay in it until `BagRecording.frames` streams them.

    Raises
    ------
    BagError
        The bag is damaged, or all stamps of a topic are zero.
    """
    dropped: Counter[str] = Counter()
    small = [topic for topic in (choice.gyro, choice.odometry, choice.truth) if topic]
    columns_of = {topic.name: Columns(topic) for topic in small}
    total = sum(topic.count for topic in small) or 1
    for count, message in enumerate(bag.messages(*columns_of)):
        columns_of[message.topic].add(bag, message, dropped)
        if count % 1000 == 0:
            progress(count / total)
    progress(1.0)
    level, warnings = ImuLevel(imu), WarningLog()
    choice, within = of_common_time(bag, choice, columns_of, warnings)
    gyro = GyroTrack.of(levelled(sorted_rows(bag, columns_of, choice.gyro, 10), level, warnings))
    if choice.gyro:
        without = len(columns_of[choice.gyro.name].t_ns) - gyro.t_ns.size
        if not gyro.t_ns.size:
            text = f"gyro: none of {choice.gyro.name}'s {without} messages is usable: {NO_GYRO}; it is left out"
            warnings.note([Warning("samples_lost", "gyro", bag.start_ns, text)])
        dropped += Counter({f"{choice.gyro.name}: {NO_GYRO}": without})
    tracks = sorted_rows(bag, columns_of, choice.odometry, 3)
    truth = sorted_rows(bag, columns_of, choice.truth, 3)
    return BagRecording(
        bag,
        choice,
        columns,
        gyro,
        OdometryTrack(tracks[0], *tracks[1].T),
        TruthTrack(truth[0], unwrap(truth[1][:, 2])) if choice.truth else None,
        level.source,
        dropped,
        warnings.all(),
        level.vertical,
        [columns_of[topic.name].recorded for topic in (choice.gyro, choice.odometry) if topic],
        within,
    )


def _is_video(bag: Bag, message: Message) -> bool:
    """Whether a topic's messages are packets of a video, by one of them."""
    try:
        return packet_of(bag.deserialize(message)) is not None
    except (ImageError, MessageError):
        return message.msgtype in VIDEOS


def in_order(messages: Iterable[Message], window: int) -> Iterator[Message]:
    """Messages by stamp, as far as a memory of `window` messages allows; equal stamps keep their order."""
    heap: list[tuple[int, int, Message]] = []
    for count, message in enumerate(messages):
        heapq.heappush(heap, (message.stamp_ns, count, message))
        if len(heap) > window:
            yield heapq.heappop(heap)[2]
    while heap:
        yield heapq.heappop(heap)[2]
