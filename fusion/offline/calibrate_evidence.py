"""What a recording has to show for itself: frames worth looking at, and findings with their evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fusion.offline.open_recording import FileRecording
from fusion.offline.scores import YawTrack, yaw_at
from fusion.offline.streams import Frame

TURN_STEP = math.radians(20.0)  # between frames that show the body: a window moves by its width and more
MOST_TURNED, MOST_PAIRS = 60, 40
STRIDE = (0.05, 0.4)  # m driven between the images of a pair
STEADY = math.radians(1.0)  # most turning in a pair
STILL = 1e-3  # m/s and rad/s by the tracks


@dataclass(slots=True)
class Evidence:
    """Frames worth looking at.

    Attributes
    ----------
    turned : list of Frame
        Each `TURN_STEP` of yaw from the one before.
    straight : list of (Frame, Frame)
        Driven straight ahead between the two.
    still : list of (Frame, Frame)
        Neighbours at standstill.
    """

    turned: list[Frame] = field(default_factory=list)
    straight: list[tuple[Frame, Frame]] = field(default_factory=list)
    still: list[tuple[Frame, Frame]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Finding:
    """A proposed parameter by its dotted name, and the evidence in words; `value` None: nothing could be found."""

    name: str
    value: float | str | None
    evidence: str

    def __str__(self) -> str:
        """One line of the report."""
        value = "not found" if self.value is None else self.value if isinstance(self.value, str) else f"{self.value:g}"
        return f"{self.name}: {value} ({self.evidence})"


def gather(recording: FileRecording, shown: YawTrack) -> Evidence:
    """Look through all frames once and keep those that tell something; `shown` is the yaw by their stamps."""
    evidence, last, kept_yaw = Evidence(), None, math.inf
    for frame in recording.frames():
        yaw = float(yaw_at(shown, np.array([frame.t_ns]))[0])
        if abs(yaw - kept_yaw) > TURN_STEP and len(evidence.turned) < MOST_TURNED:
            evidence.turned.append(frame)
            kept_yaw = yaw
        if last is None:
            last = frame
            continue
        motion = _motion(recording, shown, last.t_ns, frame.t_ns)
        if motion is not None and motion.still and len(evidence.still) < MOST_PAIRS:
            evidence.still.append((last, frame))
        if motion is not None and motion.steady and motion.way < STRIDE[0]:
            continue  # wait for the pair's second image
        if motion is not None and motion.steady and motion.way < STRIDE[1] and len(evidence.straight) < MOST_PAIRS:
            evidence.straight.append((last, frame))
        last = frame
    return evidence


@dataclass(frozen=True, slots=True)
class _Motion:
    """Between two images: way forward, m; whether the robot drove straight, or stood."""

    way: float
    steady: bool
    still: bool


def _motion(recording: FileRecording, fused: YawTrack, start_ns: int, end_ns: int) -> _Motion | None:
    """By the tracks and the fused yaw; None where the tracks say nothing."""
    odometry = recording.odometry
    inside = slice(*np.searchsorted(odometry.t_ns, (start_ns, end_ns)))
    speed, rate = odometry.speed[inside], odometry.yaw_rate[inside]
    if not speed.size:
        return None
    yaw = yaw_at(fused, np.array([start_ns, end_ns]))
    way = float(speed.mean()) * (end_ns - start_ns) * 1e-9
    still = bool(np.abs(speed).max() < STILL and np.abs(rate).max() < STILL)
    return _Motion(way, bool(abs(yaw[1] - yaw[0]) < STEADY and speed.min() > STILL), still)
