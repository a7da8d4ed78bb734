"""The gyro: its model, its gate, and what a robot or a bias that has jumped leaves of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from compass.tilt import beyond_error
from fusion.buffer.events import GyroEvent, Sensor
from fusion.checks.gate import Gate, Verdict
from fusion.checks.rate_turn import FASTEST_CHANGE, FASTEST_ROBOT, SAME
from fusion.checks.silence import RATE_SILENT_NS
from fusion.config import FusionConfig
from fusion.imu.tilt import TILT_ERROR, BiasGain
from fusion.record import replace
from fusion.samples import GyroSample
from fusion.state.bounds import LONGEST_STEP
from fusion.state.ekf import DIM, IDENTITY, TURNING, Measurement, State, YawEkf
from fusion.state.process_models import turning
from fusion.updates.gating import Gating
from fusion.updates.gyro_scale import tie_to_scale

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState

WATCHED_NS = 50_000_000  # between two samples: a slower gyro does not see how the robot starts to turn
PITCH_SIGMAS = 10.0  # of a gyro that nobody has calibrated: more is no bias, but a pitch; not derived
VAGUE_FACTOR = 100.0  # times the noise of a gyro sample; from one of that a turn of 1 rad/s would not stand out
YAW_AND_RATE = np.s_[: State.RATE + 1, : State.RATE + 1]
# Times the variance of a sample: three deviations, as its noise is more once in 370 times; not derived.
SURELY_TURNING = 9.0


class GyroUpdate:
    """Takes gyro samples into a state.

    Parameters
    ----------
    config : FusionConfig
        Of all models.
    gating : Gating
        The gates of all sensors.
    """

    def __init__(self, config: FusionConfig, gating: Gating) -> None:
        self._config = config
        self._gating = gating

    def fuse(self, state: FilterState, event: GyroEvent) -> None:
        """Take in a gyro sample, or find that the robot or the bias has made a jump."""
        sample, refused = event.sample, state.gates[Sensor.GYRO]
        if refused.report is None or event.t_ns - refused.report.t_ns > RATE_SILENT_NS:
            state.gyro_since_ns = event.t_ns
        up = beyond_error(sample.up, TILT_ERROR) if sample.up else None
        if up and state.trail.points:
            seconds = min(event.t_ns - state.trail.points[-1].t_ns, RATE_SILENT_NS) * 1e-9
            state.tilted_turn = state.tilted_turn.after(up, float(state.x[State.RATE]) * seconds)
        if sample.factor_sigma != state.gyro_factor_sigma:
            self._allow_factor(state, sample.factor_sigma)
        if up and (gain := BiasGain.tilted(up)).differs(state.bias_gain):
            turn_bias(state.ekf, state.bias_gain, gain)
            state.bias_gain = gain
        if state.stillness.standing and sample.cross_rate is not None:
            cross, noise = cross_rate_at_rest(state.ekf, sample.cross_rate), self._config.initial_bias_sigma
            if abs(cross.innovation) <= PITCH_SIGMAS * math.hypot(noise, self._config.gyro_sigma):
                state.ekf.correct(cross)
        vague = self.is_vague(sample)
        if vague and sample.variance is not None and not state.gyro_vague:
            state.ekf.widen(State.RATE, sample.variance)  # it may be beyond what was said so far
        state.gyro_vague = vague
        if vague:
            if state.turns.gyro is not None:  # nor did those before it that were at the end stop already
                state.turns = replace(state.turns, gyro=None)
            return
        noise = self._config.gyro_sigma * math.sqrt(state.gyro_noise.factor.variance)
        state.common_source = state.common_source.with_gyro(event.t_ns, sample.yaw_rate, noise)
        if state.gyro_noise.repeats(sample.yaw_rate, self._config.gyro_sigma):
            self._learn_noise(state, sample)
            return
        if self._hangs(state, sample):
            self._learn_noise(state, sample)
            self._gating.refuse(state, Sensor.GYRO, gyro_measurement(state.ekf, sample.yaw_rate, None))
            return
        state.turns = state.turns.with_gyro(sample)
        variance = self.sigma(state, sample) ** 2
        if sample.variance is None:
            variance += state.gyro_noise.variance(sample.yaw_rate, self._config.gyro_sigma)
            # drivers say zero for a gyro at rest, whatever its bias; one that hangs in motion fault isolation finds
            rests = state.stillness.standing or abs(sample.yaw_rate) <= SAME
            if rests and state.gyro_noise.hangs(sample.yaw_rate, self._config.gyro_sigma):
                variance += self._config.initial_rate_sigma**2
        if abs(sample.yaw_rate) > FASTEST_ROBOT:
            return
        measurement = gyro_measurement(
            state.ekf, sample.yaw_rate, variance, scale_observable=state.hears(Sensor.COMPASS)
        )
        expected = state.ekf.expect(measurement)
        prior = expected.S - measurement.R
        since_ns = None if state.isolation.excludes(Sensor.GYRO) else unmeasured_since(state, event.t_ns)
        if since_ns is not None and measurement.innovation**2 > self._gating.limit * expected.S:
            allow_start(state.ekf, (event.t_ns - since_ns) * 1e-9)
            expected = state.ekf.expect(measurement)
        unwatched = since_ns is not None and WATCHED_NS < event.t_ns - since_ns <= RATE_SILENT_NS
        if since_ns is not None and unwatched and not state.stillness.standing:
            allow_change(state.ekf, measurement.innovation**2 - expected.S, (event.t_ns - since_ns) * 1e-9)
            expected = state.ekf.expect(measurement)
        verdict = self._gating.judge(state, Sensor.GYRO, measurement, expected)
        if not state.stillness.standing and verdict is Verdict.ACCEPTED:
            walked = math.sqrt(max(prior, 0.0) / state.ekf.rate_walk_scale)
            state.rate_walk_scale = state.rate_walk_scale.after(measurement.innovation, measurement.R, walked)
        if verdict is not Verdict.REJECTED:
            state.trail = state.trail.add(sample.t_ns, sample.yaw_rate, up)
            self._learn_noise(state, sample)
        elif not state.isolation.excludes(Sensor.GYRO):
            state.trail = state.trail.refusing(sample.t_ns, sample.yaw_rate, up)
        self._recover(state, event, measurement, verdict, refused)

    def _allow_factor(self, state: FilterState, factor_sigma: float) -> None:
        """Take in that nobody knows any more how the gyro lies, or that somebody does now: its scale is another."""
        ekf, before = state.ekf, state.gyro_factor_sigma
        if factor_sigma < before:
            tie_to_scale(state)
        state.gyro_factor_sigma = factor_sigma
        if factor_sigma < before:
            ekf.renew(State.GYRO_SCALE, state.gyro_scale_sigma**2)
        else:
            ekf.widen(State.GYRO_SCALE, factor_sigma**2 - before**2)

    def _hangs(self, state: FilterState, sample: GyroSample) -> bool:
        """Whether a gyro seems to hang: then it counts as one that is silent, or two that hang would be a majority."""
        noise = state.gyro_noise
        hangs = noise.hangs_at(sample.yaw_rate, float(state.x[State.BIAS]), self._config.gyro_sigma)
        if not hangs or state.stillness.standing:
            state.hung_since_ns = state.hung_tracks = None
            return False
        if noise.run == 1:
            return True  # by chance one in some thousands is as the one before: it is left out, and no more
        if state.turns.gyro is not None:
            jump, since_ns = sample.yaw_rate - noise.before, max(noise.begun_ns, state.rested_ns or 0)
            state.turns = replace(state.turns, gyro=None)
            state.hung_tracks = state.tracks.last if state.tracks else None
            state.ekf.widen(State.RATE, jump**2)
            state.ekf.widen(State.YAW, (jump * (sample.t_ns - since_ns) * 1e-9) ** 2)
        if state.hung_since_ns is None and noise.hung:
            state.hung_since_ns = sample.t_ns
            state.ekf.renew(State.RATE, self._config.initial_rate_sigma**2)
        return True

    def _learn_noise(self, state: FilterState, sample: GyroSample) -> None:
        """Learn the noise from a sample that does not tell it."""
        if sample.variance is None:
            config = self._config
            # what this noise makes of the turn rate is no walk: beyond what is configured that does not count
            walk = config.watched_rate_walk * math.sqrt(min(state.ekf.rate_walk_scale, 1.0))
            state.gyro_noise = state.gyro_noise.after(
                sample.t_ns, sample.yaw_rate, float(state.x[State.BIAS]), config.gyro_sigma, walk, config.rate_ramp
            )

    def _recover(
        self, state: FilterState, event: GyroEvent, measurement: Measurement, verdict: Verdict, refused: Gate
    ) -> None:
        """After a refusal: the bias has jumped, or the robot turns harder than was to be expected."""
        if verdict is Verdict.RECOVERED:
            # the bias has jumped: open it until the gate is met
            excess = measurement.innovation**2 / self._gating.limit - state.ekf.expect(measurement).S
            state.ekf.widen(State.BIAS, excess)
            state.agreement = None
            state.ekf.correct(measurement)
        elif (
            verdict is Verdict.REJECTED
            and refused.refused_like(measurement.innovation)
            and not state.isolation.excludes(Sensor.GYRO)
        ):
            # twice on the same side: the robot turns so since the last sample accepted
            since_ns = unmeasured_since(state, event.t_ns)
            seconds = (event.t_ns - (since_ns or event.t_ns)) * 1e-9
            if seconds > 0.0:
                change = min(abs(measurement.innovation) / seconds, FASTEST_CHANGE)  # stamps may be next to each other
                state.ekf.widen(State.ACCELERATION, change**2)
            state.ekf.widen(State.RATE, measurement.innovation**2)
            state.ekf.widen(State.YAW, (measurement.innovation * seconds) ** 2)

    def is_vague(self, sample: GyroSample) -> bool:
        """Whether a sample says next to nothing by its own variance."""
        return sample.variance is not None and sample.variance > (VAGUE_FACTOR * self._config.gyro_sigma) ** 2

    def sigma(self, state: FilterState, sample: GyroSample) -> float:
        """Standard deviation of a sample's noise, rad/s; at rest, where nothing shakes the gyro, as it is seen."""
        if sample.variance is not None:
            return math.sqrt(sample.variance)
        return state.stillness.gyro_noise(self._config.gyro_sigma * math.sqrt(state.gyro_noise.factor.variance))


def unmeasured_since(state: FilterState, t_ns: int) -> int | None:
    """Since when the turn rate may have changed unseen by a gyro that speaks at `t_ns`; None before its first sample.

    Of one that was silent, or excluded, for long the others have measured the turn meanwhile.
    """
    since_ns = state.gates[Sensor.GYRO].accepted_ns
    if since_ns is None or t_ns - since_ns <= RATE_SILENT_NS:
        return since_ns
    return max(gate.accepted_ns or since_ns for gate in state.gates.values())


def gyro_measurement(
    ekf: YawEkf, yaw_rate: float, variance: float | None, *, scale_observable: bool = True
) -> Measurement:
    """The measurement of a gyro sample (rad/s, variance (rad/s)^2): (1 + gyro scale) rate + bias.

    A sample does not observe its own scale, which is only considered: it is a factor of the rate, which the sample
    does observe, and linearised the noise of the one would draw the other down. A compass makes the scale observable,
    by the yaw that is correlated with it. Without one (not `scale_observable`) the scale is left out: the tracks, whose
    scale is not known either, would seem to observe it, linearised. Of the rate counts what is more than a sample's
    noise makes of it: its square would be learnt for a scale while the robot stands or drives straight.
    """
    x = ekf.x
    rate, gain = float(x[State.RATE]), 1.0 + float(x[State.GYRO_SCALE])
    R = ekf.config.gyro_sigma**2 if variance is None else variance
    turning = rate - SURELY_TURNING * R / rate if scale_observable and rate**2 > SURELY_TURNING * R else 0.0
    H = np.zeros((1, DIM))
    H[0, State.RATE], H[0, State.BIAS], H[0, State.GYRO_SCALE] = gain, 1.0, turning
    return Measurement(yaw_rate - gain * rate - float(x[State.BIAS]), H, R, consider=(State.GYRO_SCALE,))


def cross_rate_at_rest(ekf: YawEkf, rate: float) -> Measurement:
    """What a gyro's rate (rad/s) about the y axis of a robot that stands says: its bias."""
    H = np.zeros((1, DIM))
    H[0, State.CROSS_BIAS] = 1.0
    return Measurement(rate - float(ekf.x[State.CROSS_BIAS]), H, ekf.config.gyro_sigma**2)


def turn_bias(ekf: YawEkf, before: BiasGain, now: BiasGain) -> None:
    """Turn the bias with the robot, from the tilt `before` to the one `now`."""
    T = IDENTITY.copy()
    T[State.BIAS, State.BIAS] = now.own / before.own
    T[State.BIAS, State.CROSS_BIAS] = now.cross - before.cross * now.own / before.own
    ekf.transform(T)


def allow_start(ekf: YawEkf, seconds: float) -> None:
    """Let the turn rate have changed for `seconds` as it may by the configuration, if it was learnt to be calmer.

    A robot that drove straight for long turns all the same.
    """
    missing = ekf.config.watched_rate_walk**2 * (1.0 - ekf.rate_walk_scale)
    if missing > 0.0:
        ekf.P = ekf.P.copy()
        ekf.P[TURNING] += missing * turning(ekf.config.rate_ramp, min(seconds, LONGEST_STEP))[1]


def allow_change(ekf: YawEkf, variance: float, seconds: float) -> None:
    """Let the turn rate have changed once, at any time in the last `seconds`, by a `variance`, (rad/s)^2.

    What an innovation has beyond its own variance is the likeliest one. A sample then leaves the yaw of the
    trapezoidal rule, uncertain by the change times the seconds over the root of twelve.
    """
    if variance > 0.0:
        ekf.P = ekf.P.copy()
        ekf.P[YAW_AND_RATE] += variance * np.array([[seconds**2 / 3.0, seconds / 2.0], [seconds / 2.0, 1.0]])
