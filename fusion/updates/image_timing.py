"""When an image was exposed: not quite at its stamp, and what the gyro says of the turn in between."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fusion.buffer.events import Sensor
from fusion.state.ekf import IDENTITY, State, YawEkf
from fusion.state.gyro_trail import Exposure, GyroTrail

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState

# In the mean of ten images white noise is more than twice its variance less than once in a hundred times. Over thirty
# images, or with thrice, a delay is found too late (docs/lab-notes/doubts-and-late-gyros-2026-11-30.md).
TURNING_IMAGES, NOISES = 10, 2.0


def exposure_of(state: FilterState) -> Exposure:
    """What happened between the exposure of an image stamped at present, and now: nothing where the robot stands."""
    if state.stillness.standing:
        return Exposure(float(state.x[State.CAMERA_DELAY]))
    trail = state.trail if state.trail.points and state.hears(Sensor.GYRO) else None
    gate = state.gates[Sensor.GYRO]
    refused = gate.report.innovation if gate.report and gate.rejecting_since_ns is not None else 0.0
    return exposure(state.ekf, state.t_ns or 0, trail, state.gyro_noise.factor.variance, refused)


def exposure(ekf: YawEkf, t_ns: int, trail: GyroTrail | None, noise: float = 1.0, refused: float = 0.0) -> Exposure:
    """What happened between the exposure of an image stamped `t_ns`, the present, and that stamp.

    The variance of the gyro's samples is `noise` times what is configured. The last one is refused if it is off by
    `refused`, rad/s.

    Without a gyro's `trail` the delay is taken for known: it is not observable, and as an unknown it would let the
    tracks draw the yaw about.
    """
    delay, variance = float(ekf.x[State.CAMERA_DELAY]), float(ekf.P[State.CAMERA_DELAY, State.CAMERA_DELAY])
    if trail is None:
        return Exposure(delay, float(ekf.x[State.RATE]) * delay)
    claimed = trail.exposure(t_ns, delay, variance, noise * ekf.config.gyro_sigma**2)
    bias, gain = float(ekf.x[State.BIAS]), 1.0 + float(ekf.x[State.GYRO_SCALE])
    turn, rate = (claimed.turn - bias * delay) / gain, (claimed.rate - bias) / gain
    unseen = ekf.config.watched_rate_walk**2 * max(-delay, 0.0) ** 3 / 3.0  # exposed after the last sample
    last = trail.points[-1]
    # after the last sample its rate is held, and the filter may know of another from the images, or from a refused one
    beyond = float(ekf.x[State.RATE]) - (last.rate - bias) / gain
    since_squared = min(max(delay, 0.0) ** 2 + variance, ((t_ns - last.t_ns) * 1e-9) ** 2)
    unseen += (beyond**2 + refused**2 + float(ekf.P[State.RATE, State.RATE])) * since_squared
    rate_variance = claimed.rate_variance / gain**2
    return Exposure(delay, turn, rate, claimed.variance + unseen, watched=True, rate_variance=rate_variance)


def mean_turning(before: float, exposure: Exposure) -> float:
    """Mean square of the turn rate at the last images, in variances of its noise, after one more exposure."""
    turning = exposure.rate**2 / exposure.rate_variance if exposure.rate_variance > 0.0 else 0.0
    return before + (turning - before) / TURNING_IMAGES


def told_of_delay(turning: float) -> float:
    """Share of a measured turn rate that tells of the delay, of the mean square `turning` as `mean_turning` has it.

    Where a robot drives straight, a gyro's noise would be taken for a turn rate, and images that show none of it would
    say that there is no delay, a little each. Shrunk as by James & Stein (1961, "Estimation with quadratic
    loss"), with twice the noise as margin.
    """
    return max(1.0 - NOISES / turning, 0.0) if turning > 0.0 else 0.0


def clone_exposure(ekf: YawEkf, into: int, exposure: Exposure, told: float = 1.0) -> None:
    """Copy the yaw that an image of the present stamp shows: that of its exposure, with its timestamp jitter.

    The share `told` of the turn rate is taken to be one; what the rest makes of an error of the delay is less than the
    variance that the exposure has for the gyro's noise.
    """
    T = IDENTITY.copy()
    T[into] = T[State.YAW]
    T[into, State.CAMERA_DELAY] = -told * exposure.rate
    if exposure.watched:
        gain = 1.0 + float(ekf.x[State.GYRO_SCALE])
        T[into, State.BIAS], T[into, State.GYRO_SCALE] = exposure.delay / gain, exposure.turn / gain
    else:
        T[into, State.RATE] = -exposure.delay
    exposed = float(ekf.x[State.YAW]) - exposure.turn
    rate_squared = float(ekf.x[State.RATE]) ** 2 + float(ekf.P[State.RATE, State.RATE])
    ekf.transform(T)
    ekf.x[into] = exposed
    ekf.widen(into, ekf.jitter * rate_squared + exposure.variance)
