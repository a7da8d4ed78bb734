"""What can be set about the compass."""

from dataclasses import dataclass

from compass.errors import ConfigError
from compass.methods import OURS, find_method
from compass.parameters import ParameterSet, parameter

METHODS = tuple(OURS)


@dataclass(frozen=True)
class CompassConfig(ParameterSet):
    """Settings of `VisualCompass`; every field has a default, an unusable value raises `ConfigError`."""

    method: str = parameter(
        "corners",
        "how a yaw increment is found; see the methods' pages in compass/README.md",
        choices=METHODS,
        others="your own as module:function",
    )
    roi_top: float = parameter(
        0.25, "upper edge of the region of interest, a fraction of image height", low=0.0, high=1.0
    )
    roi_bottom: float = parameter(
        0.55, "lower edge of the region of interest, a fraction of image height", low=0.0, high=1.0
    )
    mask: str = parameter(
        "",
        "picture (PNG) of the panorama in which what belongs to the robot is white; those pixels are ignored; empty: "
        "none. A relative path counts from the folder of the YAML for the command line, from the working directory "
        "for a node",
    )
    columns: int = parameter(1024, "width of the strip; never more than the image has", unit="px", low=16, high=8192)
    rows: int = parameter(160, "greatest height of the strip", unit="px", low=1, high=4096)
    forward_column: float = parameter(
        0.5, "column that looks along the robot's +x, a fraction of image width", low=0.0, high=1.0
    )
    horizon_row: float = parameter(
        0.5, "row of the horizon when the robot stands level, a fraction of image height", low=0.0, high=1.0
    )
    max_yaw_rate: float = parameter(
        3.0,
        "fastest turn to expect; a shift beyond it is believed only where nothing inside it matches",
        unit="rad/s",
        low=0.01,
        high=100.0,
        live=True,
    )
    min_confidence: float = parameter(
        0.65,
        "peak correlation below which no increment is given; 3 of 100 unrelated scenes are above it, the next image of "
        "a drive is above 0.9, in a crowd above 0.7; those left `corners` knows by corners that no motion explains",
        low=0.0,
        high=1.0,
        live=True,
    )

    keyframe_spread: float = parameter(
        -1.0,
        "a keyframe stays the reference until the parts of the panorama have moved apart by this much; 0 compares "
        "each image with the one before; -1: what suits the method, 8 for `corners`, 3 for others",
        unit="px",
        low=-1.0,
        high=20.0,
    )
    find_again: bool = parameter(
        True,
        "after a gap (darkness, a camera that failed) find the last view again by its corners and tell the turn since; "
        "`corners` only",
    )
    look_back: float = parameter(
        0.9,
        "how often the turn since a view some seconds ago is told by its corners: right to a hundredth of a degree, "
        "for the filter, at the cost of ten comparisons; 0: never; not more than the filter's `reference_window`; "
        "`corners` only",
        unit="s",
        low=0.0,
        high=60.0,
    )
    lean_sigma: float = parameter(
        0.02,
        "error of roll and pitch, as an IMU tells them, standard deviation; it matters while the robot leans",
        unit="rad",
        low=0.0,
        high=1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "method", find_method(self.method)[0])
        if self.roi_bottom <= self.roi_top:
            raise ConfigError(f"roi_bottom: {self.roi_bottom:g} must be greater than roi_top {self.roi_top:g}")
