"""What is fused, ordered by ``header.stamp``: small samples as arrays, panoramas as a stream."""

from __future__ import annotations

import heapq
import logging
import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from compass.errors import ImageError
from compass.images.decode import Image
from compass.tilt import Vector
from fusion.buffer.events import Sensor
from fusion.checks.warnings import Warning, WarningLog, most_serious_first
from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.imu.tilt import LATEST_NS, NEAR_NS, up_later
from fusion.messages import NO_GYRO, NOTHING, MessageError, image_of, imu_reading, odometry_sample
from fusion.offline.bag import Bag, BagError, Message, Topic
from fusion.offline.clock_steps import ClockSteps, Recorded
from fusion.offline.decode import decode_ahead
from fusion.offline.stamp_check import Span, clock_warning, of_one_time, usable, wrong_stamps
from fusion.offline.topics import TopicChoice
from fusion.samples import GyroSample, OdometrySample

log = logging.getLogger(__name__)

FRAMES_OUT_OF_ORDER = 8  # images are put in order within so many; further ones the compass refuses and counts
LOST = 0.01  # of all messages; single ones are dropped by any link
FIRST_IMAGES = 20  # of which the stamp in the middle is taken for right
SMALL = (Sensor.GYRO, Sensor.TRACKS)  # read at once
LAST_NS = 2**63 - 1  # that can be written
ELSEWHERE = "image: its stamp is from another time"
CLOCK_SET = "image: its clock was set in mid drive"
MOST_FOREIGN = 3000  # images of another time that are looked through for one of the others' time
HOPELESS = 300  # images, none of them usable, that are tried: ten seconds of what a camera sends before it sees

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]
Progress = Callable[[float], None]  # takes the finished part, 0..1


@dataclass(frozen=True, slots=True)
class GyroTrack:
    """All gyro samples: `t_ns` (N,) sorted, `yaw_rate` (N,) rad/s about the vertical.

    Also `up` (N, 3), `cross_rate` (N,) and `variance` (N,), see `GyroSample`; NaN where unknown.
    """

    t_ns: Times
    yaw_rate: Floats
    up: Floats
    cross_rate: Floats
    variance: Floats

    @staticmethod
    def of(samples: Iterable[GyroSample]) -> GyroTrack:
        """From samples in the order of their stamps."""
        t_ns, values = array("q"), array("d")
        for sample in samples:
            t_ns.append(sample.t_ns)
            cross_rate = np.nan if sample.cross_rate is None else sample.cross_rate
            variance = np.nan if sample.variance is None else sample.variance
            values.extend((sample.yaw_rate, *(sample.up or (np.nan,) * 3), cross_rate, variance))
        rows = np.frombuffer(values, np.float64).reshape(-1, 6)
        return GyroTrack(np.frombuffer(t_ns, np.int64), rows[:, 0], rows[:, 1:4], rows[:, 4], rows[:, 5])

    def until(self, t_ns: int) -> GyroTrack:
        """Up to a stamp, ns."""
        n = int(np.searchsorted(self.t_ns, t_ns, side="right"))
        return GyroTrack(self.t_ns[:n], self.yaw_rate[:n], self.up[:n], self.cross_rate[:n], self.variance[:n])

    def up_at(self, t_ns: int) -> Vector | None:
        """The vertical in the robot's frame at a stamp, ns, as `LeanLog` knows it then."""
        before = int(np.searchsorted(self.t_ns, t_ns - LATEST_NS, side="right")) - 1
        if before < 0 or int(self.t_ns[before]) < t_ns - LATEST_NS - NEAR_NS:
            return None
        x, y, z = self.up[before].tolist()
        seconds = (t_ns - int(self.t_ns[before])) * 1e-9
        return None if math.isnan(x) else up_later((x, y, z), float(self.yaw_rate[before]), seconds)

    def samples(self) -> Iterator[GyroSample]:
        """One by one, for the filter."""
        fields = (self.t_ns, self.yaw_rate, self.up, self.cross_rate, self.variance)
        for t_ns, rate, up, cross_rate, variance in zip(*(column.tolist() for column in fields), strict=True):
            yield GyroSample(
                t_ns,
                rate,
                None if math.isnan(variance) else variance,
                up=None if math.isnan(up[0]) else tuple(up),
                cross_rate=None if math.isnan(cross_rate) else cross_rate,
            )


@dataclass(frozen=True, slots=True)
class OdometryTrack:
    """All odometry samples: `t_ns` (N,) sorted, `yaw_rate` rad/s, `speed` m/s, `yaw` rad (NaN where unknown)."""

    t_ns: Times
    yaw_rate: Floats
    speed: Floats
    yaw: Floats

    def until(self, t_ns: int) -> OdometryTrack:
        """Up to a stamp, ns."""
        n = int(np.searchsorted(self.t_ns, t_ns, side="right"))
        return OdometryTrack(self.t_ns[:n], self.yaw_rate[:n], self.speed[:n], self.yaw[:n])

    def samples(self) -> Iterator[OdometrySample]:
        """One by one, for the filter."""
        for t_ns, *values in zip(self.t_ns, self.yaw_rate, self.speed, self.yaw, strict=True):
            rate, speed, yaw = map(float, values)
            yield OdometrySample(int(t_ns), rate, speed, yaw if np.isfinite(yaw) else None)


@dataclass(frozen=True, slots=True)
class TruthTrack:
    """The true yaw: `t_ns` (N,) sorted, `yaw` (N,) unwrapped, rad."""

    t_ns: Times
    yaw: Floats


@dataclass(frozen=True, slots=True)
class Frame:
    """A panorama: capture time, ns; pixels; their encoding ("" for grey and BGR)."""

    t_ns: int
    image: Image
    encoding: str = ""


class Recording(Protocol):
    """What can be fused: read from a bag, or simulated."""

    @property
    def gyro(self) -> GyroTrack:
        """All gyro samples."""

    @property
    def odometry(self) -> OdometryTrack:
        """All odometry samples."""

    @property
    def truth(self) -> TruthTrack | None:
        """The true yaw, where it is known."""

    @property
    def frame_count(self) -> int:
        """How many panoramas there are, for progress."""

    @property
    def warnings(self) -> Iterable[Warning]:
        """What was found to be wrong with it before it is fused."""

    def frames(self) -> Iterable[Frame]:
        """The panoramas in the order of their stamps; every call starts anew."""


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
    def frame_count(self) -> int:
        """Images in the bag, usable or not."""
        return self.choice.image.count if self.choice.image else 0

    def frames(self) -> Iterator[Frame]:
        """Panoramas by stamp, decoded ahead in threads."""
        topic = self.choice.image
        if topic is None:
            return
        usable, unusable = 0, 0
        for frame, fault in decode_ahead(self._stamped_images(topic), self._decode):
            if frame is not None:
                usable += 1
                yield frame
                continue
            unusable += 1
            self.dropped[f"image: {fault}"] += 1
            if not usable and unusable == HOPELESS:
                break
        if unusable and not usable:
            raise BagError(f"{self.bag.path}: {topic.name}: no usable image among the first {unusable}: {fault}")

    def image_stamps(self) -> Iterator[int]:
        """Stamps of the panoramas that have any, ns, as recorded."""
        if self.choice.image:
            yield from (m.stamp_ns for m in self.bag.messages(self.choice.image.name) if m.stamp_ns > 0)

    def _stamped_images(self, topic: Topic) -> Iterator[tuple[int, Any]]:
        """Stamps and messages, ordered by stamp within a bounded window."""
        for message in in_order(self._of_one_clock(topic), FRAMES_OUT_OF_ORDER):
            yield message.stamp_ns, self.bag.deserialize(message)

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
        if t_ns <= 0:
            return None, "header.stamp is zero or negative"
        try:
            image, encoding = image_of(message, self.columns)
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
    columns_of = {topic.name: _Columns(topic) for topic in small}
    total = sum(topic.count for topic in small) or 1
    for count, message in enumerate(bag.messages(*columns_of)):
        columns_of[message.topic].add(bag, message, dropped)
        if count % 1000 == 0:
            progress(count / total)
    progress(1.0)
    level, warnings = ImuLevel(imu), WarningLog()
    choice, within = _of_one_time(bag, choice, columns_of, warnings)
    gyro = GyroTrack.of(_levelled(_sorted(bag, columns_of, choice.gyro, 10), level, warnings))
    if choice.gyro:
        without = len(columns_of[choice.gyro.name].t_ns) - gyro.t_ns.size
        if not gyro.t_ns.size:
            text = f"gyro: none of {choice.gyro.name}'s {without} messages is usable: {NO_GYRO}; it is left out"
            warnings.note([Warning("samples_lost", "gyro", bag.start_ns, text)])
        dropped += Counter({f"{choice.gyro.name}: {NO_GYRO}": without})
    tracks = _sorted(bag, columns_of, choice.odometry, 3)
    truth = _sorted(bag, columns_of, choice.truth, 3)
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


def _of_one_time(
    bag: Bag, choice: TopicChoice, columns: dict[str, _Columns], log: WarningLog
) -> tuple[TopicChoice, Span | None]:
    """The topics whose stamps have time in common, their samples without those of another time; and that time.

    Raises
    ------
    BagError
        No two of the sensors have time in common.
    """
    topics = {Sensor.GYRO: choice.gyro, Sensor.TRACKS: choice.odometry, Sensor.COMPASS: choice.image}
    spans: dict[Sensor, Span] = {}
    for sensor in SMALL:
        topic = topics[sensor]
        if topic is not None and columns[topic.name].t_ns:
            spans[sensor] = Span.of(columns[topic.name].stamps)
    if choice.image is not None:
        images = _image_span(bag, choice.image, list(spans.values()))
        if images is not None:
            spans[Sensor.COMPASS] = images
    together = of_one_time(spans)
    if len(spans) > 1 and len(together) < 2:
        told = "; ".join(f"{sensor.value} {span.words()}" for sensor, span in spans.items())
        raise BagError(f"{bag.path}: no time in common: {told}; stamp all by one clock, or leave one out (none)")
    whole = (
        Span(min(spans[s].first_ns for s in together), max(spans[s].last_ns for s in together)) if together else None
    )
    if whole is None:
        return choice, None
    foreign = spans.keys() - together
    log.note(clock_warning(sensor, spans[sensor], whole) for sensor in foreign)
    small = {sensor: columns[topic.name] for sensor in SMALL if sensor in together and (topic := topics[sensor])}
    recorded = {sensor: column.recorded for sensor, column in small.items()}
    for sensor, column in small.items():
        others = [one for other, one in recorded.items() if other is not sensor]
        present = [spans[other] for other in together if other is not sensor]
        keep, wrong = usable(sensor, recorded[sensor], whole, others, present, column.told)
        column.only(keep)
        log.note(wrong)
    fields = {Sensor.GYRO: "gyro", Sensor.TRACKS: "odometry", Sensor.COMPASS: "image"}
    return replace(choice, **{fields[sensor]: None for sensor in foreign}), whole


def _image_span(bag: Bag, topic: Topic, others: Sequence[Span]) -> Span | None:
    """From the first images on, and on for as long as was recorded after them.

    Where these are of another time than all others, from the first one of the others' time on.
    """
    images = ((m.stamp_ns, m.record_ns) for m in bag.messages(topic.name) if m.stamp_ns > 0)
    first = list(islice(images, FIRST_IMAGES))
    if not first:
        return None

    def until_the_end(stamp_ns: int, record_ns: int) -> Span:
        return Span(stamp_ns, stamp_ns + max(bag.end_ns - record_ns, 0))

    span = until_the_end(*first[len(first) // 2])
    if others and not any(span.meets(other) for other in others):
        more = islice(images, MOST_FOREIGN)
        found = (one for one in more if any(Span(one[0], one[0]).meets(other) for other in others))
        return next((until_the_end(*one) for one in found), span)
    return span


def in_order(messages: Iterable[Message], window: int) -> Iterator[Message]:
    """Messages by stamp, as far as a memory of `window` messages allows; equal stamps keep their order."""
    heap: list[tuple[int, int, Message]] = []
    for count, message in enumerate(messages):
        heapq.heappush(heap, (message.stamp_ns, count, message))
        if len(heap) > window:
            yield heapq.heappop(heap)[2]
    while heap:
        yield heapq.heappop(heap)[2]


def unwrap(yaw: Floats) -> Floats:
    """Unwrapped yaw, rad; unknown (NaN) yaws stay so and do not spoil the others."""
    unwrapped = yaw.copy()
    known = np.isfinite(yaw)
    unwrapped[known] = np.unwrap(yaw[known])
    return unwrapped


class _Columns:
    """Samples of one topic while they are read, as plain numbers."""

    def __init__(self, topic: Topic) -> None:
        self._convert = _imu_row if topic.msgtype.endswith("Imu") else _odometry_row
        self.t_ns, self.record_ns = array("q"), array("q")
        self.values = array("d")
        self.fault = ""

    def add(self, bag: Bag, message: Message, dropped: Counter[str]) -> None:
        try:
            t_ns, row = self._convert(bag.deserialize(message))
        except MessageError as error:
            self.fault = str(error)
            dropped[f"{message.topic}: {error}"] += 1
            return
        self.t_ns.append(t_ns)
        self.record_ns.append(min(max(message.record_ns, 0), LAST_NS))
        self.values.extend(row)

    @property
    def stamps(self) -> Times:
        """In the order of recording."""
        return np.array(self.t_ns, np.int64)

    @property
    def recorded(self) -> Recorded:
        """The stamps, and when they were recorded."""
        return Recorded(np.array(self.record_ns, np.int64), self.stamps)

    @property
    def told(self) -> npt.NDArray[np.bool_]:
        """Which say anything of a turn: messages of an IMU may bring the accelerometer's half only."""
        rows = np.array(self.values).reshape(len(self.t_ns), -1)
        return np.nan_to_num(rows[:, :3]).any(axis=1) if self._convert is _imu_row else np.ones(len(rows), bool)

    def only(self, keep: npt.NDArray[np.bool_]) -> None:
        """Leave out the others."""
        if not keep.all():
            rows = np.array(self.values).reshape(keep.size, -1)[keep]
            self.record_ns = array("q", np.array(self.record_ns, np.int64)[keep].tolist())
            self.t_ns, self.values = array("q", self.stamps[keep].tolist()), array("d", rows.ravel().tolist())


def _imu_row(message: Any) -> tuple[int, tuple[float, ...]]:
    reading = imu_reading(message)
    rate, force = reading.angular_velocity or NOTHING, reading.linear_acceleration or NOTHING
    return reading.t_ns, (*rate, *force, *(reading.orientation or (np.nan,) * 4))


def _odometry_row(message: Any) -> tuple[int, tuple[float, ...]]:
    sample = odometry_sample(message)
    return sample.t_ns, (sample.yaw_rate, sample.speed, np.nan if sample.yaw is None else sample.yaw)


def _sorted(bag: Bag, columns: dict[str, _Columns], topic: Topic | None, width: int) -> tuple[Times, Floats]:
    """Stamps and rows of a topic by stamp; `BagError` when none of its messages was usable."""
    if topic is None:
        return np.zeros(0, np.int64), np.zeros((0, width))
    read = columns[topic.name]
    if not read.t_ns:
        raise BagError(f"{bag.path}: {topic.name}: none of its {topic.count} messages is usable: {read.fault}")
    t_ns = np.frombuffer(read.t_ns, np.int64)
    order = np.argsort(t_ns, kind="stable")
    return t_ns[order], np.frombuffer(read.values, np.float64).reshape(-1, width)[order]


def _levelled(columns: tuple[Times, Floats], level: ImuLevel, log: WarningLog) -> Iterator[GyroSample]:
    """Every reading in the order of time, as the live node does it; what is wrong with the IMU goes into `log`."""
    known: tuple[Warning, ...] = ()
    for t_ns, row in zip(columns[0].tolist(), columns[1].tolist(), strict=True):
        sample = level.sample(t_ns, row[:3], row[3:6], row[6:])
        if level.warnings() is not known:
            known = level.warnings()
            log.note(known)
        if sample is not None:
            yield sample
