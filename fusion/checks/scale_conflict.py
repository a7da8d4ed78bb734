"""Gyro and compass that turn by different factors: beyond what gyros err by, nobody can say which is wrong."""

from __future__ import annotations

import math

from fusion.checks.warnings import Warning
from fusion.record import record, replace

SIGMAS = 3.0  # of the gyro's prior: 1 in 370 gyros that are sound is beyond


@record
class ScaleConflict:
    """By what factor gyro and compass differ, beyond what the gyro's prior explains.

    The filter follows the compass and learns the difference as the gyro's scale. The tracks' scale is free, they cannot
    decide. If the compass is wrong instead, the yaw is wrong by that part of the whole turn.

    Attributes
    ----------
    yaw : float
        Where the turn began that is known only by both: the yaw at the start or when it was set, rad.
    since_ns : int or None
        Since when they differ by more than `SIGMAS`; None: they do not.
    scale : float
        Excess of the gyro's scale factor over the compass's, as learnt.
    sigma : float
        Standard deviation of the yaw as a part of the turn since `yaw`; 0 where they do not differ.
    since_yaw : float
        Yaw then, rad.
    images : float
        The same by what the images say of themselves, and as far as the gyro does not know better.
    """

    yaw: float
    since_ns: int | None = None
    scale: float = 0.0
    sigma: float = 0.0
    images: float = 0.0
    since_yaw: float = 0.0

    def after(
        self, t_ns: int, yaw: float, scale: float, variance: float, prior_sigma: float, images: float = 0.0
    ) -> ScaleConflict:
        """With a scale that was learnt at `t_ns` and a yaw, and its variance.

        Up to `SIGMAS` of the prior it is the gyro's own. A conflict may vanish without anybody having been right: what
        is `left` of it is for good.
        """
        if abs(scale) <= SIGMAS * prior_sigma:
            unchanged = self.since_ns is None and self.images == images
            return self if unchanged else ScaleConflict(self.yaw, images=images)
        begun = self if self.since_ns is not None else replace(self, since_ns=t_ns, since_yaw=yaw)
        return replace(begun, scale=scale, sigma=math.sqrt(scale**2 + variance), images=images)

    def variance(self, yaw: float) -> float:
        """Variance, rad^2, of the turn up to a yaw, rad."""
        turned = yaw - self.yaw
        if self.since_ns is not None:  # it may have begun then
            turned = max(turned, yaw - self.since_yaw, key=abs)
        return (max(self.sigma, self.images) * turned) ** 2

    def left(self, yaw: float) -> float:
        """Variance, rad^2, of the turn from where they began to differ up to a yaw, rad, whoever is right later."""
        return 0.0 if self.since_ns is None else (self.sigma * (yaw - self.since_yaw)) ** 2

    def warnings(self) -> tuple[Warning, ...]:
        """Both claims in words, if they differ."""
        if self.since_ns is None:
            return ()
        ratio = 1.0 + self.scale
        text = (
            f"the gyro turns {ratio:.2f} times as far as the images: either its scale factor is {ratio:.2f}, or the"
            f" images show {360.0 / ratio:.0f} degrees, not 360; the yaw may be wrong by that"
        )
        return (Warning("sensors_disagree_scale", "compass+gyro", self.since_ns, text),)
