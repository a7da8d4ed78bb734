"""Sensors of whose samples the filter's gate refuses most."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

from fusion.buffer.events import Sensor
from fusion.checks.gate import SensorReport
from fusion.checks.warnings import Warning

TALLY_NS = 10_000_000_000  # as long as tracks may slip before the filter opens their scale
SHORTEST_TALLY_NS = 3_000_000_000  # thrice `recovery_time`, after which the filter listens to a refused sensor again
REFUSED_SHARE = 0.5  # of an honest sensor's samples the gate refuses 1e-4
REMEDIES = {
    Sensor.GYRO: "check its mount, units and stamps",
    Sensor.TRACKS: "they slip, or their sign, scale or stamps are wrong",
    Sensor.COMPASS: "check the images' stamps, that they turn with the robot, and that they are not mirrored",
}

Tally = tuple[int, int, int]  # stamp, ns; samples judged so far; those of them that were refused


class RefusalWatch:
    """Compares how many samples of each sensor the gate judged and refused lately."""

    def __init__(self) -> None:
        self._tallies: dict[Sensor, deque[Tally]] = {sensor: deque() for sensor in Sensor}
        self._since_ns: dict[Sensor, int] = {}  # of those that are refused at present

    def clear(self) -> None:
        """Forget all."""
        self._since_ns.clear()
        for tallies in self._tallies.values():
            tallies.clear()

    def warnings(self, reports: Mapping[Sensor, SensorReport | None], others: Iterable[Warning]) -> list[Warning]:
        """Sensors that are refused at present, given the newest reports; not those that `others` name already."""
        known = {name for warning in others for name in warning.sensors}
        now_ns = max((report.t_ns for report in reports.values() if report), default=0)
        found = []
        for sensor, report in reports.items():
            if report is not None:
                self._note(sensor, report, now_ns)
            warning = self._judge(sensor)
            if warning and sensor.value not in known:
                found.append(warning)
        return found

    def _note(self, sensor: Sensor, report: SensorReport, now_ns: int) -> None:
        """Add the newest tally and forget those that have left the window."""
        tallies, judged = self._tallies[sensor], report.accepted + report.rejected + report.recovered
        if tallies and judged < tallies[-1][1]:
            tallies.clear()  # the filter started anew
        if not tallies:
            tallies.append((report.t_ns, 0, 0))
        if judged > tallies[-1][1]:
            tallies.append((report.t_ns, judged, report.rejected))
        while len(tallies) > 1 and tallies[1][0] <= now_ns - TALLY_NS:
            tallies.popleft()

    def _judge(self, sensor: Sensor) -> Warning | None:
        tallies = self._tallies[sensor]
        if not tallies:
            return None
        (first_ns, judged_before, refused_before), (last_ns, judged, refused) = tallies[0], tallies[-1]
        judged, refused, seconds = judged - judged_before, refused - refused_before, (last_ns - first_ns) * 1e-9
        if last_ns - first_ns < SHORTEST_TALLY_NS or refused <= REFUSED_SHARE * judged:
            self._since_ns.pop(sensor, None)
            return None
        first_refused_ns = next(t_ns for t_ns, _, count in tallies if count > refused_before)
        since_ns = self._since_ns.setdefault(sensor, first_refused_ns)
        text = (
            f"{refused} of {judged} samples within {seconds:.0f} s were refused: the turn they measure contradicts the"
            f" other sensors; {REMEDIES[sensor]}"
        )
        return Warning("sensor_refused", sensor.value, since_ns, text)
