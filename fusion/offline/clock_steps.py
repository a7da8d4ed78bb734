"""A clock that is set forward or back while the recorder runs: what comes after goes by another time.

Sorted by stamp such samples would fall among those of another moment. The order of recording tells: between two
messages of a sensor no more time can have passed than the other sensors, or the recorder, saw pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion.buffer.events import Sensor
from fusion.checks.warnings import Warning

Times = npt.NDArray[np.int64]
YEAR_2200_NS = 7_258_118_400_000_000_000
STEP_NS = 1_000_000_000  # links and queues delay by less
FEWEST = 3  # samples of another time that are worth a word
MOST = 4  # steps of one clock; with more of them the order of recording is that of no time


@dataclass(frozen=True, slots=True)
class Recorded:
    """Stamps of a sensor by the time at which they were recorded, ns; both (N,), in the order of recording."""

    record_ns: Times
    t_ns: Times

    def only(self, keep: npt.NDArray[np.bool_]) -> Recorded:
        """Those that are true in a mask (N,)."""
        return Recorded(self.record_ns[keep], self.t_ns[keep])

    def passed_ns(self, before_ns: int, after_ns: int) -> int | None:
        """From the last stamp recorded before a time to the next after another; None without one on either side."""
        first = int(np.searchsorted(self.record_ns, before_ns, side="left")) - 1
        last = int(np.searchsorted(self.record_ns, after_ns, side="right"))
        return int(self.t_ns[last] - self.t_ns[first]) if 0 <= first < last < self.t_ns.size else None

    @property
    def as_fast(self) -> bool:
        """Whether the recorder's clock went about as fast as the stamps: it does not in a bag that was put together."""
        if self.t_ns.size < 3:
            return False
        return float(np.ptp(self.record_ns)) >= 0.5 * float(np.median(np.diff(self.t_ns))) * self.t_ns.size


class ClockSteps:
    """Follows one sensor's stamps in the order of recording.

    Parameters
    ----------
    sensor : Sensor
        Whose stamps they are.
    witnesses : sequence of Recorded
        The others.
    own : Recorded, optional
        Its own samples, where they are known beforehand. The recorder is a witness, too, where its clock went as fast
        as all of these.
    """

    def __init__(self, sensor: Sensor, witnesses: Sequence[Recorded], own: Recorded | None = None) -> None:
        self._sensor, self._witnesses = sensor, witnesses
        known = [*witnesses, *([own] if own else [])]
        self._recorder = bool(known) and all(one.as_fast for one in known)
        self._last: tuple[int, int] | None = None
        self._since_ns = self._off_ns = self._first_off_ns = self._steps = self.count = 0
        self._wrong_before = False

    def follows(self, t_ns: int, record_ns: int) -> bool:
        """Take in the next stamp; whether it is of the time that the first one was of."""
        if not 0 < record_ns < YEAR_2200_NS:
            return True  # its place means nothing
        if self._last is not None:
            self._step(*self._last, t_ns, record_ns)
        self._last = t_ns, record_ns
        follows = abs(self._off_ns) <= STEP_NS or self._steps > MOST
        self.count += not follows
        return follows

    def following(self, own: Recorded, present: Sequence[tuple[int, int]] = ()) -> npt.NDArray[np.bool_]:
        """Which of all its samples are of the right time, (N,).

        That is where it began, unless only later ones fall into a time of another sensor: `present`, from when to when,
        ns. A clock that is set as the drive begins was wrong before, one that is set in mid drive is wrong after.
        """
        offs = []
        for stamp in zip(own.t_ns.tolist(), own.record_ns.tolist(), strict=True):
            self.follows(*stamp)
            offs.append(self._off_ns)
        self.count = 0
        if self._steps > MOST:
            return np.ones(len(offs), bool)
        times = [np.abs(np.array(offs) - off) <= STEP_NS for off in dict.fromkeys(offs)]
        middles = [int(np.median(own.t_ns[mask])) for mask in times]
        common = [any(first <= t <= last for first, last in present) for t in middles]
        right = common.index(True) if True in common else 0
        self._wrong_before = right > 0
        self.count = len(offs) - int(np.count_nonzero(times[right])) if offs else 0
        return times[right] if offs else np.ones(0, bool)

    def _step(self, last_ns: int, recorded_ns: int, t_ns: int, record_ns: int) -> None:
        step_ns = t_ns - last_ns
        if abs(step_ns) <= STEP_NS:
            return
        claims = [one.passed_ns(recorded_ns, record_ns) for one in self._witnesses]
        passed = [ns for ns in claims if ns is not None] + [record_ns - recorded_ns] * self._recorder
        if passed and abs(step_ns - max(passed)) > STEP_NS:
            self._off_ns += step_ns - max(passed)
            self._steps += 1
            if not self._first_off_ns:
                self._since_ns, self._first_off_ns = last_ns, self._off_ns

    def warnings(self) -> list[Warning]:
        """Whether samples had to be left out."""
        if self.count < FEWEST or self._steps > MOST:
            return []
        way = "forward" if self._first_off_ns > 0 else "back"
        when = "before" if self._wrong_before else "after"
        text = (
            f"{self._sensor.value}: its clock was set {way} by {abs(self._first_off_ns) * 1e-9:.3g} s in mid drive, by "
            f"the order of recording; {self.count} samples of {when} that are left out: set the clock before you record"
        )
        return [Warning("clock_mismatch", self._sensor.value, self._since_ns, text)]
