"""Sensors that stop while the others go on, and samples that are missing in between."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from statistics import median

from fusion.buffer.events import Sensor
from fusion.checks.warnings import Warning

# A sensor not heard for so long is silent: twice what a link may hold a sample back; a slow camera gives an image a
# second.
SILENT_NS = 1_000_000_000
# Of gyro or tracks: their turn since then is unknown. Of all: a robot of two turns a second may have turned round.
RATE_SILENT_NS = 500_000_000
PERIODS = 3  # of the sensor; one of 1 Hz is not silent after a second
PERIOD_GAPS = 20  # gaps that a sensor's period is the median of; not derived
FEWEST_GAPS = 5  # of them before it is known
MISSING = 5  # periods without a sample are no jitter; not derived
OFTEN = 3  # such pauses, within
# Not derived: `PAUSES_NS`.
PAUSES_NS = 10_000_000_000


@dataclass(slots=True)
class Voice:
    """When a sensor spoke: its newest stamp, the gaps between its last ones and its pauses, ns."""

    newest_ns: int
    gaps: deque[int] = field(default_factory=lambda: deque(maxlen=PERIOD_GAPS))
    pauses: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=PERIOD_GAPS))

    def hear(self, t_ns: int) -> None:
        """Take in a stamp; one that comes late may fall into what seemed to be a pause."""
        gap_ns = t_ns - self.newest_ns
        if gap_ns <= 0:
            self._split(t_ns)
            return
        if len(self.gaps) >= FEWEST_GAPS and gap_ns > MISSING * min(self.gaps) and gap_ns > MISSING * median(self.gaps):
            self.pauses.append((self.newest_ns, t_ns))
        self.gaps.append(gap_ns)
        self.newest_ns = t_ns

    def _split(self, t_ns: int) -> None:
        """Keep what is left of the pause around a stamp."""
        for pause in self.pauses:
            if pause[0] < t_ns < pause[1]:
                parts = (pause[0], t_ns), (t_ns, pause[1])
                left = [part for part in parts if part[1] - part[0] > MISSING * median(self.gaps)]
                self.pauses = deque([*(one for one in self.pauses if one != pause), *left], maxlen=PERIOD_GAPS)
                return

    def longest_ns(self) -> int:
        """How long it may say nothing."""
        return max(SILENT_NS, round(PERIODS * median(self.gaps))) if self.gaps else 2 * SILENT_NS


class SilenceWatch:
    """Names sensors that have stopped, and rate sensors of which samples are missing again and again.

    Images that are missing are counted where they are read; here a pause of the compass may be one of the light.
    """

    def __init__(self) -> None:
        self._voices: dict[Sensor, Voice] = {}

    def hear(self, sensor: Sensor, t_ns: int) -> None:
        """Note the stamp, ns, of a sample that is believed."""
        voice = self._voices.get(sensor)
        if voice is None:
            self._voices[sensor] = Voice(t_ns)
        else:
            voice.hear(t_ns)

    def warnings(self, known: Collection[str] = ()) -> list[Warning]:
        """What is missing at present; not of the sensors named in `known`, whose stamps are wrong."""
        now_ns = max((voice.newest_ns for voice in self._voices.values()), default=0)
        found = (_judge(sensor, voice, now_ns) for sensor, voice in self._voices.items() if sensor.value not in known)
        return [warning for warning in found if warning]


def _judge(sensor: Sensor, voice: Voice, now_ns: int) -> Warning | None:
    silent_ns = now_ns - voice.newest_ns
    if silent_ns > SILENT_NS and silent_ns > voice.longest_ns():
        text = (
            f"{sensor.value}: nothing usable for {silent_ns * 1e-9:.1f} s while the others go on; the yaw goes on "
            "without it: check the sensor, its driver and its link"
        )
        return Warning("sensor_silent", sensor.value, voice.newest_ns, text)
    if sensor is Sensor.COMPASS:
        return None
    pauses = [pause for pause in voice.pauses if pause[1] > now_ns - PAUSES_NS]
    if len(pauses) < OFTEN:
        return None
    longest = max(end - start for start, end in pauses) * 1e-9
    text = (
        f"{sensor.value}: {len(pauses)} pauses of up to {longest:.2g} s within {PAUSES_NS * 1e-9:.0f} s: samples are "
        "lost; check its link, and the queue sizes of driver and recorder"
    )
    return Warning("samples_lost", sensor.value, pauses[0][0], text)
