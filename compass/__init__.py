"""Visual compass: yaw increments with a confidence from 360-degree panoramas."""

from compass.angles import wrap_angle
from compass.config import CompassConfig
from compass.errors import ConfigError, ImageError, VisualCompassError
from compass.increment import CompassStatus, YawIncrement
from compass.visual_compass import VisualCompass

__all__ = [
    "CompassConfig",
    "CompassStatus",
    "ConfigError",
    "ImageError",
    "VisualCompass",
    "VisualCompassError",
    "YawIncrement",
    "wrap_angle",
]
