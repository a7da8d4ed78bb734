"""What the compass makes of a recording's images, one by one."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass

from compass import CompassStatus, VisualCompass, YawIncrement
from fusion.checks.images import image_warnings
from fusion.checks.warnings import Warning
from fusion.compass_rate import CompassRate
from fusion.offline.streams import Recording
from fusion.settings import Settings


@dataclass(frozen=True, slots=True)
class CompassReading:
    """The raw compass at one image.

    Attributes
    ----------
    status : CompassStatus
        Outcome of the update.
    increment : YawIncrement or None
        What it gave.
    yaw, sigma : float
        Accumulated yaw and its standard deviation, rad; NaN where no increment was given.
    rate, rate_variance : float
        Mean turn rate since the image before, rad/s, and its variance; NaN where no increment was given.
    long_baseline : YawIncrement or None
        The turn from a view some seconds ago, where it was due.
    """

    status: CompassStatus
    increment: YawIncrement | None = None
    yaw: float = math.nan
    sigma: float = math.nan
    rate: float = math.nan
    rate_variance: float = math.nan
    long_baseline: YawIncrement | None = None

    def increments(self) -> Iterator[YawIncrement]:
        """All that the filter was given."""
        return (one for one in (self.increment, self.long_baseline) if one)


@dataclass(frozen=True, slots=True)
class ImageResult:
    """What came of one image.

    Attributes
    ----------
    t_ns : int
        Its stamp.
    reading : CompassReading
        What the compass made of it.
    image_warnings, recording_warnings : tuple of Warning
        What was known then to be wrong with the images, and with the recording.
    """

    t_ns: int
    reading: CompassReading
    image_warnings: tuple[Warning, ...]
    recording_warnings: tuple[Warning, ...]


def measure_images(recording: Recording, settings: Settings) -> Generator[ImageResult, None, None]:
    """Every image of a recording through the compass, which takes the tilt from the gyro's samples.

    Nothing that the filter finds out has a part in it, so that it may run ahead and in another process.
    """
    known_ns = round(1e9 * settings.fusion.camera_delay)  # as in `YawPipeline`
    compass = VisualCompass(settings.compass, lambda t_ns: recording.gyro.up_at(t_ns - known_ns))
    rates = CompassRate()
    for frame in recording.frames():
        increment = compass.update(frame.t_ns, frame.image, frame.encoding)
        reading = CompassReading(compass.status)
        if increment is not None:
            sigma, rate = math.sqrt(compass.yaw_variance), rates.update(increment)
            reading = CompassReading(
                compass.status, increment, compass.yaw, sigma, *rate, long_baseline=compass.long_baseline()
            )
        yield ImageResult(frame.t_ns, reading, tuple(image_warnings(compass)), tuple(recording.warnings))
