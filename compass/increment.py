"""What the compass gives: a yaw increment, or the reason why there is none."""

from dataclasses import dataclass
from enum import Enum


class CompassStatus(Enum):
    """Outcome of an update; the value is a sentence for logs and diagnostics."""

    OK = "increment given"
    FOUND_AGAIN = "increment given: the last view was found again after a gap"
    NOT_STARTED = "no image seen yet"
    FIRST_FRAME = "first image, nothing to compare with"
    LOW_CONFIDENCE = "peak correlation below min_confidence"
    NO_TEXTURE = "image without texture: black, covered or overexposed"
    AMBIGUOUS = "several yaws match equally well"
    FROZEN = "camera repeats the same image"
    BACKWARD_STAMP = "image not newer than the one before"
    SIZE_CHANGED = "image size changed, started again"


@dataclass(frozen=True, slots=True)
class YawIncrement:
    """Yaw of the camera at `t_ns` relative to `t_ref_ns`, about the vertical.

    Attributes
    ----------
    t_ref_ns, t_ns : int
        Capture times (``header.stamp``) of the reference and of the current image, ns. While a keyframe holds,
        `t_ref_ns` stays the same from increment to increment.
    yaw : float
        Turn from reference to current, rad, positive to the left, in [-pi, pi).
    variance : float
        Variance of `yaw`, rad^2, positive.
    confidence : float
        Normalised peak correlation, 0..1; across a gap the share of the common corners that are inliers.
    turn, tilt : float or None, (float, float)
        What was seen: the scene rotated by `tilt` (rad) about the robot's x and y axes, then the robot turned by
        `turn` about its own z axis; how the camera is tilted on it is taken out (`compass.mount`). `yaw` follows with
        the tilt at the reference, as the compass knew it. None: only `yaw` is known.
    long_baseline : bool
        Whether it comes from the corners of a view some seconds ago (`VisualCompass.long_baseline`). It goes with the
        increments from image to image, and ends and starts at images that they end at, too.
    factor_sigma : float
        Standard deviation of the factor by which this turn and all others may be wrong alike, beside `variance`: not 0
        where the images show that they are no full circle.
    """

    t_ref_ns: int
    t_ns: int
    yaw: float
    variance: float
    confidence: float
    turn: float | None = None
    tilt: tuple[float, float] = (0.0, 0.0)
    long_baseline: bool = False
    factor_sigma: float = 0.0

    @property
    def far(self) -> bool:
        """Former name of `long_baseline`; it goes with the next release."""
        return self.long_baseline
