"""Simulated drives: written as bags like any robot's, or fused as they are."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from fusion.checks.warnings import Warning
from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.offline.bag_writer import BagWriter
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack, Progress, TruthTrack
from fusion.offline.topics import TRUTH_TOPIC
from fusion.settings import Settings, absent, in_bag
from fusion.simulation import Drive


class SimulatedRecording:
    """A `Drive` as a `Recording`: the very samples that its bag would hold, but for the JPEG."""

    def __init__(self, drive: Drive, imu: ImuConfig) -> None:
        self.drive = drive
        self.warnings: list[Warning] = []  # none: its sensors are well
        level = ImuLevel(imu)
        readings = (level.sample(r.t_ns, r.angular_velocity, r.linear_acceleration, r.orientation) for r in drive.imu)
        self.gyro = GyroTrack.of(sample for sample in readings if sample)
        rows = np.array([(r.yaw_rate, r.speed, r.yaw) for r in drive.odometry])
        self.odometry = OdometryTrack(np.array([r.t_ns for r in drive.odometry], np.int64), *rows.T)
        self.truth = TruthTrack(drive.truth.t_ns, drive.truth.yaw)

    @property
    def exposed_ns(self) -> dict[int, int]:
        """When each panorama was exposed, by its stamp, ns."""
        return dict(zip(self.drive.frame_t_ns.tolist(), self.drive.frame_truth.t_ns.tolist(), strict=True))

    @property
    def frame_count(self) -> int:
        """Number of panoramas."""
        return len(self.drive)

    def frames(self) -> Iterator[Frame]:
        """The panoramas as the camera gives them."""
        for t_ns, image in self.drive.frames():
            yield Frame(t_ns, image)


def record_drive(drive: Drive, path: Path, settings: Settings, progress: Progress = lambda part: None) -> None:
    """Write a drive as a bag, panoramas as JPEG, the truth as Odometry on ``/ground_truth/odom``; no absent sensor."""
    topics = settings.topics
    frames = (topics.odom_frame, topics.base_frame)
    truth = drive.truth
    kinds = {"image": topics.compass_image, "imu": topics.gyro_topic, "odometry": topics.odometry_topic}
    missing = [kind for kind, topic in kinds.items() if absent(topic)]
    total = len(drive) + len(drive.imu) + len(drive.odometry) + truth.t_ns.size
    with BagWriter(path) as bag:
        for count, (t_ns, kind, what) in enumerate(_messages(drive)):
            if kind in missing:
                continue
            if kind == "image":
                bag.write_jpeg(f"{in_bag(topics.compass_image)}/compressed", t_ns, what)
            elif kind == "imu":
                bag.write_imu(
                    in_bag(topics.gyro_topic), t_ns, what.angular_velocity, what.linear_acceleration, what.orientation
                )
            elif kind == "odometry":
                place = (what.x, what.y, 0.0)
                bag.write_odometry(
                    in_bag(topics.odometry_topic),
                    t_ns,
                    what.yaw,
                    what.yaw_rate,
                    position=place,
                    speed=what.speed,
                    frames=frames,
                )
            else:
                place = (truth.x[what], truth.y[what], 0.0)
                yaw, rate, speed = (float(values[what]) for values in (truth.yaw, truth.yaw_rate, truth.speed))
                bag.write_odometry(TRUTH_TOPIC, t_ns, yaw, rate, position=place, speed=speed, frames=frames)
            progress(count / total)


def _messages(drive: Drive) -> Iterator[tuple[int, str, Any]]:
    """Everything by stamp: when, what kind, and the reading (for the truth its place in the arrays)."""
    return heapq.merge(
        ((reading.t_ns, "imu", reading) for reading in drive.imu),
        ((reading.t_ns, "odometry", reading) for reading in drive.odometry),
        ((t_ns, "truth", index) for index, t_ns in enumerate(drive.truth.t_ns.tolist())),
        ((t_ns, "image", jpeg) for t_ns, jpeg in drive.jpeg_frames()),
        key=itemgetter(0),
    )
