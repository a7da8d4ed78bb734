"""Fusion of compass, gyro and track odometry into one yaw."""

from fusion.config import FusionConfig
from fusion.events import Sensor
from fusion.gating import SensorReport, Verdict
from fusion.pipeline import YawFusion, YawPipeline
from fusion.samples import GyroSample, OdometrySample, YawEstimate

__all__ = [
    "FusionConfig",
    "GyroSample",
    "OdometrySample",
    "Sensor",
    "SensorReport",
    "Verdict",
    "YawEstimate",
    "YawFusion",
    "YawPipeline",
]
