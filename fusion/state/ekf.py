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
from fusion.buffer.events import FASTEST
from fusion.config import FusionConfig
from fusion.imu.tilt import BiasGain
from fusion.state.bounds import LONGEST_STEP, LOST, blurred, forget_beyond, limit_turn, loosened, rounding, symmetric
from fusion.state.learnt_noise import LearntNoise
from fusion.state.process_models import integrate_gauss_markov, turning
from fusion.updates.image_timing import Exposure, GyroTrail

Array = npt.NDArray[np.float64]
CLONES = 5  # two images and a keyframe; two views some seconds apart
LASTING = 0.5  # share of an increment's variance that is taken to last beyond it, of one from the keyframe at most
CREEP_RATE = 5e-4  # rad/s, slower than standstill can be told from
DELAY_WALK = 0.2  # 1/sqrt(s), wander of the camera's delay for what its stamps stray by
LEAST_OTHERS = 0.05  # share of an innovation's variance that is no slip, at least: what correlations hide of it
STILL_TURN = 1e-5  # rad, what standing still leaves of a turn


class State(IntEnum):
    """Where each quantity stands in the state vector."""

    YAW = 0  # accumulated, rad
    RATE = 1  # turn rate, rad/s
    BIAS = 2  # what the gyro adds to the rate, rad/s, as the robot leans now
    SCALE = 3  # turn rate claimed by the tracks over the true one
    ACCELERATION = 4  # of the turning, rad/s^2
    GYRO_SCALE = 5  # excess of the gyro's scale factor over one
    VEER = 6  # turn that the tracks claim per metre driven straight, rad/m
    SLIP = 7  # passing error of the tracks' turn rate, in units of its standard deviation
    TRACK_ERROR = 8  # turn that slip and veer have added to the claim since the last reference of the tracks, rad
    TRACK_REF = 9  # yaw at that reference, rad
    STILL_REF = 10  # yaw when the last sign of motion had died away, rad
    COMPASS_ERROR = 11  # lasting error of the compass, in units of its standard deviation
    CAMERA_DELAY = 12  # from the exposure of an image to its stamp, s
    CROSS_BIAS = 13  # what the gyro adds about the robot's y axis, rad/s; a robot that leans turns it into BIAS
    FAR_ERROR = 14  # the same of increments from some seconds ago
    CLONE = 15  # first of CLONES yaws at the exposure of images, rad


DIM = State.CLONE + CLONES
TURNING = [State.YAW, State.RATE, State.ACCELERATION]
_TURNING_BLOCK = np.ix_(TURNING, TURNING)
YAWS = np.array([s in (State.YAW, State.TRACK_REF, State.STILL_REF) or s >= State.CLONE for s in range(DIM)])


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
    track_stray: float  # rad/s, standard deviation of the passing error they have at that
    stray: float  # s^2, variance by which images stray from their stamps
    agility: float  # squared factor of `watched_rate_walk`, learnt
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
        sigma[State.SLIP] = sigma[State.COMPASS_ERROR] = sigma[State.FAR_ERROR] = 1.0
        sigma[State.CAMERA_DELAY] = config.camera_delay_sigma
        self.P = np.diag(sigma**2)
        self.P[np.ix_(YAWS, YAWS)] = config.initial_yaw_sigma**2
        self.track_speed = self.track_stray = 0.0
        self.stray = config.compass_timing**2
        self.agility = self.slip_turn = self.slip_speed = 1.0
        self.tape: list[Transition | Correction] | None = None  # notes every step where somebody listens

    def predict_for(self, dt: float, *, still: bool = False, watched: bool = False) -> None:
        """Move the state on by `dt` seconds; `still`: without any change of the turn rate; `watched`: by a gyro."""
        self.F, self.Q = self.transition(min(dt, LONGEST_STEP), still=still, watched=watched)
        limit_turn(self.F, self.Q, self.P, State.YAW)
        self.predict()  # type: ignore[no-untyped-call]
        self.P = symmetric(self.P)
        if self.tape is not None:
            self.tape.append(Transition(self.F))
        forgetting = forget_beyond(self.P, State.YAW, YAWS)
        if forgetting is not None:
            x = self.x
            self._transform(forgetting)
            self.x = x

    def transition(self, dt: float, *, still: bool = False, watched: bool = False) -> tuple[Array, Array]:
        """Transition F and process noise Q over `dt` seconds.

        The acceleration is Gauss-Markov, rate and yaw are its integrals; once the rate's variance would exceed that of
        a robot nobody measures, it relaxes to zero instead (Ornstein-Uhlenbeck). Bias and scale walk, slip and compass
        error are Gauss-Markov.
        """
        config = self.config
        F, Q = np.eye(DIM), np.zeros((DIM, DIM))
        q = config.watched_rate_walk**2 * self.agility if watched else config.rate_walk**2
        prior, ramp = config.initial_rate_sigma**2, config.rate_ramp
        F[State.YAW, State.RATE] = dt
        if still or self.P[State.RATE, State.RATE] + q * dt > prior:
            F[State.ACCELERATION, State.ACCELERATION] = math.exp(-dt / ramp)
            Q[State.ACCELERATION, State.ACCELERATION] = -math.expm1(-2.0 * dt / ramp) * q / (2.0 * ramp)
            if not still:
                integrate_gauss_markov(F, Q, State.RATE, State.YAW, 2.0 * prior / q, prior**0.5, 1.0, dt)
        else:
            F[_TURNING_BLOCK], Q[_TURNING_BLOCK] = turning(q, ramp, dt)
        Q[State.BIAS, State.BIAS] = Q[State.CROSS_BIAS, State.CROSS_BIAS] = config.bias_walk**2 * dt
        Q[State.SCALE, State.SCALE] = config.scale_walk**2 * dt
        Q[State.CAMERA_DELAY, State.CAMERA_DELAY] = DELAY_WALK**2 * self.stray * dt
        F[State.TRACK_ERROR, State.VEER] = self.track_speed * dt
        integrate_gauss_markov(F, Q, State.SLIP, State.TRACK_ERROR, config.slip_time, 1.0, self.track_stray, dt)
        for error in (State.COMPASS_ERROR, State.FAR_ERROR):
            F[error, error] = math.exp(-dt / config.compass_error_time)
            Q[error, error] = -math.expm1(-2.0 * dt / config.compass_error_time)
        return F, Q

    def hear_tracks(self, yaw_rate: float, speed: float) -> None:
        """Note what the tracks claim (rad/s, m/s): how far they stray grows with turning and with speed."""
        self.track_speed = speed
        self.track_stray = math.sqrt(
            self.slip_turn * (self.config.track_slip_turn * yaw_rate) ** 2
            + self.slip_speed * (self.config.track_slip_speed * speed) ** 2
        )

    def learnt_slip(
        self, known: tuple[LearntNoise, LearntNoise], measurement: Measurement, yaw_rate: float, seconds: float
    ) -> tuple[LearntNoise, LearntNoise]:
        """How the tracks slip by turning and by driving, after a turn over `seconds`, at most at `yaw_rate`, rad/s.

        What slip gives to the innovation's variance is split as it is configured, at the factors known so far.
        """
        config, S = self.config, self.innovation_variance(measurement)
        white = config.track_noise**2 * seconds
        lasting = config.slip_time * seconds  # of an integral over slip, but for a constant that cancels
        turning = (config.track_slip_turn * yaw_rate) ** 2 * lasting
        driving = (config.track_slip_speed * self.track_speed) ** 2 * lasting + white
        slipping = self.slip_turn * turning + self.slip_speed * driving
        slipped = float(self.P[State.TRACK_ERROR, State.TRACK_ERROR]) + self.slip_speed * white
        share = slipped / slipping if slipping > 0.0 else 0.0
        turning, driving = share * turning, share * driving
        others = max(S - slipped, LEAST_OTHERS * S)
        by_turn, by_speed = known
        return (
            by_turn.after(measurement.innovation, others + self.slip_speed * driving, math.sqrt(turning)),
            by_speed.after(measurement.innovation, others + self.slip_turn * turning, math.sqrt(driving)),
        )

    def allow_start(self, seconds: float) -> None:
        """Let the turn rate have changed for `seconds` as it may by the configuration, if it was learnt to be calmer.

        A robot that drove straight for long turns all the same.
        """
        missing = self.config.watched_rate_walk**2 * (1.0 - self.agility)
        if missing > 0.0:
            self.P = self.P.copy()
            self.P[_TURNING_BLOCK] += turning(missing, self.config.rate_ramp, min(seconds, LONGEST_STEP))[1]

    def open_rate(self, sigma: float, within: float, seen: float) -> None:
        """Let the turn rate have changed at once, by `sigma` (rad/s) or so, at some time in the last `within` seconds.

        What was turned since goes with it. `seen` is by how much it seems to have changed: so much of the turn is
        uncertain as the time is.
        """
        self.P = self.P.copy()
        self.P[np.ix_([State.YAW, State.RATE], [State.YAW, State.RATE])] += sigma**2 * np.array(
            [[within**2 / 4.0, within / 2.0], [within / 2.0, 1.0]]
        )
        self.P[State.YAW, State.YAW] += (seen * within) ** 2 / 12.0

    def refer_tracks(self) -> None:
        """Make the present the reference of the tracks."""
        self.clone_yaw(State.TRACK_REF)
        self.renew(State.TRACK_ERROR, 0.0)

    def _transform(self, T: Array) -> None:
        """Multiply the state with `T`."""
        self.x = T @ self.x
        self.P = symmetric(T @ self.P @ T.T)
        if self.tape is not None:
            self.tape.append(Transition(T))

    def lean(self, before: BiasGain, now: BiasGain) -> None:
        """Turn the bias with the robot, which leant as `before` and leans as `now`."""
        T = np.eye(DIM)
        T[State.BIAS, State.BIAS] = now.own / before.own
        T[State.BIAS, State.CROSS_BIAS] = now.cross - before.cross * now.own / before.own
        self._transform(T)

    def clone_yaw(self, into: int) -> None:
        """Copy the present yaw, with all its correlations, into state `into`."""
        T = np.eye(DIM)
        T[into] = T[State.YAW]
        self._transform(T)

    def exposure(self, t_ns: int, trail: GyroTrail | None) -> Exposure:
        """What happened between the exposure of an image stamped `t_ns`, the present, and that stamp.

        Without a gyro's `trail` the delay is taken for known: nothing else could tell it, and as an unknown it would
        let the tracks draw the yaw about.
        """
        delay, variance = float(self.x[State.CAMERA_DELAY]), float(self.P[State.CAMERA_DELAY, State.CAMERA_DELAY])
        if trail is None:
            return Exposure(delay, float(self.x[State.RATE]) * delay)
        claimed = trail.exposure(t_ns, delay, variance, self.config.gyro_sigma**2)
        bias, gain = float(self.x[State.BIAS]), 1.0 + float(self.x[State.GYRO_SCALE])
        turn, rate = (claimed.turn - bias * delay) / gain, (claimed.rate - bias) / gain
        unseen = self.config.watched_rate_walk**2 * max(-delay, 0.0) ** 3 / 3.0  # exposed after the last sample
        return Exposure(delay, turn, rate, claimed.variance + unseen, watched=True)

    def clone_exposure(self, into: int, exposure: Exposure) -> None:
        """Copy the yaw that an image of the present stamp shows: that of its exposure, which strays."""
        T = np.eye(DIM)
        T[into] = T[State.YAW]
        T[into, State.CAMERA_DELAY] = -exposure.rate
        if exposure.watched:
            gain = 1.0 + float(self.x[State.GYRO_SCALE])
            T[into, State.BIAS], T[into, State.GYRO_SCALE] = exposure.delay / gain, exposure.turn / gain
        else:
            T[into, State.RATE] = -exposure.delay
        exposed = float(self.x[State.YAW]) - exposure.turn
        rate_squared = float(self.x[State.RATE]) ** 2 + float(self.P[State.RATE, State.RATE])
        self._transform(T)
        self.x[into] = exposed
        self.widen(into, self.stray * rate_squared + exposure.variance)

    def renew(self, index: State, variance: float, value: float = 0.0) -> None:
        """Forget state `index`: it is `value`, known with `variance`, and tells nothing of the others."""
        T = np.eye(DIM)
        T[index, index] = 0.0
        self._transform(T)
        self.x[index] = value
        self.P[index, index] = variance

    def anchor(self, into: int, measurement: Measurement) -> None:
        """Set clone `into` to what a compass measurement since it says, as if nothing had been known of it.

        Afterwards the measurement's innovation is zero: it tells nothing of the present yaw, those after it will.
        """
        T = np.eye(DIM)
        T[into] += measurement.H[0]  # the measured difference is a later clone - this one + lasting error + noise
        x = self.x.copy()
        x[into] -= measurement.innovation
        self._transform(T)
        self.x = x
        self.P[into, into] += measurement.R

    def turn_frame(self, heading: float, variance: float) -> None:
        """Give the present yaw a new value, known with `variance`, without losing the turn count or the references."""
        x = self.x + np.where(YAWS, wrap_angle(heading - float(self.x[State.YAW])), 0.0)
        T = np.eye(DIM)
        T[YAWS, State.YAW] -= 1.0  # past yaws keep their difference to the present one, and its uncertainty
        self._transform(T)
        self.x = x
        self.P[np.ix_(YAWS, YAWS)] += variance

    def gyro(self, yaw_rate: float, variance: float | None, *, scale_told: bool = True) -> Measurement:
        """What a gyro sample (rad/s, variance (rad/s)^2) says: (1 + gyro scale) rate + bias.

        A sample does not tell its own scale, which is only considered: it is a factor of the rate, which the sample
        does tell, and linearised the noise of the one would draw the other down. What tells it is a compass, by the yaw
        that goes along with it. Without one (not `scale_told`) the scale is left out: the tracks, whose scale is not
        known either, would seem to tell it, linearised.
        """
        x = self.x
        rate, gain = float(x[State.RATE]), 1.0 + float(x[State.GYRO_SCALE])
        H = np.zeros((1, DIM))
        H[0, State.RATE], H[0, State.BIAS], H[0, State.GYRO_SCALE] = gain, 1.0, rate if scale_told else 0.0
        R = self.config.gyro_sigma**2 if variance is None else variance
        return Measurement(yaw_rate - gain * rate - float(x[State.BIAS]), H, R, consider=(State.GYRO_SCALE,))

    def cross_rate_at_rest(self, rate: float) -> Measurement:
        """What a gyro's rate (rad/s) about the y axis of a robot that stands says: its bias."""
        H = np.zeros((1, DIM))
        H[0, State.CROSS_BIAS] = 1.0
        return Measurement(rate - float(self.x[State.CROSS_BIAS]), H, self.config.gyro_sigma**2)

    def tracks(self, turn: float, noise: float, *, modulo_turn: bool, alone: bool) -> Measurement:
        """What the turn (rad) claimed since the tracks' reference says: scale times the true turn, plus their error.

        `noise` is the variance of its white noise, rad^2; a pose counts no turns (`modulo_turn`). `alone` says that
        nothing else measures the turning. The scale cannot be observed then (linearised, the tracks would seem to tell
        it all the same), so it is only considered.

        The second-order terms of scale times turn are kept (Bar-Shalom, Li & Kirubarajan 2001, section 10.3.2), but
        not when the tracks are alone: then the two err together so that their product is right. From sample to sample
        the turn changes by more than its noise, so the scale's error goes into the rate by the *new* turn: `H_after`.
        """
        M = np.zeros(DIM)
        M[State.YAW], M[State.TRACK_REF] = 1.0, -1.0
        PM = self.P @ M
        true_turn, scale = float(M @ self.x), float(self.x[State.SCALE])
        H = scale * M
        H[State.TRACK_ERROR] = 1.0
        innovation = turn - float(H @ self.x)
        if modulo_turn:
            innovation = float(wrap_angle(innovation))
        H[State.SCALE] = true_turn
        R = noise
        if not alone:
            cross = float(PM[State.SCALE])
            innovation -= cross
            R += float(self.P[State.SCALE, State.SCALE]) * max(float(M @ PM), 0.0) + cross**2
        PH = self.P @ H
        H_after = H.copy()
        H_after[State.SCALE] += float(M @ PH) / (float(H @ PH) + R) * innovation
        consider = (State.SCALE, State.GYRO_SCALE) if alone else (State.GYRO_SCALE,)
        return Measurement(innovation, H[None, :], R, H_after[None, :], consider)

    def stand_still(self, seconds: float) -> None:
        """Take in that the robot has stood for so long, since STILL_REF, but for a creep too slow to be found."""
        # it tells nothing of scale factors, though linearised their errors go along with that of the rate
        consider = (State.SCALE, State.GYRO_SCALE)
        H = np.zeros((1, DIM))
        H[0, State.RATE] = 1.0
        self.correct(Measurement(-float(self.x[State.RATE]), H, CREEP_RATE**2, consider=consider))
        H = np.zeros((1, DIM))
        H[0, State.YAW], H[0, State.STILL_REF], H[0, State.RATE] = 1.0, -1.0, -seconds  # all the while at that rate
        self.correct(Measurement(-float((H @ self.x)[0]), H, STILL_TURN**2, consider=consider))

    def widen(self, index: int, variance: float) -> None:
        """Add to the variance of state `index`, as far as more than that means anything."""
        self.P = self.P.copy()
        self.P[index, index] += min(variance, (LOST if YAWS[index] else FASTEST) ** 2)

    def widen_frame(self, variance: float) -> None:
        """Add to the variance of all yaws alike: by so much the whole past may be turned."""
        self.P = self.P.copy()
        self.P[np.ix_(YAWS, YAWS)] += variance

    def compass(self, yaw: float, variance: float, since: int, until: int, *, far: bool = False) -> Measurement:
        """What an increment (rad, variance rad^2) between the clones `since` and `until` says, modulo a turn.

        Part of its error lasts from image to image and beyond the reference (parallax keeps its sign while the robot
        passes the same things): a Gauss-Markov state of `compass_error`, or `LASTING` of the variance if that is less;
        of an increment from some seconds ago another one, of `LASTING` of the variance.
        """
        error = State.FAR_ERROR if far else State.COMPASS_ERROR
        lasting = LASTING * variance if far else min(self.config.compass_error**2, LASTING * variance)
        H = np.zeros((1, DIM))
        H[0, until], H[0, since] = 1.0, -1.0
        H[0, error] = math.sqrt(lasting)
        innovation = float(wrap_angle(yaw - float((H @ self.x)[0])))
        return Measurement(innovation, H, variance - lasting)

    def innovation_variance(self, measurement: Measurement) -> float:
        """Variance S that the innovation should have."""
        H = measurement.H
        return max(float((H @ self.P @ H.T)[0, 0]), 0.0) + measurement.R + rounding(H, self.P)

    def correct(self, measurement: Measurement) -> None:
        """Update with a measurement made from the present state."""
        prior_x, prior_P = self.x, self.P
        R = measurement.R + rounding(measurement.H, prior_P)
        innovation = np.array([measurement.innovation])
        self.update(  # type: ignore[no-untyped-call]
            innovation,
            HJacobian=lambda x: measurement.H,
            Hx=lambda x: None,
            R=R,
            residual=lambda z, expected: innovation,  # expected value taken off, and wrapped, already
        )
        H = measurement.H if measurement.H_after is None else measurement.H_after
        optimal = self.K.copy()
        if measurement.consider or measurement.H_after is not None:
            self.K[list(measurement.consider)] = 0.0
            A = np.eye(DIM) - self.K @ H
            self.x = prior_x + self.K[:, 0] * measurement.innovation
            self.P = A @ prior_P @ A.T + R * (self.K @ self.K.T)  # Joseph: holds for any gain
        self.P = blurred(self.P, np.diagonal(prior_P))
        if not np.diagonal(self.P).min() >= 0.0:
            self.x, self.P = prior_x, loosened(prior_P)
            return
        if self.tape is not None:
            self.tape.append(Correction(measurement.innovation, measurement.H, H, float(self.S[0, 0]), optimal))
