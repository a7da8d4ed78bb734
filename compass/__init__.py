"""Visual compass: yaw increments with a confidence from 360-degree panoramas."""

from typing import TYPE_CHECKING

from compass.lazy import lazy_names

if TYPE_CHECKING:
    from compass.angles import wrap_angle
    from compass.config import CompassConfig
    from compass.errors import ConfigError, ImageError, VisualCompassError
    from compass.images.strip import Strip
    from compass.increment import CompassStatus, YawIncrement
    from compass.methods.match import Match, Search
    from compass.methods.registry import register_method
    from compass.version import __version__
    from compass.visual_compass import VisualCompass

__distribution__ = "visual-compass"  # so that another package of this name is told apart
__all__ = [
    "CompassConfig",
    "CompassStatus",
    "ConfigError",
    "ImageError",
    "Match",
    "Search",
    "Strip",
    "VisualCompass",
    "VisualCompassError",
    "YawIncrement",
    "__version__",
    "register_method",
    "wrap_angle",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "wrap_angle": "angles",
        "CompassConfig": "config",
        "ConfigError": "errors",
        "ImageError": "errors",
        "VisualCompassError": "errors",
        "CompassStatus": "increment",
        "YawIncrement": "increment",
        "Match": "methods.match",
        "Search": "methods.match",
        "register_method": "methods.registry",
        "Strip": "images.strip",
        "VisualCompass": "visual_compass",
        "__version__": "version",
    },
)
