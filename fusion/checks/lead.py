"""By how much the stamps of a sensor lead the others', and whether its clock has jumped ahead of theirs.

Where a sensor pauses, the others go on meanwhile; where only its clock is set forward, its stamps jump, too, but the
others have made none of that way. A link of the others that hangs lets its lead grow as well, but without a gap in its
own stamps. After a gap samples are held back until another sensor has spoken; if it has not caught up, and until it
does, they are not believed.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from statistics import median

from compass import YawIncrement
from fusion.buffer.events import Sample, Sensor, sensor_of
from fusion.checks.silence import FEWEST_GAPS, PERIOD_GAPS, SILENT_NS
from fusion.checks.stamps import ABANDONED_NS, PAUSE_SHARE

JITTER_NS = 100_000_000  # of arrival; shorter gaps and leads are those of links and queues; not derived
OVERDUE = 2  # periods after which a sensor that still goes by the time before would have spoken; not derived
MOST_HELD = 4000  # samples, ten seconds of a gyro at 400 Hz: bounds the memory


@dataclass(slots=True)
class Lead:
    """Stamps of one sensor, ns: the newest that is believed, the gaps between, and its leads as others spoke next."""

    newest_ns: int
    fresh: bool = True  # nobody else has spoken since
    gaps: deque[int] = field(default_factory=lambda: deque(maxlen=PERIOD_GAPS))
    leads: deque[int] = field(default_factory=lambda: deque(maxlen=PERIOD_GAPS))

    @property
    def period_ns(self) -> int | None:
        """From one sample to the next; None before it is known."""
        return round(median(self.gaps)) if len(self.gaps) >= FEWEST_GAPS else None

    @property
    def known(self) -> bool:
        """Whether enough is known of its lead."""
        return len(self.leads) == PERIOD_GAPS

    @property
    def jitter_ns(self) -> int:
        """By how much its lead varies, in the order of arrival."""
        return max(JITTER_NS, max(self.leads, default=0) - min(self.leads, default=0))

    def jumps(self, t_ns: int, others_ns: int) -> bool:
        """Whether a stamp leads the others' by more than it ever did of late, and by more than that varies."""
        return t_ns - others_ns - max(self.leads) > self.jitter_ns


class LeadWatch:
    """Holds samples back whose stamps have jumped ahead of all others, until the others are there, too."""

    def __init__(self) -> None:
        self._leads: dict[Sensor, Lead] = {}
        self._held: dict[Sensor, deque[Sample]] = {}  # in the order of arrival
        self._against: set[Sensor] = set()  # who has spoken since from the time before
        self._wrong_ns: set[int] = set()  # stamps of images before a clock was set back again

    def holds(self, sample: Sample) -> bool:
        """Whether a sample is not to be believed, or not yet; it is kept then."""
        sensor, t_ns = sensor_of(sample), sample.t_ns
        lead = self._leads.get(sensor)
        if isinstance(sample, YawIncrement) and sample.t_ref_ns in self._wrong_ns:
            return True
        if lead is None:
            return False
        gap_ns = t_ns - lead.newest_ns
        if sensor not in self._held and (gap_ns <= JITTER_NS or gap_ns - (lead.period_ns or 0) <= JITTER_NS):
            return False
        others_ns = self._newest_of_others(sensor)
        if others_ns is None:
            return False
        # as long as its lead is not known, it has jumped where others have
        jumped = lead.jumps(t_ns, others_ns) if lead.known else bool(self._held) and t_ns - others_ns > SILENT_NS
        if not jumped:
            return False
        self._held.setdefault(sensor, deque(maxlen=MOST_HELD)).append(sample)
        self._against.discard(sensor)
        return True

    @property
    def opposed(self) -> bool:
        """Whether another sensor has spoken since, and goes on as before."""
        return bool(self._against)

    def hear(self, sensor: Sensor, t_ns: int) -> list[Sample]:
        """Note the stamp of a sample that is believed, and let those of its sensor go that waited until then."""
        lead = self._leads.get(sensor) or self._leads.setdefault(sensor, Lead(t_ns))
        if t_ns > lead.newest_ns:
            lead.gaps.append(t_ns - lead.newest_ns)
            lead.newest_ns, lead.fresh = t_ns, True
        for other, one in self._leads.items():
            if one.fresh and other is not sensor and self._newest_of_others(other) == t_ns:
                one.leads.append(one.newest_ns - t_ns)
                one.fresh = False
        held = _joined(self._held.pop(sensor), t_ns) if sensor in self._held else []
        self._against = self._against | {sensor} if self._held else set()
        if held and held[-1].t_ns - t_ns > lead.jitter_ns:  # the others have not caught up: its clock was set back
            self._wrong_ns = {one.t_ns for one in held if isinstance(one, YawIncrement)}
            return []
        return held

    def deserted(self, *, at_end: bool = False) -> list[Sample]:
        """Let all go where all have jumped, and where nobody goes on at the time before: that is the time now."""
        if self._against or not self._held:
            return []
        groups = [_joined(held, held[-1].t_ns) for held in self._held.values()]
        first_ns, last_ns = min(group[0].t_ns for group in groups), max(group[-1].t_ns for group in groups)
        if last_ns - min(group[-1].t_ns for group in groups) > SILENT_NS:
            return []  # each is somewhere else: single wrong stamps
        silent = [self._leads[one].period_ns or 0 for one in self._alive() if one not in self._held]
        jump_ns = first_ns - max(lead.newest_ns for lead in self._leads.values())
        # a burst of wrong stamps is no time that has passed, and a short pause is likelier than a long one
        enough_ns = max(OVERDUE * max(silent, default=0), min(jump_ns // PAUSE_SHARE, ABANDONED_NS))
        if silent and not at_end and last_ns - first_ns < enough_ns:
            return []
        self._held.clear()
        return sorted((one for group in groups for one in group), key=attrgetter("t_ns"))

    def _newest_of_others(self, sensor: Sensor) -> int | None:
        """Of those that are not silent; None where all are."""
        others = [lead.newest_ns for one, lead in self._leads.items() if one is not sensor]
        if not others:
            return None
        newest_ns = max(others)
        return newest_ns if newest_ns >= self._leads[sensor].newest_ns - SILENT_NS else None

    def _alive(self) -> Iterator[Sensor]:
        newest_ns = max((lead.newest_ns for lead in self._leads.values()), default=0)
        return (one for one, lead in self._leads.items() if lead.newest_ns >= newest_ns - SILENT_NS)


def _joined(samples: Iterable[Sample], t_ns: int) -> list[Sample]:
    """Those that are joined with a stamp, ns, by gaps in which a sensor is not silent, in the order of their stamps."""
    ordered = sorted(samples, key=attrgetter("t_ns"))
    place = bisect_left(ordered, t_ns, key=attrgetter("t_ns"))
    first, last, at = place, place, t_ns
    while first > 0 and at - ordered[first - 1].t_ns <= SILENT_NS:
        first, at = first - 1, ordered[first - 1].t_ns
    at = t_ns
    while last < len(ordered) and ordered[last].t_ns - at <= SILENT_NS:
        last, at = last + 1, ordered[last].t_ns
    return ordered[first:last]
