"""The samples that go into the filter and the estimate that comes out."""

from dataclasses import dataclass

from compass.angles import wrap_angle
from fusion.checks.warnings import Warning


@dataclass(frozen=True, slots=True)
class GyroSample:
    """Turn rate about the vertical from a gyro.

    Attributes
    ----------
    t_ns : int
        ``header.stamp``, ns.
    yaw_rate : float
        rad/s about the vertical, positive to the left (roll, pitch and the mount already taken out).
    variance : float or None
        Variance of the white noise of `yaw_rate`, (rad/s)^2; None takes it from the config.
    up : tuple of float or None
        Tilt of the robot: the vertical in its own frame (x forward, y left, z up), a unit vector; None where unknown.
    cross_rate : float or None
        rad/s about the robot's y axis; at rest it is the gyro's bias. None where unknown.
    factor_sigma : float
        Standard deviation of the factor by which this rate and all others may be wrong alike, beside the gyro's own
        scale: not 0 where nobody knows how the gyro lies.
    """

    t_ns: int
    yaw_rate: float
    variance: float | None = None
    up: tuple[float, float, float] | None = None
    cross_rate: float | None = None
    factor_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """What the tracks claim.

    Attributes
    ----------
    t_ns : int
        ``header.stamp``, ns.
    yaw_rate : float
        rad/s, positive to the left.
    speed : float
        m/s along +x, positive forward.
    yaw : float or None
        Integrated yaw of the track odometry's pose, rad (wrapped or not); None where unknown.
    """

    t_ns: int
    yaw_rate: float
    speed: float
    yaw: float | None = None


@dataclass(frozen=True, slots=True)
class YawEstimate:
    """The fused estimate at one time.

    Attributes
    ----------
    t_ns : int
        Time of the newest sample it contains, ns.
    yaw : float
        Accumulated (unwrapped, turns counted) yaw since start, rad, positive to the left.
    yaw_variance : float
        rad^2.
    yaw_rate, yaw_rate_variance : float
        rad/s and (rad/s)^2.
    gyro_bias, gyro_bias_variance : float
        What the gyro adds to the rate, rad/s and (rad/s)^2.
    track_scale, track_scale_variance : float
        Claimed over true turn rate of the tracks, 1.
    camera_delay, camera_delay_variance : float
        From the exposure of an image to its stamp, s and s^2.
    standstill, slip : bool
        Whether the robot is taken to stand, and the tracks to slip.
    warnings : tuple of Warning
        What is wrong at present, most serious first.
    turn_count_variance : float
        The part of `yaw_variance` that is full turns nobody counted, rad^2: of the heading it says nothing.
    """

    t_ns: int
    yaw: float
    yaw_variance: float
    yaw_rate: float
    yaw_rate_variance: float
    gyro_bias: float
    gyro_bias_variance: float
    track_scale: float
    track_scale_variance: float
    camera_delay: float = 0.0
    camera_delay_variance: float = 0.0
    standstill: bool = False
    slip: bool = False
    warnings: tuple[Warning, ...] = ()
    turn_count_variance: float = 0.0

    @property
    def heading(self) -> float:
        """`yaw` wrapped into [-pi, pi), rad."""
        return float(wrap_angle(self.yaw))

    @property
    def heading_variance(self) -> float:
        """Variance of `heading`, rad^2."""
        return self.yaw_variance - self.turn_count_variance
