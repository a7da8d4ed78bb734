"""Images that seem to be exposed after their stamps: the gyro is late, or the camera's clock is another."""

from __future__ import annotations

import math

from fusion.checks.warnings import Warning
from fusion.record import record

SIGMAS = 3.0  # standard deviations of the delay, as learnt or as configured, whichever is less
NOTABLE = 2.0  # of the prior; sound cameras, and a gyro's own low-pass, reach less; not derived


@record
class EarlyImages:
    """By how much images seem to be stamped before they were exposed.

    The filter goes by the gyro's time and learns how late the images are. No driver stamps an image before it is taken,
    though a gyro that is low-passed, or stamped when it arrives, is late: then the yaw is, too, by the turn in between.
    That the camera's clock is ahead instead nobody can exclude.

    Attributes
    ----------
    seconds : float
        How early, s; 0 where that is within the noise.
    since_ns : int or None
        Since when it is notable; None: it is not.
    """

    seconds: float = 0.0
    since_ns: int | None = None

    def after(self, t_ns: int, delay: float, variance: float, prior_sigma: float) -> EarlyImages:
        """With a camera delay beyond the configured one, s, as learnt at `t_ns`, its variance, s^2, and its prior's."""
        if not -delay > SIGMAS * min(math.sqrt(variance), prior_sigma):
            return self if self.seconds == 0.0 else EarlyImages()
        if -delay < NOTABLE * prior_sigma:
            return EarlyImages(-delay)
        return EarlyImages(-delay, t_ns if self.since_ns is None else self.since_ns)

    def variance(self, rate: float) -> float:
        """Variance, rad^2, of the yaw of a robot that turns at a rate, rad/s."""
        return (rate * self.seconds) ** 2

    def warnings(self) -> tuple[Warning, ...]:
        """Both explanations in words, where it is notable."""
        if self.since_ns is None:
            return ()
        text = (
            f"the images show a turn {self.seconds:.2f} s before the gyro does: either the gyro is late (a low-pass, a"
            " queue, stamps of arrival) or the images are stamped too early, and the yaw may lag by that; stamp all"
            " sensors when they measure, or set fusion.camera_delay if it is the camera"
        )
        return (Warning("sensors_disagree_time", "compass+gyro", self.since_ns, text),)
