"""Samples that are no measurement at all: not finite, impossible, stamped before 1970."""

from __future__ import annotations

from collections import Counter

from fusion.buffer.events import Sensor
from fusion.checks.warnings import Warning

FEWEST = 3  # a single one is a glitch, or what a link delivers twice; and
SHARE = 0.01  # of all; neither is derived


def is_frequent(faults: int, samples: int) -> bool:
    """Whether so many of the samples are at fault that a user has to know."""
    return faults >= max(FEWEST, SHARE * samples)


class FaultWatch:
    """Counts the samples of each sensor that cannot be used, whatever the filter thinks."""

    def __init__(self) -> None:
        self._heard: Counter[Sensor] = Counter()
        self._faults: dict[Sensor, Counter[str]] = {}
        self._since_ns: dict[Sensor, int] = {}

    def note(self, sensor: Sensor, t_ns: int, fault: str | None) -> None:
        """Take in a sample, and what makes it unusable."""
        self._heard[sensor] += 1
        if fault:
            self._faults.setdefault(sensor, Counter())[fault] += 1
            self._since_ns.setdefault(sensor, t_ns)

    def warnings(self) -> list[Warning]:
        """Sensors of which too much is unusable."""
        return [
            self._words(sensor, faults)
            for sensor, faults in self._faults.items()
            if is_frequent(faults.total(), self._heard[sensor])
        ]

    def _words(self, sensor: Sensor, faults: Counter[str]) -> Warning:
        reasons = ", ".join(f"{count} {fault}" for fault, count in faults.most_common())
        text = (
            f"{sensor.value}: {faults.total()} of {self._heard[sensor]} samples are no measurement and were left out: "
            f"{reasons}; see to the driver"
        )
        return Warning("samples_lost", sensor.value, self._since_ns[sensor], text)
