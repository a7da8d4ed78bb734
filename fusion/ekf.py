"""The extended Kalman filter of the yaw: its states, its motion, and what each sensor sees of them.

The letters are the textbook's: state ``x``, covariance ``P``, transition ``F``, process noise ``Q``, measurement ``z``
with Jacobian ``H`` and noise variance ``R``, innovation variance ``S``, gain ``K``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter

from compass import wrap_angle
from fusion.config import FusionConfig

Array = npt.NDArray[np.float64]
CLONES = 4


class State(IntEnum):
    """Where each quantity stands in the state vector."""

    YAW = 0  # accumulated, rad
    RATE = 1  # rad/s
    BIAS = 2  # of the gyro, rad/s
    SCALE = 3  # turn rate claimed by the tracks over the true one
    CLONE = 4  # first of CLONES past yaws, rad


DIM = State.CLONE + CLONES


@dataclass(frozen=True, slots=True)
class Measurement:
    """A scalar measurement, linearised at the present state.

    Attributes
    ----------
    innovation : float
        Measured minus expected, in the sensor's unit.
    H : numpy.ndarray
        Jacobian of the expected value, shape (1, DIM).
    R : float
        Variance of the measurement's noise.
    """

    innovation: float
    H: Array
    R: float


class YawEkf(ExtendedKalmanFilter):
    """Yaw, turn rate, gyro bias, track scale and past yaws, estimated together.

    A past yaw (a *clone*) is a copy of the yaw state at the time of a compass reference, its correlation with all other
    states kept, because the compass measures the *difference* of two yaws (Roumeliotis & Burdick 2002, "Stochastic
    cloning", doi:10.1109/ROBOT.2002.1014801).
    """

    def __init__(self, config: FusionConfig) -> None:
        super().__init__(dim_x=DIM, dim_z=1)  # type: ignore[no-untyped-call]
        self.config = config
        self.x = np.zeros(DIM)
        self.x[State.YAW] = config.initial_yaw
        self.x[State.SCALE] = config.initial_scale
        sigma = np.zeros(DIM)
        sigma[State.YAW] = config.initial_yaw_sigma
        sigma[State.RATE] = config.initial_rate_sigma
        sigma[State.BIAS] = config.initial_bias_sigma
        sigma[State.SCALE] = config.initial_scale_sigma
        self.P = np.diag(sigma**2)

    def predict_for(self, dt: float) -> None:
        """Move the state on by `dt` seconds."""
        self.F, self.Q = self.transition(dt)
        self.predict()  # type: ignore[no-untyped-call]

    def transition(self, dt: float) -> tuple[Array, Array]:
        """Transition and process noise over `dt` seconds.

        The turn rate walks randomly. Once its variance would exceed that of a robot nobody measures, it relaxes to
        zero instead (Ornstein-Uhlenbeck process whose stationary variance is ``initial_rate_sigma**2``).
        """
        q = self.config.rate_walk**2
        prior = self.config.initial_rate_sigma**2
        F, Q = np.eye(DIM), np.zeros((DIM, DIM))
        if self.P[State.RATE, State.RATE] + q * dt > prior:
            decay = np.exp(-dt * q / (2.0 * prior))
            F[State.YAW, State.RATE] = (1.0 - decay) * 2.0 * prior / q
            F[State.RATE, State.RATE] = decay
        else:
            F[State.YAW, State.RATE] = dt
        Q[State.YAW, State.YAW] = q * dt**3 / 3.0
        Q[State.YAW, State.RATE] = Q[State.RATE, State.YAW] = q * dt**2 / 2.0
        Q[State.RATE, State.RATE] = q * dt
        Q[State.BIAS, State.BIAS] = self.config.bias_walk**2 * dt
        Q[State.SCALE, State.SCALE] = self.config.scale_walk**2 * dt
        return F, Q

    def clone_yaw(self, slot: int) -> None:
        """Copy the present yaw, with all its correlations, into clone `slot`."""
        source = np.arange(DIM)
        source[State.CLONE + slot] = State.YAW
        self.x = self.x[source]
        self.P = self.P[np.ix_(source, source)]

    def gyro(self, yaw_rate: float, variance: float | None) -> Measurement:
        """What a gyro sample (rad/s, variance (rad/s)^2) says: rate plus bias."""
        H = np.zeros((1, DIM))
        H[0, State.RATE] = H[0, State.BIAS] = 1.0
        R = self.config.gyro_sigma**2 if variance is None else variance
        return Measurement(float(yaw_rate - self.x[State.RATE] - self.x[State.BIAS]), H, R)

    def tracks(self, yaw_rate: float) -> Measurement:
        """What the tracks' claimed turn rate (rad/s) says: scale times rate."""
        rate, scale = float(self.x[State.RATE]), float(self.x[State.SCALE])
        H = np.zeros((1, DIM))
        H[0, State.RATE], H[0, State.SCALE] = scale, rate
        R = self.config.track_sigma**2 + (self.config.track_slip * rate) ** 2
        return Measurement(yaw_rate - scale * rate, H, R)

    def compass(self, yaw: float, variance: float, slot: int) -> Measurement:
        """What an increment (rad, variance rad^2) since clone `slot` says: a difference of yaws, modulo a turn."""
        H = np.zeros((1, DIM))
        H[0, State.YAW], H[0, State.CLONE + slot] = 1.0, -1.0
        expected = self.x[State.YAW] - self.x[State.CLONE + slot]
        return Measurement(float(wrap_angle(yaw - expected)), H, variance)

    def innovation_variance(self, measurement: Measurement) -> float:
        """Variance S that the innovation should have."""
        H = measurement.H
        return float((H @ self.P @ H.T)[0, 0]) + measurement.R

    def correct(self, measurement: Measurement, R: float | None = None) -> None:
        """Update with a measurement made from the present state, optionally with another noise variance."""
        innovation = np.array([measurement.innovation])
        residual: Callable[[Array, Array], Array] = lambda z, hx: innovation  # noqa: E731 - wrapped already
        self.update(  # type: ignore[no-untyped-call]
            innovation,
            HJacobian=lambda x: measurement.H,
            Hx=lambda x: measurement.H @ x,
            R=measurement.R if R is None else R,
            residual=residual,
        )
