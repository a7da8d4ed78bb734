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
        "above 0.7, unrelated scenes in 3 of 100 cases above 0.65; what `corners` finds has above 0.8, outliers tell "
        "unrelated scenes",
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

    projection: str = parameter(
        "equirectangular",
        "how the image shows what is around, see docs/cameras.md; cylinder: rows by the tangent of elevation; ring: "
        "curved mirror or ring lens. roi_top and roi_bottom then count as in a panorama from straight up (0) over the "
        "horizon (0.5) to straight down (1)",
        choices=("equirectangular", "cylinder", "fisheye", "dual_fisheye", "ring"),
    )
    image_rotation_deg: int = parameter(
        0,
        "by how much the image must be turned clockwise to stand upright: 0, 90, 180 (camera upside down) or 270; all "
        "other parameters are of the image so turned",
        unit="deg",
        low=0,
        high=270,
    )
    mirrored: bool = parameter(False, "the image, once turned, is seen as in a mirror")
    chroma_below: bool = parameter(
        False,
        "images of one channel are I420, NV12 or NV21 under another name (8UC1, mono8): only the upper two thirds of "
        "their rows are the picture",
    )
    field_of_view_deg: float = parameter(
        0.0,
        "angle across the image's width, or across a fisheye's circle; 0: 360 of an equirectangular image, 190 of a "
        "fisheye's circle; a cylinder needs it",
        unit="deg",
        low=0.0,
        high=360.0,
    )
    lens_looks: str = parameter(
        "up",
        "where a fisheye or ring looks; the image's upper edge is then ahead, or up where it looks ahead",
        choices=("up", "down", "ahead"),
    )
    circle_x: float = parameter(
        0.0, "centre of the fisheye's or ring's circle, a fraction of image width; 0: in the middle", low=0.0, high=1.0
    )
    circle_y: float = parameter(
        0.0, "centre of that circle, a fraction of image height; 0: in the middle", low=0.0, high=1.0
    )
    circle_radius: float = parameter(
        0.0, "radius of that circle, a fraction of image height; 0: as large as fits", low=0.0, high=10.0
    )
    circle_roll_deg: float = parameter(
        0.0,
        "by how much that circle must be turned clockwise to stand upright",
        unit="deg",
        low=-180.0,
        high=180.0,
    )
    circle2_x: float = parameter(
        0.0, "the same of the second circle, on the right of the first or below it: looks astern", low=0.0, high=1.0
    )
    circle2_y: float = parameter(0.0, "the same of the second circle", low=0.0, high=1.0)
    circle2_radius: float = parameter(0.0, "the same of the second circle; 0: as the first", low=0.0, high=10.0)
    circle2_roll_deg: float = parameter(0.0, "the same of the second circle", unit="deg", low=-180.0, high=180.0)
    fisheye_focal: float = parameter(
        0.0,
        "focal length of OpenCV's fisheye model (fx), a fraction of image height; 0: by radius and field of view",
        low=0.0,
        high=10.0,
    )
    fisheye_k1: float = parameter(
        0.0,
        "distortion as in OpenCV's fisheye model: radius = focal * (a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9)",
        low=-10.0,
        high=10.0,
    )
    fisheye_k2: float = parameter(0.0, "the same, k2", low=-10.0, high=10.0)
    fisheye_k3: float = parameter(0.0, "the same, k3", low=-10.0, high=10.0)
    fisheye_k4: float = parameter(0.0, "the same, k4", low=-10.0, high=10.0)
    ring_inner: float = parameter(
        0.0, "inner radius of the ring, a fraction of image height; its outer one is circle_radius", low=0.0, high=10.0
    )
    ring_inner_elevation_deg: float = parameter(
        -60.0, "elevation seen at the inner radius; in between it grows with radius", unit="deg", low=-90.0, high=90.0
    )
    ring_outer_elevation_deg: float = parameter(
        15.0, "elevation seen at the outer radius", unit="deg", low=-90.0, high=90.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "method", find_method(self.method)[0])
        if self.roi_bottom <= self.roi_top:
            raise ConfigError(f"roi_bottom: {self.roi_bottom:g} must be greater than roi_top {self.roi_top:g}")
        if self.image_rotation_deg % 90:
            raise ConfigError(f"image_rotation_deg: {self.image_rotation_deg} must be 0, 90, 180 or 270")
        if self.projection == "cylinder" and not self.field_of_view_deg:
            raise ConfigError("field_of_view_deg: a cylinder's must be given, the angle across the image's width")
        if self.projection == "ring" and self.ring_inner_elevation_deg == self.ring_outer_elevation_deg:
            raise ConfigError("ring_outer_elevation_deg: must differ from ring_inner_elevation_deg")

    @property
    def is_full_panorama(self) -> bool:
        """Whether images are equirectangular, and of the full circle."""
        return self.projection == "equirectangular" and self.field_of_view_deg in (0.0, 360.0)

    @property
    def decoded_columns(self) -> int:
        """Width below which no image may be decoded at reduced size: that leaves `columns` round the circle, px."""
        return self.columns if self.projection in ("equirectangular", "cylinder") else 2 * self.columns
