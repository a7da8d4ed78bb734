"""Which stamps to believe: whose clock is another, when time itself has jumped, and stamps that do not increase.

A sample far ahead of all others, believed at once, would make everything after it too old; ten old ones in a burst, as
a link delivers that hung for a while, are no jump back. Time jumps where more than one sensor says so, or all that are
left, and for long enough.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from statistics import median

from fusion.buffer.events import Sample, Sensor, sensor_of
from fusion.checks.faulty import is_frequent
from fusion.checks.silence import PERIOD_GAPS, SILENT_NS
from fusion.checks.warnings import Warning

# Not derived: `LONE_NS`, `MAJORITY_NS`, `ABANDONED_NS`, `STAMPS_NS`.
LONE_NS = 200_000_000  # of stamps by the only sensor there is
MAJORITY_NS = 800_000_000  # by two of three
ABANDONED_NS = 5_000_000_000  # by anyone, while nobody is left at the time that was
PAUSE_SHARE = 20  # a jump of time is believed after samples that span one part in so many of it; not derived
BACKLOG_NS = 10_000_000_000  # backwards, where two of three may be a link's backlog; more than its queues hold
MOST_WAITING = 4000  # samples, ten seconds of all sensors
MISMATCHES = 20  # samples in a row from another time: not a link that hung, but a clock; not derived


@dataclass(slots=True)
class Elsewhen:
    """Samples from another time than that of the filter, ahead of it or behind, in the order of arrival.

    Attributes
    ----------
    ahead : bool
    patience_ns : int
        How far the others may go on before a sample is given up; those that it waits for may come late.
    samples : deque of (Sample, int)
        With the newest stamp that the filter had when they came.
    against : set of Sensor
        Who has spoken at the filter's own time since the first of them.
    since : dict of Sensor to int
        The newest stamp that the filter had when each sensor began to speak from there only, ns.
    """

    ahead: bool
    patience_ns: int
    samples: deque[tuple[Sample, int]] = field(default_factory=lambda: deque(maxlen=MOST_WAITING))
    against: set[Sensor] = field(default_factory=set)
    since: dict[Sensor, int] = field(default_factory=dict)

    def add(self, sample: Sample, newest_ns: int) -> None:
        """Let one more wait."""
        if not self.samples:
            self.against.clear()
        self.samples.append((sample, newest_ns))
        self.since.setdefault(sensor_of(sample), newest_ns)

    def opposed(self, sensor: Sensor, newest_ns: int) -> None:
        """Note that a sensor spoke at the filter's own time: its stamps from elsewhen were wrong."""
        self.since.pop(sensor, None)
        if self.samples:
            self.against.add(sensor)
            kept = ((s, n) for s, n in self.samples if sensor_of(s) is not sensor and n >= newest_ns - self.patience_ns)
            self.samples = deque(kept, maxlen=MOST_WAITING)

    def believed(self, heard: dict[Sensor, int], newest_ns: int, reach_ns: int) -> bool:
        """Whether it is time that has jumped, to where the last of them is.

        `heard` is the newest stamp of each sensor that the filter took; two of different sensors confirm each other if
        they are no further apart than `reach_ns`.
        """
        alive = {sensor for sensor, t_ns in heard.items() if t_ns >= newest_ns - SILENT_NS} | self.against
        group = self._neighbours(reach_ns if len(alive) > 1 else ABANDONED_NS)
        sensors = {sensor_of(sample) for sample in group}
        span_ns = group[-1].t_ns - group[0].t_ns
        missing = len(alive - sensors)
        if not missing:
            return span_ns >= LONE_NS or (self.ahead and len(sensors) > 1)
        jump_ns = abs(group[0].t_ns - newest_ns)
        # a short pause is likelier than a long one
        abandoned_ns = min(max(LONE_NS, jump_ns // PAUSE_SHARE), ABANDONED_NS)
        if not self.against and span_ns >= (abandoned_ns if self.ahead else BACKLOG_NS):
            return True
        return len(sensors) > max(missing, 1) and span_ns >= (MAJORITY_NS if self.ahead else BACKLOG_NS)

    def _neighbours(self, gap_ns: int) -> list[Sample]:
        """Those that are joined with the last one by gaps no longer than that, in the order of their stamps."""
        last = self.samples[-1][0]
        group: list[Sample] = []
        for one in sorted((sample for sample, _ in self.samples), key=lambda sample: sample.t_ns):
            if group and one.t_ns - group[-1].t_ns > gap_ns:
                if group[-1].t_ns >= last.t_ns:
                    break
                group = []
            group.append(one)
        return group

    def leave(self, reach_ns: int) -> list[Sample]:
        """Let the last one and its neighbours go, in the order of their stamps; the rest is forgotten."""
        samples = self._neighbours(reach_ns)
        self.samples.clear()
        self.since.clear()
        return samples

    def caught_up(self, reach_ns: int) -> list[Sample]:
        """Let those go whose stamps are not beyond `reach_ns` any more, in the order of their stamps.

        But not those of a sensor that kept ahead while the others went on: they had not stopped, its clock is another.
        """
        if not self.samples:
            return []
        near = [(sample, newest_ns) for sample, newest_ns in self.samples if sample.t_ns <= reach_ns]
        if near:
            kept = ((sample, newest_ns) for sample, newest_ns in self.samples if sample.t_ns > reach_ns)
            self.samples = deque(kept, maxlen=MOST_WAITING)
        caught = (sample for sample, newest_ns in near if newest_ns - self.since[sensor_of(sample)] <= SILENT_NS)
        return sorted(caught, key=lambda sample: sample.t_ns)


def confirmed(samples: Iterable[Sample]) -> bool:
    """Whether samples near each other are of two sensors, or go on for long enough."""
    stamps = [(sample.t_ns, sensor_of(sample)) for sample in samples]
    span_ns = max(t for t, _ in stamps) - min(t for t, _ in stamps)
    return span_ns >= LONE_NS or len({sensor for _, sensor in stamps}) > 1


@dataclass(slots=True)
class Mismatch:
    """How many samples in a row a sensor has sent from another time, since when, and how far off the last was, ns."""

    since_ns: int
    count: int = 0
    off_ns: int = 0


class ClockWatch:
    """Names sensors whose samples all come from another time."""

    def __init__(self) -> None:
        self._mismatches: dict[Sensor, Mismatch] = {}

    def mismatch(self, sensor: Sensor, t_ns: int, newest_ns: int) -> None:
        """Note a sample from another time."""
        known = self._mismatches.setdefault(sensor, Mismatch(newest_ns))
        known.count, known.off_ns = known.count + 1, t_ns - newest_ns

    def well(self, sensor: Sensor) -> None:
        """Note a sample from the filter's own time."""
        self._mismatches.pop(sensor, None)

    def warnings(self) -> list[Warning]:
        """Clocks that are others at present."""
        found = self._mismatches.items()
        return [_mismatch(sensor, mismatch) for sensor, mismatch in found if mismatch.count >= MISMATCHES]


def _mismatch(sensor: Sensor, mismatch: Mismatch) -> Warning:
    seconds = mismatch.off_ns * 1e-9
    text = (
        f"{sensor.value}: stamps are {abs(seconds):.4g} s {'ahead of' if seconds > 0 else 'behind'} the others'; "
        f"none of its last {mismatch.count} samples is used: stamp all sensors by one clock"
        + (", or raise fusion.lag_window" if -60.0 < seconds < 0.0 else "")
    )
    return Warning("clock_mismatch", sensor.value, mismatch.since_ns, text)


STAMPS_NS = 2_000_000_000  # of its stamps that are remembered
ORDERED = 50  # stamps of a sensor without one that goes back, before those that do are its clock's; not derived
# Of a period: a late sample has at least so much room to both sides, else there is one at its place already.
FILLS = 0.6


class StampSequence:
    """Watches whether the stamps of one sensor increase, in the order of arrival.

    A sample that comes late fills a gap. One whose stamp lies among others of the same sensor that were there before is
    from a clock that was set back, and would be sorted into what it does not belong to.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._stamps: list[int] = []
        self._gaps: deque[int] = deque(maxlen=PERIOD_GAPS)
        self._newest_ns = -1
        self._since_ns = 0
        self._again: tuple[int, int, int] | None = None  # first and last stamp that went back, and the newest before
        self.count = self.refused = 0

    @property
    def went_back(self) -> bool:
        """Whether a clock that went well was set back just now: a stretch of time comes a second time."""
        if self._again is None:
            return False
        first_ns, last_ns, newest_ns = self._again
        return last_ns - first_ns >= LONE_NS // 2 and self._newest_ns - newest_ns <= SILENT_NS

    def fits(self, t_ns: int) -> bool:
        """Take in a stamp, ns; whether there is room for it."""
        self.count += 1
        place = bisect_left(self._stamps, t_ns)
        fits = t_ns > self._newest_ns or self._room(t_ns, place)
        if fits:
            self._gaps.append(t_ns - self._newest_ns)
            self._newest_ns = max(self._newest_ns, t_ns)
            self._stamps.insert(place, t_ns)
            if self._stamps[0] < self._newest_ns - 2 * STAMPS_NS:
                del self._stamps[: bisect_left(self._stamps, self._newest_ns - STAMPS_NS)]
        else:
            self._since_ns = self._since_ns or self._newest_ns
            if self._again is None and self.count > ORDERED and not self.refused:
                self._again = t_ns, t_ns, self._newest_ns
            elif self._again is not None and t_ns > self._again[1]:
                self._again = self._again[0], t_ns, self._again[2]
            self.refused += 1
        return fits

    def _room(self, t_ns: int, place: int) -> bool:
        neighbours = [abs(one - t_ns) for one in self._stamps[max(place - 1, 0) : place + 1]]
        nearest = min(neighbours, default=STAMPS_NS)
        if nearest == 0 or len(self._gaps) < PERIOD_GAPS:
            return nearest > 0
        period = median(self._gaps)
        steady = all(0.5 * period <= gap <= 2.0 * period for gap in self._gaps)
        return not steady or nearest >= FILLS * period

    def warnings(self) -> list[Warning]:
        """Whether it is worth saying."""
        if not is_frequent(self.refused, self.count):
            return []
        text = (
            f"{self._sensor.value}: {self.refused} of {self.count} stamps repeat or go back to where samples were: "
            "not used; see to the driver's clock, and that only one node publishes the topic"
        )
        return [Warning("stamps_not_increasing", self._sensor.value, self._since_ns, text)]
