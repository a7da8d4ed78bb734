"""Where the robot is: the tracks' speed, summed up along the fused yaw, and how far wrong that may be."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
import numpy.typing as npt

from fusion.config import FusionConfig
from fusion.samples import OdometrySample, YawEstimate

SILENT_NS = 500_000_000  # since the last speed; what the robot does then is not known
CORRECTED = 0.5  # a variance of the yaw that falls to less than this part of itself was corrected: it is no noise


@dataclass(frozen=True, slots=True)
class Speed:
    """A speed along the robot's x axis and its error, which lasts for a while.

    Attributes
    ----------
    value : float
        m/s, positive forward.
    sigma : float
        Standard deviation of its error, m/s.
    lasts : float
        Correlation time of that error, s.
    """

    value: float
    sigma: float
    lasts: float


@dataclass(frozen=True, slots=True)
class Position:
    """A position by dead reckoning in the frame in which the yaw counts, with the covariance of its error.

    To first order a step d along the yaw errs by d n dpsi + f ds: across it (n, to the left) by the error of the yaw,
    along it (f, forward) by that of the distance. The error of the yaw lasts; its covariance with the position is
    carried along, as in an extended Kalman filter with the position in its state (Thrun, Burgard, Fox: Probabilistic
    Robotics, 2005, section 5.4).

    Attributes
    ----------
    x, y : float
        m.
    xx, xy, yy : float
        Covariance by slip and by the yaw, m^2.
    x_yaw, y_yaw, yaw_yaw : float
        Covariances with the error of the yaw, m rad, and the variance of that, rad^2.
    begin : tuple of float
        Where the summing began, m: what a wrong scale of the speed does grows with the way from there.
    """

    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0
    x_yaw: float = 0.0
    y_yaw: float = 0.0
    yaw_yaw: float = 0.0
    begin: tuple[float, float] = (0.0, 0.0)

    def moved(self, seconds: float, yaw: float, yaw_variance: float, speed: Speed) -> Position:
        """The position after `seconds` at a speed, along `yaw`, rad, whose variance is `yaw_variance`, rad^2."""
        before = self._known_to(yaw_variance)
        fx, fy = math.cos(yaw), math.sin(yaw)
        d = speed.value * seconds
        nx, ny = -d * fy, d * fx
        slip = 2.0 * speed.lasts * seconds * speed.sigma**2  # of the integral over a Gauss-Markov process
        cx, cy, variance = before.x_yaw, before.y_yaw, before.yaw_yaw
        return replace(
            before,
            x=self.x + d * fx,
            y=self.y + d * fy,
            xx=self.xx + 2.0 * cx * nx + nx * nx * variance + slip * fx * fx,
            xy=self.xy + cx * ny + cy * nx + nx * ny * variance + slip * fx * fy,
            yy=self.yy + 2.0 * cy * ny + ny * ny * variance + slip * fy * fy,
            x_yaw=cx + nx * variance,
            y_yaw=cy + ny * variance,
        )

    def _known_to(self, yaw_variance: float) -> Position:
        """The same with the yaw's present variance.

        What adds to it is new; where it was corrected, less of it is what made the position wrong.
        """
        if CORRECTED * self.yaw_yaw <= yaw_variance <= self.yaw_yaw:
            return self
        kept = math.sqrt(yaw_variance / self.yaw_yaw) if yaw_variance < self.yaw_yaw else 1.0
        return replace(self, x_yaw=self.x_yaw * kept, y_yaw=self.y_yaw * kept, yaw_yaw=yaw_variance)

    def covariance(self, scale_sigma: float) -> npt.NDArray[np.float64]:
        """Covariance of x and y, shape (2, 2), m^2, where the scale of all speeds is wrong by `scale_sigma`."""
        way = np.array([self.x - self.begin[0], self.y - self.begin[1]])
        total: npt.NDArray[np.float64] = np.array([[self.xx, self.xy], [self.xy, self.yy]])
        return total + scale_sigma**2 * np.outer(way, way)


@dataclass(frozen=True, slots=True)
class Place:
    """Where the robot is and how fast, as far as the tracks tell.

    Attributes
    ----------
    x, y : float
        m, in the frame in which the yaw counts.
    covariance : (2, 2) array of float
        Of both, m^2.
    speed, speed_variance : float
        Along the robot's x axis, m/s and (m/s)^2.
    """

    x: float
    y: float
    covariance: npt.NDArray[np.float64]
    speed: float
    speed_variance: float


class DeadReckoning:
    """Sums up the tracks' speed along the fused yaw, estimate by estimate.

    A yaw that is corrected afterwards, by an image that came late, does not move the way that was gone before.

    Parameters
    ----------
    config : FusionConfig
        How the tracks slip.
    """

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Start anew from the origin; whether the tracks tell a speed has to show again."""
        self._position = Position()
        self._speeds: list[OdometrySample] = []  # the newest that is over, and those since
        self._fastest = 0.0  # m/s; above zero once the tracks have told a speed
        self._last: YawEstimate | None = None

    def set_position(self, x: float, y: float, covariance: tuple[float, float, float]) -> None:
        """Say where the robot is now, m, and the covariance xx, xy, yy of that, m^2; its yaw may be set, too."""
        self._position = Position(x, y, *covariance, begin=(x, y))

    def add(self, sample: OdometrySample) -> None:
        """Take in what the tracks say."""
        if not self._speeds or sample.t_ns > self._speeds[-1].t_ns:
            self._speeds.append(sample)
            self._fastest = max(self._fastest, abs(sample.speed))

    def at(self, estimate: YawEstimate) -> Place | None:
        """Where the robot is at the time of an estimate; None as long as the tracks have never told a speed."""
        last, self._last = self._last, estimate
        if not self._fastest or last is None:
            return None
        for sample, since_ns, until_ns in self._legs(last.t_ns, estimate.t_ns):
            ago = (estimate.t_ns - 0.5 * (since_ns + until_ns)) * 1e-9
            speed = self._speed(sample, until_ns, slipping=estimate.slip)
            yaw = estimate.yaw - ago * estimate.yaw_rate
            self._position = self._position.moved((until_ns - since_ns) * 1e-9, yaw, estimate.heading_variance, speed)
        scale = self._config.speed_scale_sigma
        speed = self._speed(self._speeds[-1], estimate.t_ns, slipping=estimate.slip)
        variance = speed.sigma**2 + (scale * speed.value) ** 2
        return Place(self._position.x, self._position.y, self._position.covariance(scale), speed.value, variance)

    def _legs(self, since_ns: int, until_ns: int) -> Iterator[tuple[OdometrySample, int, int]]:
        """Each sample that tells the speed between two times, with the part of that time for which it does."""
        for sample, after in zip_longest(self._speeds, self._speeds[1:]):
            begin_ns = max(since_ns, sample.t_ns)
            end_ns = until_ns if after is None else min(until_ns, after.t_ns)
            if begin_ns < end_ns:
                yield sample, begin_ns, end_ns
        self._speeds = self._speeds[-1:]

    def _speed(self, sample: OdometrySample, t_ns: int, *, slipping: bool) -> Speed:
        """What is known of the speed: while the tracks slip next to nothing, while they are silent nothing."""
        silent_ns = t_ns - sample.t_ns
        if silent_ns > SILENT_NS:
            return Speed(0.0, self._fastest, silent_ns * 1e-9)  # as long as it goes on it is the same
        share = 1.0 if slipping else self._config.speed_slip
        return Speed(sample.speed, share * abs(sample.speed), self._config.slip_time)
