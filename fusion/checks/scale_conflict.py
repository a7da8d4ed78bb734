"""Gyro and compass that turn by different factors: beyond what gyros err by, nobody can say which is wrong."""

from __future__ import annotations

import math

from fusion.checks.warnings import Warning
from fusion.record import record, replace

SIGMAS = 3.0  # of the gyro's prior: 1 in 370 gyros that are sound is beyond
# Not derived. Of a hundred cameras one turns by a wrong factor, as by a tilt of 11 deg; larger ones are named.
# With one in twenty 2 % are 2.1 sigma instead of 4.4, but of a gyro 2 % off beside a right camera nobody is sure.
WRONG, WRONG_SIGMA = 0.01, 0.02


@record
class ScaleConflict:
    """By what factor gyro and compass differ, and how likely it is that the compass is the one that is wrong.

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
        Standard deviation of the yaw as a part of the turn since `yaw`.
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
            sigma = abs(scale) * math.sqrt(compass_errs(scale, prior_sigma))
            return ScaleConflict(self.yaw, scale=scale, sigma=sigma, images=images)
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


def compass_errs(scale: float, prior_sigma: float) -> float:
    """Probability that a factor by which gyro and compass differ, less one, is the compass's: by Bayes' rule.

    A compass turns by the right factor, but for `WRONG` of them, whose factor is off by `WRONG_SIGMA`.
    """
    if prior_sigma <= 0.0:
        return 0.0
    wider = math.hypot(WRONG_SIGMA, prior_sigma)
    right = (1.0 - WRONG) / prior_sigma * math.exp(-0.5 * (scale / prior_sigma) ** 2)
    wrong = WRONG / wider * math.exp(-0.5 * (scale / wider) ** 2)
    return wrong / (right + wrong)
