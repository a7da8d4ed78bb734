"""Fusion of compass, gyro and track odometry into one yaw."""

from typing import TYPE_CHECKING

from compass.lazy import lazy_names

if TYPE_CHECKING:
    from fusion.buffer.events import Sensor
    from fusion.checks.gate import SensorReport, Verdict
    from fusion.checks.warnings import Warning
    from fusion.config import FusionConfig
    from fusion.pipeline import YawPipeline
    from fusion.samples import GyroSample, OdometrySample, YawEstimate
    from fusion.smoother import smooth
    from fusion.yaw_fusion import YawFusion

__distribution__ = "visual-compass"  # so that another package of this name is told apart
__all__ = [
    "FusionConfig",
    "GyroSample",
    "OdometrySample",
    "Sensor",
    "SensorReport",
    "Verdict",
    "Warning",
    "YawEstimate",
    "YawFusion",
    "YawPipeline",
    "smooth",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "FusionConfig": "config",
        "Sensor": "buffer.events",
        "Warning": "checks.warnings",
        "SensorReport": "checks.gate",
        "Verdict": "checks.gate",
        "YawFusion": "yaw_fusion",
        "YawPipeline": "pipeline",
        "GyroSample": "samples",
        "OdometrySample": "samples",
        "YawEstimate": "samples",
        "smooth": "smoother",
    },
)
