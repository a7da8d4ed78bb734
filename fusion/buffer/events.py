"""Samples as events of the timeline: checked, and put into one total order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

from compass import YawIncrement
from fusion.record import record
from fusion.samples import GyroSample, OdometrySample

Sample = GyroSample | OdometrySample | YawIncrement
FOREVER_NS = 2**63  # beyond all stamps
NONSENSE_RATE = 1e3  # m/s and rad/s; a driver's nonsense beyond it could overflow the filter's squares
NONSENSE = 1e12  # rad, rad^2 and all else: a pose of so many turns has lost the digits of its heading


class Sensor(Enum):
    """Where samples come from."""

    __hash__ = object.__hash__  # an enumeration's own is Python, and asked for a dozen times a sample

    GYRO = "gyro"
    TRACKS = "tracks"
    COMPASS = "compass"


class Rank(IntEnum):
    """Order among events of the same stamp: the yaw at an image is cloned after all that is known of that time."""

    GYRO = 0
    TRACKS = 1
    COMPASS = 2
    REFERENCE = 3
    HEADING = 4


@record
class GyroEvent:
    """A gyro sample in the timeline."""

    sample: GyroSample
    t_ns: int
    order: tuple[int | float, ...]


@record
class TracksEvent:
    """An odometry sample in the timeline."""

    sample: OdometrySample
    t_ns: int
    order: tuple[int | float, ...]


@record
class CompassEvent:
    """A yaw increment in the timeline."""

    sample: YawIncrement
    t_ns: int
    order: tuple[int | float, ...]


@dataclass(frozen=True, slots=True)
class ReferenceEvent:
    """The capture time of a compass reference, at which the yaw must be remembered; `far`: for some seconds."""

    t_ns: int
    order: tuple[int | float, ...]
    long_baseline: bool = False


@dataclass(frozen=True, slots=True)
class HeadingEvent:
    """Someone who knows says what the yaw is, modulo a turn (rad, variance rad^2)."""

    heading: float
    variance: float
    t_ns: int
    order: tuple[int | float, ...]


FusionEvent = GyroEvent | TracksEvent | CompassEvent | ReferenceEvent | HeadingEvent


def event_of(sample: Sample) -> FusionEvent:
    """Make the event of a sample that `fault_of` found sound."""
    t = sample.t_ns
    if isinstance(sample, GyroSample):
        order = (t, Rank.GYRO, sample.yaw_rate, -1.0 if sample.variance is None else sample.variance)
        return GyroEvent(sample, t, order)
    if isinstance(sample, OdometrySample):
        pose = (0, 0.0) if sample.yaw is None else (1, sample.yaw)
        return TracksEvent(sample, t, (t, Rank.TRACKS, sample.yaw_rate, sample.speed, *pose))
    content = sample.t_ref_ns, sample.yaw, sample.variance, sample.confidence
    return CompassEvent(sample, t, (t, Rank.COMPASS, sample.long_baseline, *content))


def reference_of(increment: YawIncrement) -> ReferenceEvent:
    """Make the event that remembers the yaw at an increment's reference."""
    return ReferenceEvent(
        increment.t_ref_ns, (increment.t_ref_ns, Rank.REFERENCE, increment.long_baseline), increment.long_baseline
    )


def needs_reference(increment: YawIncrement, before: YawIncrement | None, window_ns: float) -> bool:
    """Whether the yaw at an increment's reference, no further back than a window, must be remembered anew.

    The filter still has both yaws of the last increment of its kind `before` it: the reference, and the image itself.
    """
    kept = before is not None and increment.t_ref_ns in (before.t_ref_ns, before.t_ns)
    return increment.t_ns - increment.t_ref_ns <= window_ns and not kept


def sensor_of(sample: Sample) -> Sensor:
    """Name the sensor of a sample; anything else raises `TypeError`."""
    if isinstance(sample, GyroSample):
        return Sensor.GYRO
    if isinstance(sample, OdometrySample):
        return Sensor.TRACKS
    if isinstance(sample, YawIncrement):
        return Sensor.COMPASS
    raise TypeError(f"{type(sample).__name__} is not a sample; give GyroSample, OdometrySample or YawIncrement")


def fault_of(sample: Sample) -> str | None:
    """Say what makes a sample unusable, None if it is sound."""
    if not sample.t_ns >= 0:  # true for NaN, too
        return "negative stamp"
    motion: tuple[float, ...] = ()
    if isinstance(sample, YawIncrement):
        numbers: tuple[float | None, ...] = (sample.yaw, sample.variance, sample.turn, *sample.tilt)
        numbers += sample.confidence, sample.factor_sigma
        variance: float | None = sample.variance
        if not 0 <= sample.t_ref_ns < sample.t_ns:
            return "reference not before the image"
    elif isinstance(sample, GyroSample):
        numbers, variance = (sample.yaw_rate, sample.variance, sample.cross_rate, *(sample.up or ())), sample.variance
        numbers += (sample.factor_sigma,)
        motion = (sample.yaw_rate,)
    else:
        numbers, variance = (sample.yaw_rate, sample.speed, sample.yaw), None
        motion = (sample.yaw_rate, sample.speed)
    known = [number for number in numbers if number is not None]
    if not all(map(math.isfinite, known)):
        return "not finite"
    if variance is not None and variance <= 0.0:
        return "variance not positive"
    if max(map(abs, motion), default=0.0) > NONSENSE_RATE:
        return f"faster than {NONSENSE_RATE:g} m/s or rad/s"
    if max(map(abs, known)) > NONSENSE:
        return f"a number beyond {NONSENSE:g}"
    return None


def heading_of(t_ns: int, heading: float, variance: float) -> HeadingEvent:
    """Make the event that turns the frame."""
    return HeadingEvent(heading, variance, t_ns, (t_ns, Rank.HEADING, heading, variance))
