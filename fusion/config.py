"""What can be set about the filter."""

from dataclasses import dataclass

from compass.parameters import ParameterSet, parameter


@dataclass(frozen=True)
class FusionConfig(ParameterSet):
    """Settings of `YawFusion`; every field has a default, an unusable value raises `ConfigError`."""

    lag_window: float = parameter(
        1.0, "how late a sample may arrive and still be applied at its own time", unit="s", low=0.0, high=60.0
    )
    reference_window: float = parameter(
        1.0,
        "how long before an image its reference may lie if no earlier increment had that reference",
        unit="s",
        low=0.0,
        high=60.0,
    )
    initial_yaw: float = parameter(0.0, "yaw at the first sample", unit="rad", low=-1e6, high=1e6)
    initial_yaw_sigma: float = parameter(1e-4, "its standard deviation", unit="rad", low=1e-9, high=10.0)
    initial_rate_sigma: float = parameter(
        1.0, "turn rate to expect while nothing measures it, standard deviation", unit="rad/s", low=1e-3, high=100.0
    )
    rate_walk: float = parameter(
        1.0, "process noise of the turn rate: its standard deviation after one second", unit="rad/s/sqrt(s)",
        low=1e-4, high=100.0,
    )  # fmt: skip
    watched_rate_walk: float = parameter(
        0.4, "the same while a gyro measures it; a faster change is accepted once the gyro reports it twice",
        unit="rad/s/sqrt(s)", low=1e-4, high=100.0,
    )  # fmt: skip
    rate_walk_factor: float = parameter(
        3.0, "1-sigma factor of the prior on `watched_rate_walk`; > 1 estimates it online, 1 keeps it",
        low=1.0, high=10.0,
    )  # fmt: skip
    rate_ramp: float = parameter(0.02, "correlation time of the angular acceleration", unit="s", low=1e-3, high=10.0)
    gyro_sigma: float = parameter(
        0.0025, "white noise of one gyro sample, standard deviation", unit="rad/s", low=1e-6, high=10.0
    )
    gyro_sigma_factor: float = parameter(
        2.0, "1-sigma factor of the prior on it; > 1 estimates it online, where it is more, 1 keeps it",
        low=1.0, high=10.0,
    )  # fmt: skip
    initial_bias_sigma: float = parameter(
        0.005, "gyro bias to expect at the start, standard deviation", unit="rad/s", low=1e-6, high=1.0
    )
    least_bias_sigma: float = parameter(
        0.0001,
        "the same of a gyro that its driver has calibrated; the prior is a mixture between both, which gyro and tracks "
        "that agree narrow",
        unit="rad/s",
        low=1e-6,
        high=1.0,
    )
    bias_walk: float = parameter(
        0.00002, "random walk of the gyro bias: its standard deviation after one second", unit="rad/s/sqrt(s)",
        low=0.0, high=1.0,
    )  # fmt: skip
    bias_walk_factor: float = parameter(
        2.5, "1-sigma factor of the prior on it; > 1 estimates it online, 1 keeps it", low=1.0, high=10.0
    )
    gyro_scale_sigma: float = parameter(
        0.008, "error of the gyro's scale factor to expect, standard deviation", low=0.0, high=0.5
    )
    odometry: str = parameter(
        "pose",
        "what of the track odometry is fused: the turn between its poses, or its turn rates",
        choices=("pose", "twist"),
    )
    track_interval: float = parameter(
        0.5, "interval over which the tracks' turn is measured; the longer, the less wrong stamps matter",
        unit="s", low=0.0, high=60.0,
    )  # fmt: skip
    track_noise: float = parameter(
        0.02, "noise of the yaw the tracks claim: its standard deviation after one second", unit="rad/sqrt(s)",
        low=1e-6, high=10.0,
    )  # fmt: skip
    track_timing: float = parameter(
        0.05, "timestamp error of the odometry, standard deviation", unit="s", low=0.0, high=1.0
    )
    track_slip_turn: float = parameter(
        0.05, "slip of the tracks: error of their turn rate as a fraction of it, standard deviation", low=0.0, high=10.0
    )
    track_slip_speed: float = parameter(
        0.1,
        "slip of the tracks: error of their turn rate per speed, standard deviation",
        unit="rad/m",
        low=0.0,
        high=10.0,
    )
    slip_factor: float = parameter(
        3.0,
        "1-sigma factor of the prior on `track_noise` and the two before; > 1 estimates it online, 1 keeps them",
        low=1.0,
        high=10.0,
    )
    slip_time: float = parameter(0.5, "correlation time of slip", unit="s", low=1e-3, high=1e3)
    speed_slip: float = parameter(
        0.05,
        "slip of the tracks: error of their speed as a fraction of it, standard deviation, over `slip_time`; for "
        "position only",
        low=0.0,
        high=10.0,
    )
    speed_scale_sigma: float = parameter(
        0.02,
        "error of the scale of the tracks' speed, standard deviation; for position only",
        low=0.0,
        high=1.0,
    )
    veer_sigma: float = parameter(
        0.015, "turn the tracks claim per metre driven straight (one track longer), standard deviation", unit="rad/m",
        low=0.0, high=1.0,
    )  # fmt: skip
    least_veer_sigma: float = parameter(
        0.00025, "the same of tracks that were calibrated; the prior is a mixture", unit="rad/m", low=1e-6, high=1.0
    )
    initial_scale: float = parameter(1.0, "turn rate claimed by the tracks over the true one", low=0.05, high=20.0)
    initial_scale_sigma: float = parameter(0.3, "its standard deviation at the start", low=1e-6, high=10.0)
    scale_walk: float = parameter(
        0.002, "random walk of the track scale: its standard deviation after one second", unit="1/sqrt(s)",
        low=0.0, high=10.0,
    )  # fmt: skip
    compass_timing: float = parameter(
        0.005, "timestamp jitter of the images, standard deviation", unit="s", low=0.0, high=1.0
    )
    compass_timing_factor: float = parameter(
        2.0, "1-sigma factor of the prior on it; > 1 estimates it online, 1 keeps it", low=1.0, high=10.0
    )
    camera_delay: float = parameter(
        0.0, "time from the exposure of an image to its stamp, at the start", unit="s", low=-1.0, high=1.0
    )
    camera_delay_sigma: float = parameter(0.05, "its standard deviation at the start", unit="s", low=0.0, high=1.0)
    compass_error_share: float = parameter(
        0.5, "share of the variance of a compass increment that lasts from image to image, and beyond its reference",
        low=0.0, high=1.0,
    )  # fmt: skip
    compass_error_time: float = parameter(6.0, "its correlation time", unit="s", low=1e-3, high=1e3)
    gate_probability: float = parameter(
        0.9999, "share of consistent samples that the chi-square gate accepts", low=0.5, high=1.0 - 1e-12
    )
    recovery_time: float = parameter(
        1.0, "a sensor rejected for this long is used again, with inflated noise", unit="s", low=0.0, high=600.0
    )
    slip_recovery_time: float = parameter(
        10.0,
        "tracks rejected for this long are on other ground, not slipping: the variance of their scale is inflated",
        unit="s",
        low=0.0,
        high=600.0,
    )
