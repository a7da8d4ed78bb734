"""What is fused, by time: gyro, odometry and truth as arrays, panoramas as a stream."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
import numpy.typing as npt

from compass.images.decode import Image
from compass.tilt import Vector
from fusion.checks.warnings import Warning
from fusion.imu.tilt import NEAR_NS, SETTLED_NS, up_later
from fusion.samples import GyroSample, OdometrySample

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]
Progress = Callable[[float], None]  # takes the finished part, 0..1


@dataclass(frozen=True, slots=True)
class GyroTrack:
    """All gyro samples: `t_ns` (N,) sorted, `yaw_rate` (N,) rad/s about the vertical.

    Also `up` (N, 3), `cross_rate` (N,), `variance` (N,) and `factor_sigma` (N,), see `GyroSample`; NaN where unknown.
    """

    t_ns: Times
    yaw_rate: Floats
    up: Floats
    cross_rate: Floats
    variance: Floats
    factor_sigma: Floats

    @staticmethod
    def of(samples: Iterable[GyroSample]) -> GyroTrack:
        """From samples in the order of their stamps."""
        t_ns, values = array("q"), array("d")
        for sample in samples:
            t_ns.append(sample.t_ns)
            cross_rate = np.nan if sample.cross_rate is None else sample.cross_rate
            variance = np.nan if sample.variance is None else sample.variance
            up = sample.up or (np.nan,) * 3
            values.extend((sample.yaw_rate, *up, cross_rate, variance, sample.factor_sigma))
        rows = np.frombuffer(values, np.float64).reshape(-1, 7)
        return GyroTrack(np.frombuffer(t_ns, np.int64), rows[:, 0], rows[:, 1:4], *rows[:, 4:].T)

    def until(self, t_ns: int) -> GyroTrack:
        """Up to a stamp, ns."""
        n = int(np.searchsorted(self.t_ns, t_ns, side="right"))
        return GyroTrack(*(getattr(self, one.name)[:n] for one in fields(self)))

    def up_at(self, t_ns: int) -> Vector | None:
        """The vertical in the robot's frame at a stamp, ns, as `TiltLog` knows it then."""
        latest_ns = t_ns - SETTLED_NS
        first, after = (int(i) for i in np.searchsorted(self.t_ns, (latest_ns - NEAR_NS, latest_ns + 1)))
        columns = (column[first:after].tolist() for column in (self.t_ns, self.up, self.yaw_rate))
        found = max((sample for sample in zip(*columns, strict=True) if not math.isnan(sample[1][0])), default=None)
        return found and up_later(tuple(found[1]), found[2], (t_ns - found[0]) * 1e-9)

    def samples(self) -> Iterator[GyroSample]:
        """One by one, for the filter."""
        columns = (getattr(self, one.name).tolist() for one in fields(self))
        for t_ns, rate, up, cross_rate, variance, factor_sigma in zip(*columns, strict=True):
            yield GyroSample(
                t_ns,
                rate,
                None if math.isnan(variance) else variance,
                up=None if math.isnan(up[0]) else tuple(up),
                cross_rate=None if math.isnan(cross_rate) else cross_rate,
                factor_sigma=factor_sigma,
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


def unwrap(yaw: Floats) -> Floats:
    """Unwrapped yaw, rad; unknown (NaN) yaws stay so and do not spoil the others."""
    unwrapped = yaw.copy()
    known = np.isfinite(yaw)
    unwrapped[known] = np.unwrap(yaw[known])
    return unwrapped
