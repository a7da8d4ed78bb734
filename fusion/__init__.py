"""Fusion of compass, gyro and track odometry into one yaw."""

from fusion.config import FusionConfig
from fusion.samples import GyroSample, OdometrySample, YawEstimate

__all__ = ["FusionConfig", "GyroSample", "OdometrySample", "YawEstimate"]
