"""Whether pose and twist of an odometry turn alike: they are two fields of one driver, and either may be wrong."""

from __future__ import annotations

import math

from compass import wrap_angle
from fusion.checks.rate_turn import FASTEST_ROBOT
from fusion.checks.silence import RATE_SILENT_NS
from fusion.checks.warnings import Warning
from fusion.samples import OdometrySample

# Not derived: all three.
TURNED = 1.0  # rad, that both must have turned by, to and fro, before they are compared
ALIKE = 0.9  # correlation of their turns; lag and noise of a twist leave more
FACTOR = 2.0  # by which one turns more than the other; a twist may have another scale, not another unit


class PoseAndTwist:
    """Compares from sample to sample what an odometry's pose and its twist say of the same turn."""

    def __init__(self) -> None:
        self._last: OdometrySample | None = None
        self._since_ns = 0
        self._pose = self._twist = 0.0  # turned to and fro, rad
        self._squares = self._twist_squares = self._products = 0.0

    def hear(self, sample: OdometrySample) -> None:
        """Take in a sample, in the order of stamps; a pose that jumps as no robot turns is left out."""
        last, self._last = self._last, sample
        if last is None or last.yaw is None or sample.yaw is None or not 0 < sample.t_ns - last.t_ns <= RATE_SILENT_NS:
            return
        seconds = (sample.t_ns - last.t_ns) * 1e-9
        pose, twist = float(wrap_angle(sample.yaw - last.yaw)), 0.5 * (last.yaw_rate + sample.yaw_rate) * seconds
        if abs(pose) > FASTEST_ROBOT * seconds:
            return
        self._since_ns = self._since_ns or last.t_ns
        self._pose += abs(pose)
        self._twist += abs(twist)
        self._squares += pose * pose
        self._twist_squares += twist * twist
        self._products += pose * twist

    def warnings(self) -> list[Warning]:
        """What is wrong, if anything."""
        if min(self._pose, self._twist) < TURNED:
            return []
        correlation = self._products / math.sqrt(self._squares * self._twist_squares)
        factor = self._products / self._squares
        if correlation < -ALIKE:
            text = (
                "the odometry's twist turns to the right where its pose turns to the left: one of the two has the"
                " wrong sign; correct it in the driver, or choose the right one with `fusion.odometry`"
            )
            return [Warning("sensors_disagree_sign", "tracks", self._since_ns, text)]
        if correlation > ALIKE and not 1.0 / FACTOR < factor < FACTOR:
            text = (
                f"the odometry's twist turns {factor:.3g} times as far as its pose (57.3: degrees); correct it in the"
                " driver, or choose the right one with `fusion.odometry`"
            )
            return [Warning("sensors_disagree_scale", "tracks", self._since_ns, text)]
        return []
