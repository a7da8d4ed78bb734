"""Samples of a topic while a bag is read, as plain numbers; sorted and levelled once all are known."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.checks.warnings import Warning, WarningLog
from fusion.imu.levelling import ImuLevel
from fusion.messages import NO_VECTOR, MessageError, imu_reading, odometry_sample
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import Message, Topic
from fusion.offline.clock_steps import Recorded
from fusion.offline.streams import Floats, Times
from fusion.samples import GyroSample

LAST_NS = 2**63 - 1  # that can be written


class Columns:
    """Samples of one topic while they are read, as plain numbers."""

    def __init__(self, topic: Topic) -> None:
        self._convert = _imu_row if topic.msgtype.endswith("Imu") else _odometry_row
        self.t_ns, self.record_ns = array("q"), array("q")
        self.values = array("d")
        self.fault = ""

    def add(self, bag: Bag, message: Message, dropped: Counter[str]) -> None:
        """Take a message; one that is unusable is counted in `dropped` by its fault."""
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
    rate, force = reading.angular_velocity or NO_VECTOR, reading.linear_acceleration or NO_VECTOR
    return reading.t_ns, (*rate, *force, *(reading.orientation or (np.nan,) * 4))


def _odometry_row(message: Any) -> tuple[int, tuple[float, ...]]:
    sample = odometry_sample(message)
    return sample.t_ns, (sample.yaw_rate, sample.speed, np.nan if sample.yaw is None else sample.yaw)


def sorted_rows(bag: Bag, columns: dict[str, Columns], topic: Topic | None, width: int) -> tuple[Times, Floats]:
    """Stamps and rows of a topic by stamp; `BagError` when none of its messages was usable."""
    if topic is None:
        return np.zeros(0, np.int64), np.zeros((0, width))
    read = columns[topic.name]
    if not read.t_ns:
        raise BagError(
            f"{bag.path}: {topic.name}: none of its {topic.count} messages is usable: {read.fault}; choose another "
            "topic, or none"
        )
    t_ns = np.frombuffer(read.t_ns, np.int64)
    order = np.argsort(t_ns, kind="stable")
    return t_ns[order], np.frombuffer(read.values, np.float64).reshape(-1, width)[order]


def levelled(columns: tuple[Times, Floats], level: ImuLevel, log: WarningLog) -> Iterator[GyroSample]:
    """Every reading in the order of time, as the live node does it; what is wrong with the IMU goes into `log`."""
    known: tuple[Warning, ...] = ()
    for t_ns, row in zip(columns[0].tolist(), columns[1].tolist(), strict=True):
        sample = level.sample(t_ns, row[:3], row[3:6], row[6:])
        if level.warnings() is not known:
            known = level.warnings()
            log.note(known)
        if sample is not None:
            yield sample
