"""Whether the stamps of a recording's sensors are of one time, before anything is fused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion.buffer.events import Sensor
from fusion.checks.stamps import StampSequence
from fusion.checks.warnings import Warning
from fusion.offline.clock_steps import FEWEST, STEP_NS, ClockSteps, Recorded

Times = npt.NDArray[np.int64]
DAY_NS = 86_400_000_000_000  # longer than a drive
BACKWARDS = 0.75  # of all steps; of two publishers that take turns half go back; not derived
NEIGHBOURS = 2  # to either side, by whose stamps and its own a stamp is judged: two wrong ones in a row are found
MOST_LONE = 0.1  # of all; with more of them the order of recording is that of no time; not derived
MARGIN_NS = 60_000_000_000  # beyond all else in the recording; stamps further off are from another time


@dataclass(frozen=True, slots=True)
class Span:
    """From when to when a sensor speaks, ns."""

    first_ns: int
    last_ns: int

    @staticmethod
    def of(t_ns: Times) -> Span:
        """Of stamps of which some may be wrong: the middle half, and as much again to both sides.

        Where days lie between them, of the more frequent ones.
        """
        ordered = np.sort(t_ns)
        ages = np.split(ordered, np.flatnonzero(np.diff(ordered) > DAY_NS) + 1)
        low, high = (int(x) for x in np.quantile(max(ages, key=len), (0.25, 0.75), method="nearest"))
        return Span(low - (high - low), high + (high - low))

    def meets(self, other: Span) -> bool:
        """Whether they have any time in common."""
        return self.first_ns <= other.last_ns and other.first_ns <= self.last_ns

    def near(self, t_ns: Times) -> npt.NDArray[np.bool_]:
        """Which stamps lie within, or `MARGIN_NS` from it."""
        return (t_ns >= self.first_ns - MARGIN_NS) & (t_ns <= self.last_ns + MARGIN_NS)

    def words(self) -> str:
        """In seconds, or as a date where it is one."""
        if self.first_ns < 10**18:  # before September 2001: no date of a recording, but a time since power-up
            return f"{self.first_ns * 1e-9:.0f} to {self.last_ns * 1e-9:.0f} s"
        return f"{np.datetime64(self.first_ns, 'ns').astype('datetime64[s]')} to {self.last_ns * 1e-9:.0f} s"


def of_one_time(spans: Mapping[Sensor, Span]) -> set[Sensor]:
    """The most sensors whose spans all meet one of them; fewer than two where no two have time in common."""
    groups = [{other for other, span in spans.items() if span.meets(one)} for one in spans.values()]
    return max(groups, key=len, default=set())


def clock_warning(sensor: Sensor, span: Span, others: Span) -> Warning:
    """On a sensor that is left out."""
    text = (
        f"{sensor.value}: stamped {span.words()}, while the others are stamped {others.words()}: no time in common, "
        "so it is left out; stamp all sensors by one clock"
    )
    return Warning("clock_mismatch", sensor.value, others.first_ns, text)


def usable(
    sensor: Sensor,
    recorded: Recorded,
    within: Span,
    others: Sequence[Recorded],
    present: Sequence[Span],
    told: npt.NDArray[np.bool_],
) -> tuple[npt.NDArray[np.bool_], list[Warning]]:
    """Which samples to use, of a sensor's in the order of recording, and what was wrong with the stamps of the rest.

    `others` are what the other sensors recorded, as far as it was read, and `present` when each of them spoke.
    Samples that are false in `told` (N,) tell nothing of a turn, and may share their stamp with one that does.
    """
    t_ns, near = recorded.t_ns, within.near(recorded.t_ns)
    near &= ~_lone(t_ns)
    own, sequence, keep = recorded.only(near), StampSequence(sensor), near.copy()
    clock = ClockSteps(sensor, [one.only(within.near(one.t_ns)) for one in others], own)
    keep[near] = clock.following(own, [(span.first_ns, span.last_ns) for span in present])
    judged = keep & told
    keep[judged] = [sequence.fits(one) for one in t_ns[judged].tolist()]
    warnings = clock.warnings() + sequence.warnings() + _backwards(sensor, own.t_ns)
    if not near.all():
        warnings.append(wrong_stamps(sensor, int(np.count_nonzero(~near)), int(t_ns[~near][0]), within))
    return keep, warnings


def _lone(t_ns: Times) -> npt.NDArray[np.bool_]:
    """Stamps (N,) that are off from those recorded just before and after them: a clock that is set comes in steps.

    Each is compared with the median of itself and its neighbours, which at a gap is itself.
    """
    if t_ns.size <= 2 * NEIGHBOURS:
        return np.zeros(t_ns.size, bool)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(t_ns, NEIGHBOURS, "edge"), 2 * NEIGHBOURS + 1)
    lone = np.abs(t_ns - np.median(around, axis=1).astype(np.int64)) > STEP_NS
    return lone if np.count_nonzero(lone) <= MOST_LONE * t_ns.size else np.zeros(t_ns.size, bool)


def _backwards(sensor: Sensor, t_ns: Times) -> list[Warning]:
    """On stamps that run backwards in the order of recording: sorted, they would seem to be in order."""
    back = int(np.count_nonzero(np.diff(t_ns) < 0))
    if back < max(FEWEST, BACKWARDS * (t_ns.size - 1)):
        return []
    text = (
        f"{sensor.value}: {back} of {t_ns.size} stamps are older than the one recorded before them, so that its turns "
        "come in the wrong order; see to the driver's clock"
    )
    return [Warning("stamps_not_increasing", sensor.value, int(t_ns.min()), text)]


def wrong_stamps(sensor: Sensor, count: int, example_ns: int, within: Span) -> Warning:
    """On so many of a sensor's stamps that are from another time than the recording."""
    example = Span(example_ns, example_ns).words()
    text = (
        f"{sensor.value}: {count} stamps are from another time, such as {example}, and were left out: see to the "
        "driver's clock"
    )
    return Warning("stamps_wrong", sensor.value, within.first_ns, text)
