"""The extended Kalman filter of the yaw: its states, its motion, and what each sensor sees of them.

The letters are the textbook's: state ``x``, covariance ``P``, transition ``F``, process noise ``Q``, measurement ``z``
with Jacobian ``H`` and noise variance ``R``, innovation variance ``S``, gain ``K``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter

from compass import wrap_angle
from fusion.config import FusionConfig

Array = npt.NDArray[np.float64]
CLONES = 3


class State(IntEnum):
    """Where each quantity stands in the state vector."""

    YAW = 0  # accumulated, rad
    RATE = 1  # turn rate, rad/s
    BIAS = 2  # what the gyro adds to the rate, rad/s
    SCALE = 3  # turn rate claimed by the tracks over the true one
    GYRO_SCALE = 4  # excess of the gyro's scale factor over one
    VEER = 5  # turn that the tracks claim per metre driven straight, rad/m
    SLIP = 6  # passing error of the tracks, in units of its standard deviation
    COMPASS_ERROR = 7  # lasting error of the compass, in units of its standard deviation
    TRACK_REF = 8  # yaw at the last pose of the track odometry, rad
    CLONE = 9  # first of CLONES yaws at compass references, rad


DIM = State.CLONE + CLONES
YAWS = np.array([s == State.YAW or s >= State.TRACK_REF for s in range(DIM)])


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
    H_after : numpy.ndarray or None
        Jacobian at the updated state where it differs: the gain comes from `H`, the covariance that this gain leaves
        behind from `H_after`.
    consider : tuple of State
        States that keep value and variance, only their correlations change (Schmidt-Kalman filter).
    """

    innovation: float
    H: Array
    R: float
    H_after: Array | None = None
    consider: tuple[State, ...] = ()


class YawEkf(ExtendedKalmanFilter):
    """Yaw, turn rate, gyro bias, track scale and past yaws, estimated together.

    A past yaw (a *clone*) is a copy of the yaw state at the time of a compass reference, its correlation with all other
    states kept, because the compass measures the *difference* of two yaws (Roumeliotis & Burdick 2002, "Stochastic
    cloning", doi:10.1109/ROBOT.2002.1014801).
    """

    x: Array
    P: Array

    def __init__(self, config: FusionConfig) -> None:
        super().__init__(dim_x=DIM, dim_z=1)  # type: ignore[no-untyped-call]
        self.config = config
        self.x = np.zeros(DIM)
        self.x[YAWS] = config.initial_yaw
        self.x[State.SCALE] = config.initial_scale
        sigma = np.zeros(DIM)
        sigma[State.RATE] = config.initial_rate_sigma
        sigma[State.BIAS] = config.initial_bias_sigma
        sigma[State.SCALE] = config.initial_scale_sigma
        sigma[State.GYRO_SCALE] = config.gyro_scale_sigma
        sigma[State.VEER] = config.veer_sigma
        sigma[State.SLIP] = sigma[State.COMPASS_ERROR] = 1.0
        self.P = np.diag(sigma**2)
        self.P[np.ix_(YAWS, YAWS)] = config.initial_yaw_sigma**2

    def predict_for(self, dt: float) -> None:
        """Move the state on by `dt` seconds."""
        self.F, self.Q = self.transition(dt)
        self.predict()  # type: ignore[no-untyped-call]

    def transition(self, dt: float) -> tuple[Array, Array]:
        """Transition F and process noise Q over `dt` seconds.

        The turn rate walks randomly, the yaw is its integral; once the rate's variance would exceed that of a robot
        nobody measures, it relaxes to zero instead (Ornstein-Uhlenbeck). Bias and scale walk, slip and compass error
        are Gauss-Markov.
        """
        config = self.config
        F, Q = np.eye(DIM), np.zeros((DIM, DIM))
        q, prior = config.rate_walk**2, config.initial_rate_sigma**2
        if self.P[State.RATE, State.RATE] + q * dt > prior:
            a = q / (2.0 * prior)
            e = math.exp(-a * dt)
            F[State.YAW, State.RATE], F[State.RATE, State.RATE] = (1.0 - e) / a, e
            yaw = prior * (2.0 * a * dt - 3.0 + 4.0 * e - e**2) / a**2
            cross, rate = prior * (1.0 - e) ** 2 / a, prior * (1.0 - e**2)
        else:
            F[State.YAW, State.RATE] = dt
            yaw, cross, rate = q * dt**3 / 3.0, q * dt**2 / 2.0, q * dt
        Q[State.YAW, State.YAW], Q[State.RATE, State.RATE] = yaw, rate
        Q[State.YAW, State.RATE] = Q[State.RATE, State.YAW] = cross
        Q[State.BIAS, State.BIAS] = config.bias_walk**2 * dt
        Q[State.SCALE, State.SCALE] = config.scale_walk**2 * dt
        F[State.SLIP, State.SLIP] = math.exp(-dt / config.slip_time)
        Q[State.SLIP, State.SLIP] = -math.expm1(-2.0 * dt / config.slip_time)
        F[State.COMPASS_ERROR, State.COMPASS_ERROR] = math.exp(-dt / config.compass_error_time)
        Q[State.COMPASS_ERROR, State.COMPASS_ERROR] = -math.expm1(-2.0 * dt / config.compass_error_time)
        return F, Q

    def clone_yaw(self, into: int) -> None:
        """Copy the present yaw, with all its correlations, into state `into`."""
        source = np.arange(DIM)
        source[into] = State.YAW
        self.x = self.x[source]
        self.P = self.P[np.ix_(source, source)]

    def renew(self, index: State, variance: float) -> None:
        """Forget state `index`: it is 0, known with `variance` (its unit squared), and tells nothing of others."""
        keep = np.arange(DIM) != index
        self.x = np.where(keep, self.x, 0.0)
        self.P = np.where(keep[:, None] & keep, self.P, 0.0)
        self.P[index, index] = variance

    def anchor(self, into: int, measurement: Measurement) -> None:
        """Set clone `into` to what a compass measurement since it says, as if nothing had been known of it.

        Afterwards the measurement's innovation is zero: it tells nothing of the present yaw, those after it will.
        """
        T = np.eye(DIM)
        T[into] += measurement.H[0]  # the measured difference is yaw - clone + lasting error + noise
        self.x = self.x.copy()
        self.x[into] -= measurement.innovation
        self.P = T @ self.P @ T.T
        self.P[into, into] += measurement.R

    def turn_frame(self, heading: float, variance: float) -> None:
        """Give the present yaw a new value, known with `variance`, without losing the turn count or the references."""
        turn = float(wrap_angle(heading - self.x[State.YAW]))
        self.x = self.x + np.where(YAWS, turn, 0.0)
        T = np.eye(DIM)
        T[YAWS, State.YAW] -= 1.0  # past yaws keep their difference to the present one, and its uncertainty
        self.P = T @ self.P @ T.T
        self.P[np.ix_(YAWS, YAWS)] += variance

    def gyro(self, yaw_rate: float, variance: float | None) -> Measurement:
        """What a gyro sample (rad/s, variance (rad/s)^2) says: (1 + gyro scale) rate + bias."""
        x = self.x
        rate, gain = float(x[State.RATE]), 1.0 + float(x[State.GYRO_SCALE])
        H = np.zeros((1, DIM))
        H[0, State.RATE], H[0, State.BIAS], H[0, State.GYRO_SCALE] = gain, 1.0, rate
        R = self.config.gyro_sigma**2 if variance is None else variance
        return Measurement(yaw_rate - gain * rate - float(x[State.BIAS]), H, R)

    def track_rate(self, yaw_rate: float, speed: float, *, alone: bool = False) -> Measurement:
        """What the tracks' claimed turn rate (rad/s) at a claimed speed (m/s) says: scale rate + veer speed + slip.

        `alone` says that nothing else measures the turning. Scale and slip cannot be observed then (linearised, the
        tracks would seem to tell them all the same), so they are only considered.
        """
        M = np.zeros(DIM)
        M[State.RATE] = 1.0
        return self._tracks(yaw_rate, M, speed, 1.0, alone)

    def track_turn(self, turn: float, speed: float, dt: float, *, alone: bool = False) -> Measurement:
        """What the turn (rad) between two poses `dt` s apart says: the same as the rate, times `dt`."""
        M = np.zeros(DIM)
        M[State.YAW], M[State.TRACK_REF] = 1.0, -1.0
        expected = self.x[State.SCALE] * (M @ self.x)
        counted = float(expected + wrap_angle(turn - expected))  # a pose counts no turns
        return self._tracks(counted, M, speed, dt, alone)

    def _tracks(self, z: float, M: Array, speed: float, dt: float, alone: bool) -> Measurement:
        """Linearise a claim `z` on the motion ``M x``, made over `dt` s (1: a rate).

        The second-order terms of scale times motion are kept (Bar-Shalom, Li & Kirubarajan 2001, section 10.3.2), but
        not when the tracks are alone: then the two err together so that their product is right. From sample to sample
        the motion changes by more than its noise, so scale and slip go into the rate by the *new* motion: `H_after`.
        """
        PM = self.P @ M
        moved, scale = float(M @ self.x), float(self.x[State.SCALE])
        H = scale * M
        H[State.VEER] = speed * dt
        H[State.SLIP] = self._slip(scale * moved / dt, speed) * dt
        innovation = z - float(H @ self.x)
        H[State.SCALE] = moved
        R = (self.config.track_sigma * dt) ** 2
        if not alone:
            cross = float(PM[State.SCALE])
            innovation -= cross
            R += float(self.P[State.SCALE, State.SCALE]) * float(M @ PM) + cross**2
        PH = self.P @ H
        H_after = H.copy()
        H_after[State.SCALE] += float(M @ PH) / (float(H @ PH) + R) * innovation
        H_after[State.SLIP] = self._slip(z / dt, speed) * dt
        consider = (State.SCALE, State.SLIP) if alone else ()
        return Measurement(innovation, H[None, :], R, H_after[None, :], consider)

    def _slip(self, yaw_rate: float, speed: float) -> float:
        """Standard deviation of the tracks' passing error, rad/s: it grows with turning and with speed."""
        return math.hypot(self.config.track_slip_turn * yaw_rate, self.config.track_slip_speed * speed)

    def compass(self, yaw: float, variance: float, clone: int) -> Measurement:
        """What an increment (rad, variance rad^2) since state `clone` says: a difference of yaws, modulo a turn.

        Part of its error lasts from image to image (the reference's own error, parallax): the share
        ``compass_error_share`` of the variance is that of a Gauss-Markov state, the rest is white.
        """
        share = self.config.compass_error_share
        H = np.zeros((1, DIM))
        H[0, State.YAW], H[0, clone] = 1.0, -1.0
        H[0, State.COMPASS_ERROR] = math.sqrt(share * variance)
        return Measurement(float(wrap_angle(yaw - float((H @ self.x)[0]))), H, (1.0 - share) * variance)

    def innovation_variance(self, measurement: Measurement) -> float:
        """Variance S that the innovation should have."""
        return float((measurement.H @ self.P @ measurement.H.T)[0, 0]) + measurement.R

    def correct(self, measurement: Measurement) -> None:
        """Update with a measurement made from the present state."""
        prior_x, prior_P = self.x, self.P
        innovation = np.array([measurement.innovation])
        self.update(  # type: ignore[no-untyped-call]
            innovation,
            HJacobian=lambda x: measurement.H,
            Hx=lambda x: None,
            R=measurement.R,
            residual=lambda z, expected: innovation,  # expected value taken off, and wrapped, already
        )
        if measurement.consider or measurement.H_after is not None:
            H = measurement.H if measurement.H_after is None else measurement.H_after
            K = self.K.copy()
            K[list(measurement.consider)] = 0.0
            A = np.eye(DIM) - K @ H
            self.x = prior_x + K[:, 0] * measurement.innovation
            self.P = A @ prior_P @ A.T + measurement.R * (K @ K.T)  # Joseph: holds for any gain
