"""What the compass makes of a recording's panoramas, one by one: all that filter and rows need of them."""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from operator import attrgetter
from typing import TYPE_CHECKING

from compass import CompassConfig, CompassStatus, YawIncrement
from compass.mount import CameraMount
from compass.tilt import Vector
from fusion.checks.images import image_warnings
from fusion.checks.warnings import Warning
from fusion.imu.tilt import TiltLog
from fusion.offline.streams import Frame, Recording
from fusion.samples import GyroSample

if TYPE_CHECKING:
    from fusion.settings import Settings

# Results that are taken at a time, as the filter finds its cache cold after each wait. One by one it takes 1.16 times
# as much processor time, a run 1.02 times (docs/lab-notes/bursts-2026-11-30.md).
BURST = 8

Upright = tuple[Frame, Vector | None]  # a panorama, and the vertical in the robot's frame, where it is known


@dataclass(frozen=True, slots=True)
class ImageResult:
    """What the compass made of one panorama.

    Attributes
    ----------
    t_ns : int
        Its stamp.
    status : CompassStatus
        Outcome of the update.
    increment, long_baseline : YawIncrement or None
        The turn since the keyframe, and that since a view some seconds ago, where it was due.
    yaw, yaw_variance : float
        Accumulated, rad, and its variance, rad^2.
    warnings : tuple of Warning
        What is known from then on to be wrong with the images.
    mount : CameraMount
        How the camera is tilted on the robot, as known by then.
    """

    t_ns: int
    status: CompassStatus
    increment: YawIncrement | None
    long_baseline: YawIncrement | None
    yaw: float
    yaw_variance: float
    warnings: tuple[Warning, ...]
    mount: CameraMount

    def increments(self) -> list[YawIncrement]:
        """All that the filter is given."""
        return [one for one in (self.increment, self.long_baseline) if one is not None]


Measure = Callable[[Iterable[Upright]], Iterator[ImageResult]]


def measured_by(config: CompassConfig) -> Measure:
    """A compass that is given the vertical with each panorama."""
    from compass import VisualCompass  # type: ignore[attr-defined,unused-ignore]

    vertical: Vector | None = None
    compass = VisualCompass(config, lambda t_ns: vertical)

    def measure(frames: Iterable[Upright]) -> Iterator[ImageResult]:
        nonlocal vertical
        for frame, up in frames:
            vertical = up
            increment = compass.update(frame.t_ns, frame.image, frame.encoding)
            long_baseline, warnings = compass.long_baseline(), tuple(image_warnings(compass))
            found = increment, long_baseline, compass.yaw, compass.yaw_variance
            yield ImageResult(frame.t_ns, compass.status, *found, warnings, compass.mount)

    return measure


class ImageResults:
    """The results of a recording's panoramas by their stamps; it may be gone through once.

    They do not depend on the filter, so that `measure` may be ahead of whoever takes them, by some results at least.

    Parameters
    ----------
    recording : Recording
        What is measured.
    settings : Settings
        Of the compass, and how late the camera's stamps are.
    measure : callable, optional
        The compass; one of its own in this process, where there is none.

    Attributes
    ----------
    counts : Counter of CompassStatus
        Outcomes so far.
    mount : CameraMount
        How the camera is tilted on the robot, by the last result.
    warnings : sequence of Warning
        What was wrong with the recording as far as it had been read for the last result.
    """

    def __init__(self, recording: Recording, settings: Settings, measure: Measure | None = None) -> None:
        self._recording = recording
        # the delay as given: what is learnt beyond it would depend on who came late
        self._known_ns = round(1e9 * settings.fusion.camera_delay)
        self._measured = (measure or measured_by(settings.compass))(self._upright())
        self._ready: deque[ImageResult] = deque()
        self._warnings: deque[tuple[Warning, ...]] = deque()  # of the panoramas that are under way or ready
        self.counts: Counter[CompassStatus] = Counter()
        self.mount = CameraMount()
        self.warnings: tuple[Warning, ...] = ()

    def measure_ahead_while(self, busy: Callable[[], bool]) -> None:
        """Begin already, until whoever takes the results is no longer busy elsewhere."""
        while busy() and (result := next(self._measured, None)) is not None:
            self._ready.append(result)

    def __iter__(self) -> Iterator[ImageResult]:
        for result in chain(_emptied(self._ready), _in_bursts(self._measured)):
            self.warnings = self._warnings.popleft()
            self.counts[result.status] += 1
            self.mount = result.mount
            yield result
        self.warnings = tuple(self._recording.warnings)

    def _upright(self) -> Iterator[Upright]:
        """Panoramas with the vertical that `YawPipeline` knows when it is given all samples by their stamps."""
        tilts, streams = TiltLog(), (self._recording.gyro.samples(), self._recording.frames())
        events: Iterable[GyroSample | Frame] = heapq.merge(*streams, key=attrgetter("t_ns"))
        for event in events:
            if isinstance(event, Frame):
                self._warnings.append(tuple(self._recording.warnings))
                yield event, tilts.at(event.t_ns - self._known_ns)
            else:
                tilts.add(event)


def _emptied(ready: deque[ImageResult]) -> Iterator[ImageResult]:
    while ready:
        yield ready.popleft()


def _in_bursts(results: Iterator[ImageResult]) -> Iterator[ImageResult]:
    """The same, some of them ready before the first is given."""
    while burst := list(islice(results, BURST)):
        yield from burst
