"""Times in which nobody measured how the robot turned."""

from __future__ import annotations

from collections.abc import Iterator

from fusion.checks.silence import SILENT_NS
from fusion.checks.warnings import Warning

# Not derived: `PATIENCE_NS`, `MOST_GAPS`.
PATIENCE_NS = 500_000_000  # in which a late sample may fall into the gap, or an increment reach across it
MOST_GAPS = 100  # gaps that are remembered

Gap = tuple[int, int]  # from the last stamp before to the first after, ns


class GapWatch:
    """Finds gaps that no sensor has spoken in and no increment has reached across."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None
        self._open: list[Gap] = []
        self._jump: Gap | None = None

    def jumped(self, from_ns: int, to_ns: int) -> None:
        """Note that time itself went back, ns: nobody knows for how long."""
        self._jump = from_ns, to_ns

    def hear(self, t_ns: int, since_ns: int | None = None) -> None:
        """Note the stamp, ns, of a sample that is believed, and since when it measures how the robot turned."""
        newest_ns = t_ns if self._newest_ns is None else self._newest_ns
        if t_ns - newest_ns > SILENT_NS:  # shorter pauses the model of motion bridges, at a sigma of some degrees
            self._open.append((newest_ns, t_ns))
            del self._open[:-MOST_GAPS]
        if self._open and t_ns <= newest_ns:
            self._open = [part for gap in self._open for part in _without(gap, t_ns)]
        if self._open and since_ns is not None:
            self._open = [gap for gap in self._open if not (since_ns <= gap[0] and gap[1] <= t_ns)]
        self._newest_ns = max(newest_ns, t_ns)

    def warnings(self) -> list[Warning]:
        """The gaps so far."""
        if self._jump:
            from_ns, to_ns = self._jump
            text = (
                f"all stamps went back by {(from_ns - to_ns) * 1e-9:.4g} s (a clock that was set, a recording played "
                "again?); how the robot turned meanwhile is unknown, and in the yaw's sigma since"
            )
            return [Warning("turn_lost", "recording", to_ns, text)]
        newest_ns = self._newest_ns or 0
        gaps = [gap for gap in self._open if gap[1] <= newest_ns - PATIENCE_NS]
        if not gaps:
            return []
        longest = max(end - start for start, end in gaps) * 1e-9
        times = "once" if len(gaps) == 1 else f"{len(gaps)} times, the longest"
        text = (
            f"no sensor measured how the robot turned, {times} for {longest:.2g} s; what it turned meanwhile is"
            " unknown, and in the yaw's sigma since: find out why all of them paused (recorder, disk, network, clock)"
        )
        return [Warning("turn_lost", "recording", gaps[0][0], text)]


def _without(gap: Gap, t_ns: int) -> Iterator[Gap]:
    """What is left of a gap around a stamp."""
    if not gap[0] < t_ns < gap[1]:
        yield gap
        return
    for part in ((gap[0], t_ns), (t_ns, gap[1])):
        if part[1] - part[0] > SILENT_NS:
            yield part
