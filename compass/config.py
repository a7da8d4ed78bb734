"""What can be set about the compass."""

from dataclasses import dataclass

from compass.errors import ConfigError
from compass.methods.registry import OURS, find_method
from compass.parameters import ParameterSet, parameter

METHODS = tuple(OURS)


@dataclass(frozen=True)
class CompassConfig(ParameterSet):
    """Settings of `VisualCompass`; every field has a default, an unusable value raises `ConfigError`."""

    method: str = parameter(
        "corners",
        "how a yaw increment is found, see docs/compass.md",
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
        "fastest turn to expect; a shift beyond it is accepted only where nothing inside it matches",
        unit="rad/s",
        low=0.01,
        high=100.0,
        live=True,
    )
    min_confidence: float = parameter(
        0.65,
        "peak correlation below which no increment is given; successive images of a drive have above 0.9, in a crowd "
        "above 0.7, unrelated scenes in 3 of 100 cases above 0.65; `corners` rejects those by their outliers",
        low=0.0,
        high=1.0,
        live=True,
    )

    keyframe_spread: float = parameter(
        -1.0,
        "a keyframe is kept until the parts of the panorama have moved apart by this much; 0 compares each image with "
        "the one before; -1: the method's own value, 8 for `corners`, 3 for others",
        unit="px",
        low=-1.0,
        high=20.0,
    )
    find_again: bool = parameter(
        True,
        "after a gap (darkness, a camera that failed) match the last view by its corners and give the turn since; "
        "`corners` only",
    )
    long_baseline_interval: float = parameter(
        0.9,
        "time between increments over long baselines, some seconds, which are given to the filter and cost some ten "
        "updates each; 0: none; at most the filter's `reference_window`; `corners` only",
        unit="s",
        low=0.0,
        high=60.0,
        formerly="look_back",
    )
    tilt_sigma: float = parameter(
        0.02,
        "error of roll and pitch from an IMU, standard deviation; it matters while the robot is tilted",
        unit="rad",
        low=0.0,
        high=1.0,
        formerly="lean_sigma",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "method", find_method(self.method)[0])
        if self.roi_bottom <= self.roi_top:
            raise ConfigError(f"roi_bottom: {self.roi_bottom:g} must be greater than roi_top {self.roi_top:g}")
