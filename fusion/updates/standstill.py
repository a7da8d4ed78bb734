"""The zero-velocity update: pins the turn rate of a robot that is found to stand, and opens it when it starts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from fusion.buffer.events import CompassEvent, FusionEvent, GyroEvent, Sensor, TracksEvent
from fusion.checks.stillness import MOTION_SIGMAS, RESOLUTION
from fusion.config import FusionConfig
from fusion.state.ekf import DIM, Measurement, State, YawEkf

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState
    from fusion.updates.gyro import GyroUpdate


STILL_TURN = 1e-5  # rad, what standing still leaves of a turn


class StandstillUpdate:
    """Zero-velocity update: watches for motion, and pins the turn rate once the robot is found to stand.

    Parameters
    ----------
    config : FusionConfig
        Of all models.
    gyro : GyroUpdate
        It knows the noise of a gyro sample.
    """

    def __init__(self, config: FusionConfig, gyro: GyroUpdate) -> None:
        self._config = config
        self._gyro = gyro

    def watch(self, state: FilterState, event: FusionEvent) -> bool:
        """Note what an event says of standing; whether it is the first sign of motion.

        Tracks show a start at once. Without them it may have hidden in the gyro's noise for a while, and what the robot
        turned meanwhile went into the bias and is missing in the yaw.
        """
        stillness = state.stillness
        if isinstance(event, GyroEvent) and self._gyro.is_vague(event.sample):
            stillness = stillness.moved(event.t_ns)
        elif isinstance(event, GyroEvent):
            stillness = stillness.with_gyro(event.t_ns, event.sample.yaw_rate, self._gyro.sigma(state, event.sample))
        elif isinstance(event, TracksEvent) and not state.isolation.one_source:
            stillness = stillness.with_tracks(event.sample)
        elif isinstance(event, CompassEvent) and not event.sample.long_baseline:
            stillness = stillness.with_increment(event.sample)
        if state.stillness.standing and not stillness.standing and not state.hears(Sensor.TRACKS):
            bias, turn = state.stillness.hidden_start()
            state.ekf.widen(State.BIAS, bias**2)
            state.ekf.widen(State.YAW, turn**2)
        started = state.stillness.standing and not stillness.standing
        state.stillness = stillness
        return started

    def start(self, state: FilterState, event: FusionEvent, seconds: float) -> None:
        """Open the turn rate of a robot that has begun to move within the last `seconds`."""
        sigma = seen = self._config.initial_rate_sigma
        if isinstance(event, GyroEvent):
            seen = event.sample.yaw_rate - float(state.ekf.x[State.BIAS])
        open_rate(state.ekf, sigma, seconds, seen)

    def settle(self, state: FilterState) -> None:
        """Pin the turn rate once the robot is found to stand."""
        bias, variance = float(state.ekf.x[State.BIAS]), float(state.ekf.P[State.BIAS, State.BIAS])
        sigma = math.sqrt(variance)
        if state.stillness.since_ns == 0:
            sigma = max(sigma, self._config.initial_bias_sigma)
        stillness = state.stillness.judged(state.t_ns or 0, bias, sigma)
        if stillness.reference_ns is not None and state.stillness.reference_ns is None:
            state.ekf.clone_yaw(State.STILL_REF)
        if stillness.standing and not state.stillness.standing:
            stand_still(state.ekf, ((state.t_ns or 0) - (stillness.reference_ns or 0)) * 1e-9)
        if stillness.standing:
            state.rested_ns = state.t_ns
        state.stillness = stillness


def open_rate(ekf: YawEkf, sigma: float, within: float, seen: float) -> None:
    """Let the turn rate have changed at once, by `sigma` (rad/s) or so, at some time in the last `within` seconds.

    What was turned since goes with it. `seen` is by how much it seems to have changed: so much of the turn is
    uncertain as the time is.
    """
    ekf.P = ekf.P.copy()
    ekf.P[np.ix_([State.YAW, State.RATE], [State.YAW, State.RATE])] += sigma**2 * np.array(
        [[within**2 / 4.0, within / 2.0], [within / 2.0, 1.0]]
    )
    ekf.P[State.YAW, State.YAW] += (seen * within) ** 2 / 12.0


def stand_still(ekf: YawEkf, seconds: float) -> None:
    """Take in that the robot has stood for so long, since STILL_REF, but for a creep too slow to be found.

    Where the yaw was corrected meanwhile for a turn that nobody knows the time of, STILL_REF may be from before it.
    """
    # it does not observe scale factors, though linearised their errors go along with that of the rate
    consider = (State.SCALE, State.GYRO_SCALE)
    H = np.zeros((1, DIM))
    H[0, State.RATE] = 1.0
    ekf.correct(Measurement(-float(ekf.x[State.RATE]), H, RESOLUTION**2, consider=consider))
    H = np.zeros((1, DIM))
    H[0, State.YAW], H[0, State.STILL_REF], H[0, State.RATE] = 1.0, -1.0, -seconds  # all the while at that rate
    measurement = Measurement(-float((H @ ekf.x)[0]), H, STILL_TURN**2, consider=consider)
    if measurement.innovation**2 > MOTION_SIGMAS**2 * ekf.expect(measurement).S:
        ekf.clone_yaw(State.STILL_REF)
    else:
        ekf.correct(measurement)
