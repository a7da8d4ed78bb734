"""The one pipeline, live and offline: images and samples in, the fused yaw out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from compass import CompassConfig, YawIncrement
from fusion.buffer.events import Sample
from fusion.checks.images import image_warnings
from fusion.checks.refusal_share import RefusalWatch
from fusion.checks.warnings import Warning, WarningLog, most_serious_first
from fusion.config import FusionConfig
from fusion.imu.tilt import TiltLog
from fusion.samples import GyroSample, YawEstimate
from fusion.yaw_fusion import YawFusion

if TYPE_CHECKING:
    from compass import VisualCompass


class YawPipeline:
    """Compass and fusion in one: what both the live node and the offline run call.

    Attributes
    ----------
    tilts : TiltLog
        Tilt of the robot by the gyro's samples; the compass reads it.
    long_baseline : YawIncrement or None
        What the last image gave from a view some seconds ago.
    warning_sources : list of callable
        What else says what is wrong at present, each without arguments: images, levelling, whoever feeds the pipeline.
    """

    def __init__(self, compass_config: CompassConfig | None = None, fusion_config: FusionConfig | None = None) -> None:
        self.tilts = TiltLog()
        self.warning_sources: list[Callable[[], Iterable[Warning]]] = [self._image_warnings]
        self._log = WarningLog()
        self._refusals = RefusalWatch()
        self.fusion = YawFusion(fusion_config)
        self._compass_config = compass_config or CompassConfig()
        self.long_baseline: YawIncrement | None = None

    @cached_property
    def compass(self) -> VisualCompass:
        """The compass, made when it is first asked for: who gives increments made elsewhere needs none."""
        from compass import VisualCompass  # type: ignore[attr-defined,unused-ignore]

        # the delay as given: what is learnt beyond it would depend on who came late
        known_ns = round(1e9 * self.fusion.config.camera_delay)
        return VisualCompass(self._compass_config, lambda t_ns: self.tilts.at(t_ns - known_ns))

    def _image_warnings(self) -> list[Warning]:
        return image_warnings(self.compass) if "compass" in vars(self) else []

    def measure_image(self, t_ns: int, image: npt.NDArray[Any], encoding: str = "") -> YawIncrement | None:
        """What the compass makes of a panorama captured at `t_ns`, not fused: half of `add_image`.

        It may run in a thread of its own; the other half is `add`, with this increment and one over a long baseline.
        """
        increment: YawIncrement | None = self.compass.update(t_ns, image, encoding)
        return increment

    def add_image(self, t_ns: int, image: npt.NDArray[Any], encoding: str = "") -> YawIncrement | None:
        """Feed a panorama captured at `t_ns`; what it gives is fused, and the increment from the keyframe returned."""
        increment = self.measure_image(t_ns, image, encoding)
        self.long_baseline = self.compass.long_baseline()
        for one in (increment, self.long_baseline):
            if one is not None:
                self.add(one)
        return increment

    def add(self, sample: Sample) -> bool:
        """Feed a gyro or odometry sample (or an increment made elsewhere)."""
        if isinstance(sample, GyroSample):
            self.tilts.add(sample)
        return self.fusion.add(sample)

    def estimate(self, t_ns: int | None = None) -> YawEstimate | None:
        """The fused estimate after the newest sample, predicted to `t_ns`, ns, if later; None before the first."""
        return self.fusion.estimate(t_ns)

    def warnings(self) -> list[Warning]:
        """What is wrong at present with sensors, clocks and images, most serious first."""
        found = self.fusion.warnings()
        for source in self.warning_sources:
            found += source()
        found += self._refusals.warnings(self.fusion.reports(), found)
        return most_serious_first(found)

    @property
    def warning_log(self) -> WarningLog:
        """All that was wrong so far."""
        self._log.note(self.warnings())
        return self._log

    def flush(self) -> None:
        """Take in what still waits to be confirmed: no more samples will come."""
        self.fusion.flush()

    def reset(self) -> None:
        """Start compass and fusion anew; no image may be measured meanwhile."""
        self.tilts.clear()
        self._log.clear()
        self._refusals.clear()
        if "compass" in vars(self):
            self.compass.reset()
        self.fusion.reset()
