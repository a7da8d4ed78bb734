"""Turn rate of the raw compass, from one increment to the next."""

from __future__ import annotations

from compass import YawIncrement, wrap_angle


class CompassRate:
    """Mean turn rate between the last two images, also while a keyframe holds."""

    def __init__(self) -> None:
        self._last: YawIncrement | None = None

    def update(self, increment: YawIncrement) -> tuple[float, float]:
        """Rate that an increment adds to what was known.

        Parameters
        ----------
        increment : YawIncrement
            The newest.

        Returns
        -------
        (float, float)
            Mean yaw rate, rad/s, and its variance, (rad/s)^2: the variance of the turn over the time squared.
        """
        last, self._last = self._last, increment
        turn, variance, since_ns = increment.yaw, increment.variance, increment.t_ref_ns
        if last is not None and last.t_ref_ns == increment.t_ref_ns < last.t_ns < increment.t_ns:
            turn, since_ns = float(wrap_angle(turn - last.yaw)), last.t_ns
            variance += last.variance  # an upper bound: the noise of the common reference cancels
        dt = (increment.t_ns - since_ns) * 1e-9
        return turn / dt, variance / dt**2
