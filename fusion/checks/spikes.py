"""Samples of a rate sensor that stand out from those before and after."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median

from compass import wrap_angle
from fusion.buffer.events import Sensor
from fusion.checks.rate_turn import COMES_BACK, FASTEST_CHANGE, FASTEST_ROBOT
from fusion.checks.silence import FEWEST_GAPS, OFTEN, PAUSES_NS, PERIOD_GAPS
from fusion.checks.warnings import Warning
from fusion.samples import GyroSample, OdometrySample

USUAL = 10.0  # medians of the changes between samples: normal noise exceeds 7 once in a million
LONGEST_SPIKE_NS = round(1e9 * FASTEST_ROBOT / FASTEST_CHANGE)  # after which a robot may turn at any rate


@dataclass(slots=True)
class SpikeTrain:
    """The spikes of one sensor: its last sample that was none, those that have gone off since, and those of late.

    Attributes
    ----------
    t_ns : int
        Newest stamp.
    steady_ns, steady_rate : int, float
        The last sample that was no spike, rad/s.
    steps : deque of float
        By how much the rate changed between the last such samples, rad/s.
    off : list of (int, float)
        Samples since: stamp, by how much they are off, rad/s.
    found : deque of (int, float)
        Spikes that have come back.
    """

    t_ns: int
    steady_ns: int
    steady_rate: float
    steps: deque[float] = field(default_factory=lambda: deque(maxlen=PERIOD_GAPS))
    off: list[tuple[int, float]] = field(default_factory=list)
    found: deque[tuple[int, float]] = field(default_factory=deque)

    def hear(self, t_ns: int, rate: float) -> None:
        """Take in a sample, rad/s; one that comes late is left out."""
        if t_ns <= self.t_ns:
            return
        self.t_ns, off = t_ns, abs(rate - self.steady_rate)
        if off > FASTEST_CHANGE * (t_ns - self.steady_ns) * 1e-9 and off > self._usual():
            self.off.append((t_ns, off))
            if t_ns - self.steady_ns <= LONGEST_SPIKE_NS:
                return
            self.off.clear()  # it stays there: no spike
        elif self.off and off < COMES_BACK * max(size for _, size in self.off):
            self.found += self.off
        if not self.off:
            self.steps.append(off)
        self.off.clear()
        self.steady_ns, self.steady_rate = t_ns, rate
        while self.found and self.found[0][0] <= t_ns - PAUSES_NS:
            self.found.popleft()

    def _usual(self) -> float:
        """What the rate of this sensor changes by without turning, at most, rad/s; infinite until that is known."""
        return USUAL * median(self.steps) if len(self.steps) >= FEWEST_GAPS else math.inf


class SpikeWatch:
    """Names sensors of which single samples stand out again and again.

    Parameters
    ----------
    by_poses : bool
        Whether the odometry's poses count, where it has any, and not its rates.
    """

    def __init__(self, *, by_poses: bool) -> None:
        self._by_poses = by_poses
        self._trains: dict[Sensor, SpikeTrain] = {}
        self._pose: OdometrySample | None = None

    def hear(self, sensor: Sensor, sample: GyroSample | OdometrySample) -> None:
        """Note a sample whose stamp is believed."""
        rate = sample.yaw_rate if isinstance(sample, GyroSample) else self._rate_of(sample)
        train = self._trains.get(sensor)
        if train is None:
            self._trains[sensor] = SpikeTrain(sample.t_ns, sample.t_ns, rate)
        else:
            train.hear(sample.t_ns, rate)

    def _rate_of(self, sample: OdometrySample) -> float:
        """By which the tracks turn from one sample to the next, rad/s."""
        before, self._pose = self._pose, sample
        if not self._by_poses or before is None or before.yaw is None or sample.yaw is None:
            return sample.yaw_rate
        seconds = (sample.t_ns - before.t_ns) * 1e-9
        return float(wrap_angle(sample.yaw - before.yaw)) / seconds if seconds > 0.0 else sample.yaw_rate

    def warnings(self) -> list[Warning]:
        """The spikes of late."""
        return [_words(sensor, train.found) for sensor, train in self._trains.items() if len(train.found) >= OFTEN]


def _words(sensor: Sensor, found: deque[tuple[int, float]]) -> Warning:
    largest = max(size for _, size in found)
    text = (
        f"{sensor.value}: {len(found)} samples within {PAUSES_NS * 1e-9:.0f} s stand out by up to {largest:.3g} rad/s"
        " from those before and after, as no robot turns to and back from; single ones are refused, and what it turned"
        " meanwhile is missing: check the sensor's bus, cable and driver, and its mount where the robot is shaken"
    )
    return Warning("sensor_spikes", sensor.value, found[0][0], text)
