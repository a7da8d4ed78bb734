"""What a state says of the yaw, and all that widens its variance beyond the filter's own."""

from __future__ import annotations

import numpy as np

from fusion.buffer.events import Sensor
from fusion.checks.stillness import CREEP_RATE
from fusion.samples import YawEstimate
from fusion.state.ekf import State
from fusion.state.filter_state import FilterState, believed


def estimate_of(state: FilterState) -> YawEstimate | None:
    """What a state says; None before the first event."""
    if state.t_ns is None:
        return None
    standing, (x, P) = state.stillness.standing, believed(state)
    rate, seen = float(x[State.RATE]), np.zeros(len(x))
    seen[State.YAW] = 1.0
    if state.hears(Sensor.COMPASS) and not state.hears(Sensor.GYRO):
        seen[State.CAMERA_DELAY] = rate  # taken for known, as nobody else says when the robot turned
    return YawEstimate(
        t_ns=state.t_ns,
        yaw=float(x[State.YAW]) + state.yaw_lead,
        yaw_variance=float(seen @ P @ seen)
        + state.yaw_lead**2
        + state.scale_variance
        + state.scale_conflict.variance(float(x[State.YAW]))
        + (state.early_images.variance(rate) if state.hears(Sensor.GYRO) else 0.0)
        + state.tilted_turn.variance
        + state.isolation.variance(state.t_ns)
        + state.unconfirmed_variance(x)
        + state.unwatched.variance
        + state.turn_count.variance
        + state.image_excess,
        turn_count_variance=state.turn_count.variance,
        yaw_rate=rate,
        yaw_rate_variance=float(P[State.RATE, State.RATE]) + (CREEP_RATE**2 if standing else 0.0),
        gyro_bias=float(x[State.BIAS]),
        gyro_bias_variance=float(P[State.BIAS, State.BIAS]),
        track_scale=float(x[State.SCALE]),
        track_scale_variance=float(P[State.SCALE, State.SCALE]),
        camera_delay=float(x[State.CAMERA_DELAY]),
        camera_delay_variance=float(P[State.CAMERA_DELAY, State.CAMERA_DELAY]),
        standstill=standing,
        slip=state.gates[Sensor.TRACKS].rejecting_since_ns is not None,
        warnings=state.all_warnings,
    )
