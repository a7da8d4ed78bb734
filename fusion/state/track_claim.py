"""What the tracks have claimed since their reference, and which of their fields say it."""

from __future__ import annotations

from compass import wrap_angle
from compass.tilt import Vector
from fusion.checks.silence import RATE_SILENT_NS
from fusion.imu.tilt import heading_gain
from fusion.record import record
from fusion.samples import OdometrySample


@record
class OdometryFields:
    """Which fields of the odometry have ever spoken; those a driver leaves empty are zero for ever.

    Attributes
    ----------
    last : OdometrySample or None
        The newest, as it came.
    pose, twist : bool
        Whether the pose's yaw has ever changed; whether the twist has ever been other than zero.
    gain, lead : float
        Rate of the heading over the robot's own at the last sample, for its tilt; by how much the heading has gone
        ahead of the poses for that reason, rad.
    """

    last: OdometrySample | None = None
    pose: bool = False
    twist: bool = False
    gain: float = 1.0
    lead: float = 0.0

    def after(self, sample: OdometrySample, up: Vector | None) -> tuple[OdometryFields, OdometrySample]:
        """After a sample, of a robot in whose frame `up` is the vertical; and the sample as one of its heading.

        A pose that never speaks is left out; where only poses speak the rate is taken from them.
        """
        last, turn = self.last, 0.0
        if last is not None and last.yaw is not None and sample.yaw is not None:
            turn = float(wrap_angle(sample.yaw - last.yaw))
        pose, twist = self.pose or turn != 0.0, self.twist or sample.yaw_rate != 0.0 or sample.speed != 0.0
        gain = heading_gain(up) if up else 1.0
        voice = OdometryFields(sample, pose, twist, gain, self.lead + turn * (0.5 * (self.gain + gain) - 1.0))
        rate = sample.yaw_rate
        if pose and not twist and last is not None and sample.t_ns > last.t_ns:
            rate = turn / ((sample.t_ns - last.t_ns) * 1e-9)
        yaw = sample.yaw + voice.lead if pose and sample.yaw is not None else None
        return voice, OdometrySample(sample.t_ns, rate * gain, sample.speed, yaw)


@record
class TrackClaim:
    """What the tracks claim since a reference.

    Attributes
    ----------
    reference, last : OdometrySample
        At the reference, and the newest.
    turn : float
        Integral of the claimed rates from `reference` to `last`, rad.
    """

    reference: OdometrySample
    last: OdometrySample
    turn: float

    def turn_until(self, sample: OdometrySample, mode: str) -> tuple[float | None, bool]:
        """Turn (rad) from the reference to `sample`, None if that is unknown; and whether modulo a turn.

        By the poses if `mode` is ``pose`` and both have a yaw, else by the turn rates in between.
        """
        if mode == "pose" and sample.yaw is not None and self.reference.yaw is not None:
            return sample.yaw - self.reference.yaw, True
        gap_ns = sample.t_ns - self.last.t_ns
        return (self.turn + sample.yaw_rate * gap_ns * 1e-9 if gap_ns <= RATE_SILENT_NS else None), False
