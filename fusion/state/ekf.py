"""The extended Kalman filter of the yaw: its states, its motion, and what each sensor sees of them.

The letters are the textbook's: state ``x``, covariance ``P``, transition ``F``, process noise ``Q``, measurement ``z``
with Jacobian ``H`` and noise variance ``R``, innovation variance ``S``, gain ``K``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from compass import wrap_angle
from fusion.buffer.events import NONSENSE_RATE
from fusion.config import FusionConfig
from fusion.record import record
from fusion.state.bounds import (
    LONGEST_STEP,
    LOST_YAW,
    ROUNDING,
    forget_beyond,
    limit_turn,
    loosened,
    rounding,
    symmetric,
)
from fusion.state.kalman_base import ExtendedKalmanFilter
from fusion.state.process_models import integrate_gauss_markov, turning

Array = npt.NDArray[np.float64]
CLONES = 5  # two images and a keyframe; two views some seconds apart
# Half or twice the `DELAY_WALK` changes nothing (docs/lab-notes/filter-2026-11-28.md). Jitter beyond what is configured
# does not count: where images contradict a gyro it is learnt to be large, and the delay would walk as far as it takes.
DELAY_WALK = 0.2  # 1/sqrt(s), wander of the camera's delay over the timestamp jitter


class State:
    """Where each quantity stands in the state vector: plain numbers, as an enumeration's cost more to index with."""

    YAW: Final = 0  # accumulated, rad
    RATE: Final = 1  # turn rate, rad/s
    ACCELERATION: Final = 2  # of the turning, rad/s^2
    BIAS: Final = 3  # what the gyro adds to the rate, rad/s, at the robot's present tilt
    SCALE: Final = 4  # turn rate claimed by the tracks over the true one
    GYRO_SCALE: Final = 5  # excess of the gyro's scale factor over one
    VEER: Final = 6  # turn that the tracks claim per metre driven straight, rad/m
    SLIP: Final = 7  # passing error of the tracks' turn rate, in units of its standard deviation
    TRACK_ERROR: Final = 8  # turn that slip and veer have added to the claim since the tracks' last reference, rad
    TRACK_REF: Final = 9  # yaw at that reference, rad
    STILL_REF: Final = 10  # yaw when the last sign of motion had died away, rad
    COMPASS_ERROR: Final = 11  # lasting error of the compass, in units of its standard deviation
    CAMERA_DELAY: Final = 12  # from the exposure of an image to its stamp, s
    CROSS_BIAS: Final = 13  # what the gyro adds about the robot's y axis, rad/s; a tilt turns it into BIAS
    LONG_BASELINE_ERROR: Final = 14  # the same of increments from some seconds ago
    CLONE: Final = 15  # first of CLONES yaws at the exposure of images, rad


DIM = State.CLONE + CLONES
IDENTITY = np.eye(DIM)
TURNING = np.s_[: State.ACCELERATION + 1, : State.ACCELERATION + 1]  # yaw, rate and acceleration
YAWS = np.array([s in (State.YAW, State.TRACK_REF, State.STILL_REF) or s >= State.CLONE for s in range(DIM)])


@record
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
    consider : tuple of int
        States that keep value and variance, only their correlations change (Schmidt 1966, "consider" states).
    """

    innovation: float
    H: Array
    R: float
    H_after: Array | None = None
    consider: tuple[int, ...] = ()


class Expectation(NamedTuple):
    """What a state says of a measurement that is not taken in yet.

    Attributes
    ----------
    PH : numpy.ndarray
        Covariance of all states with the expected value, shape (DIM,).
    R : float
        Variance of the measurement's noise, rounding included.
    S : float
        Variance that the innovation should have.
    """

    PH: Array
    R: float
    S: float


@dataclass(frozen=True, slots=True)
class Transition:
    """A step of the filter by which the state was multiplied with `F` (and possibly moved and widened)."""

    F: Array


@dataclass(frozen=True, slots=True)
class Correction:
    """A step of the filter that took in a measurement; names as in `Measurement`.

    `K` is the optimal gain, by which past errors and present ones lose what they have in common, even where the filter
    itself used another one because it only considers some states.
    """

    innovation: float
    H: Array
    H_after: Array
    S: float
    K: Array


class YawEkf(ExtendedKalmanFilter):
    """Yaw, turn rate, gyro bias, track scale and past yaws, estimated together.

    A past yaw (a *clone*) is a copy of the yaw state at the time of a compass reference, its correlation with all other
    states kept, because the compass measures the *difference* of two yaws (Roumeliotis & Burdick 2002, "Stochastic
    cloning", doi:10.1109/ROBOT.2002.1014801).
    """

    x: Array
    P: Array
    track_speed: float  # m/s, what the tracks last claimed
    slip_sigma: float  # rad/s, standard deviation of the passing error they have at that
    jitter: float  # s^2, variance of the images' timestamp jitter
    rate_walk_scale: float  # squared factor of `watched_rate_walk`, learnt
    bias_walk_scale: float  # that of `bias_walk`
    slip_turn: float  # squared factor of `track_slip_turn`, learnt
    slip_speed: float  # that of `track_slip_speed` and `track_noise`

    def __init__(self, config: FusionConfig) -> None:
        super().__init__(dim_x=DIM, dim_z=1)  # type: ignore[no-untyped-call]
        self.config = config
        self.x = np.zeros(DIM)
        self.x[YAWS] = config.initial_yaw
        self.x[State.SCALE] = config.initial_scale
        self.x[State.CAMERA_DELAY] = config.camera_delay
        sigma = np.zeros(DIM)
        sigma[State.RATE] = config.initial_rate_sigma
        sigma[State.ACCELERATION] = config.rate_walk / math.sqrt(2.0 * config.rate_ramp)
        sigma[State.BIAS] = sigma[State.CROSS_BIAS] = config.initial_bias_sigma
        sigma[State.SCALE] = config.initial_scale_sigma
        sigma[State.GYRO_SCALE] = config.gyro_scale_sigma
        sigma[State.VEER] = config.veer_sigma
        sigma[State.SLIP] = sigma[State.COMPASS_ERROR] = sigma[State.LONG_BASELINE_ERROR] = 1.0
        sigma[State.CAMERA_DELAY] = config.camera_delay_sigma
        self.P = np.diag(sigma**2)
        self.P[np.ix_(YAWS, YAWS)] = config.initial_yaw_sigma**2
        self.track_speed = self.slip_sigma = 0.0
        self.jitter = config.compass_timing**2
        self.rate_walk_scale = self.bias_walk_scale = self.slip_turn = self.slip_speed = 1.0
        self.tape: list[Transition | Correction] | None = None  # notes every step where somebody listens

    def fork(self, tape: list[Transition | Correction] | None) -> YawEkf:
        """The same filter to go on with, which notes every step on `tape`: arrays are replaced, never changed."""
        other = object.__new__(type(self))
        other.__dict__ = self.__dict__.copy()  # what copy.copy does, in a tenth of the time
        other.tape = tape
        return other

    def predict_for(self, dt: float, *, still: bool = False, watched: bool = False) -> None:
        """Move the state on by `dt` seconds; `still`: without any change of the turn rate; `watched`: by a gyro."""
        x, P = self.x, self.P
        F, Q = self.F, self.Q = self.transition(min(dt, LONGEST_STEP), still=still, watched=watched)
        self.predict()
        lost = self.P[State.YAW, State.YAW] > LOST_YAW**2
        if lost:
            self.x, self.P = x, P
            limit_turn(F, Q, P, State.YAW)
            self.predict()
        self.P = symmetric(self.P)
        if self.tape is not None:
            self.tape.append(Transition(F))
        del self.F, self.Q  # the timeline keeps states, and these fill a processor's cache
        if lost:
            x = self.x
            self.transform(forget_beyond(self.P, State.YAW, YAWS))
            self.x = x

    def predict(self, u: float = 0.0) -> None:
        """As the base class, without a control input, and without copies of what is predicted."""
        F = self.F
        self.x = F.dot(self.x)
        self.P = F.dot(self.P).dot(F.T)
        self.P += self.Q

    def transition(self, dt: float, *, still: bool = False, watched: bool = False) -> tuple[Array, Array]:
        """Transition F and process noise Q over `dt` seconds.

        The acceleration is Gauss-Markov, rate and yaw are its integrals; once the rate's variance would exceed that of
        a robot nobody measures, it relaxes to zero instead (Ornstein-Uhlenbeck). Bias and scale walk, slip and compass
        error are Gauss-Markov.
        """
        config = self.config
        F, Q = IDENTITY.copy(), np.zeros((DIM, DIM))
        q = config.watched_rate_walk**2 * self.rate_walk_scale if watched else config.rate_walk**2
        prior, ramp = config.initial_rate_sigma**2, config.rate_ramp
        F[State.YAW, State.RATE] = dt
        if still or self.P[State.RATE, State.RATE] + q * dt > prior:
            F[State.ACCELERATION, State.ACCELERATION] = math.exp(-dt / ramp)
            Q[State.ACCELERATION, State.ACCELERATION] = -math.expm1(-2.0 * dt / ramp) * q / (2.0 * ramp)
            if not still:
                integrate_gauss_markov(F, Q, State.RATE, State.YAW, 2.0 * prior / q, prior**0.5, 1.0, dt)
        else:
            F[TURNING], noise = turning(ramp, dt)
            Q[TURNING] = q * noise
        Q[State.BIAS, State.BIAS] = config.bias_walk**2 * self.bias_walk_scale * dt
        Q[State.CROSS_BIAS, State.CROSS_BIAS] = config.bias_walk**2 * dt
        Q[State.SCALE, State.SCALE] = config.scale_walk**2 * dt
        Q[State.CAMERA_DELAY, State.CAMERA_DELAY] = DELAY_WALK**2 * min(self.jitter, config.compass_timing**2) * dt
        F[State.TRACK_ERROR, State.VEER] = self.track_speed * dt
        integrate_gauss_markov(F, Q, State.SLIP, State.TRACK_ERROR, config.slip_time, 1.0, self.slip_sigma, dt)
        faded = dt / config.compass_error_time
        kept, renewed = math.exp(-faded), -math.expm1(-2.0 * faded)
        for error in (State.COMPASS_ERROR, State.LONG_BASELINE_ERROR):
            F[error, error], Q[error, error] = kept, renewed
        return F, Q

    def transform(self, T: Array) -> None:
        """Multiply the state with `T`."""
        self.x = T @ self.x
        self.P = symmetric(T.dot(self.P).dot(T.T))
        if self.tape is not None:
            self.tape.append(Transition(T))

    def clone_yaw(self, into: int) -> None:
        """Copy the present yaw, with all its correlations, into state `into`."""
        T = IDENTITY.copy()
        T[into] = T[State.YAW]
        self.transform(T)

    def renew(self, index: int, variance: float, value: float = 0.0) -> None:
        """Forget state `index`: it is `value`, known with `variance`, and not correlated with the others."""
        T = IDENTITY.copy()
        T[index, index] = 0.0
        self.transform(T)
        self.x[index] = value
        self.P[index, index] = variance

    def place_yaw(self) -> None:
        """Take the yaw for what it is, whatever the turn rate was: one that is measured later says nothing of it."""
        for one in (State.RATE, State.ACCELERATION):
            self.renew(one, float(self.P[one, one]), float(self.x[one]))

    def anchor(self, into: int, measurement: Measurement) -> None:
        """Set clone `into` to what a compass measurement since it says, as if nothing had been known of it.

        Afterwards the measurement's innovation is zero: it corrects nothing in the present yaw, those after it will.
        """
        T = IDENTITY.copy()
        T[into] += measurement.H[0]  # the measured difference is a later clone - this one + lasting error + noise
        x = self.x.copy()
        x[into] -= measurement.innovation
        self.transform(T)
        self.x = x
        self.P[into, into] += measurement.R

    def turn_frame(self, heading: float, variance: float) -> None:
        """Give the present yaw a new value, known with `variance`, without losing the turn count or the references."""
        x = self.x + np.where(YAWS, wrap_angle(heading - float(self.x[State.YAW])), 0.0)
        T = IDENTITY.copy()
        T[YAWS, State.YAW] -= 1.0  # past yaws keep their difference to the present one, and its uncertainty
        self.transform(T)
        self.x = x
        self.P[np.ix_(YAWS, YAWS)] += variance

    def widen(self, index: int, variance: float) -> None:
        """Add to the variance of state `index`, as far as more than that means anything."""
        if variance == 0.0:
            return
        self.P = self.P.copy()
        self.P[index, index] += min(variance, (LOST_YAW if YAWS[index] else NONSENSE_RATE) ** 2)

    def widen_frame(self, variance: float) -> None:
        """Add to the variance of all yaws alike: by so much the whole past may be turned."""
        self.P = self.P.copy()
        self.P[np.ix_(YAWS, YAWS)] += variance

    def expect(self, measurement: Measurement) -> Expectation:
        """What the present state says of a measurement that was made from it."""
        H = measurement.H[0]
        PH, R = self.P.dot(H), measurement.R + rounding(H, self.P)
        return Expectation(PH, R, max(float(H.dot(PH)), 0.0) + R)

    def correct(self, measurement: Measurement, expected: Expectation | None = None) -> None:
        """Update with a measurement made from the present state, and with what that says of it, if known."""
        prior_x, prior_P = self.x, self.P
        expected = expected or self.expect(measurement)
        H, PH, S = measurement.H, expected.PH, expected.S
        optimal = K = PH / S
        if measurement.consider:
            K = optimal.copy()
            for state in measurement.consider:
                K[state] = 0.0
        self.x = prior_x + K.dot(measurement.innovation)  # with a number `dot` is the quicker product
        # (I - K H) P (I - K H)' + K R K', for any gain (Bucy & Joseph 1968), as a change of rank two: half of it
        if measurement.H_after is not None:
            H, PH = measurement.H_after, prior_P.dot(measurement.H_after[0])
            S = float(H[0].dot(PH)) + expected.R
        half = K[:, None].dot((K.dot(0.5 * S) - PH)[None, :])
        self.P = half.T.copy()  # as in `symmetric`
        self.P += half
        self.P += prior_P
        variances = self.P.reshape(-1)[:: DIM + 1]
        variances += prior_P.diagonal().dot(ROUNDING)
        if not variances[variances.argmin()] >= 0.0:
            self.x, self.P = prior_x, loosened(prior_P)
            return
        if self.tape is not None:
            self.tape.append(Correction(measurement.innovation, measurement.H, H, expected.S, optimal[:, None]))
