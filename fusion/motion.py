"""How what is not known moves on: quantities that fade and their integrals, in closed form over any time."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)  # exact to the last digit over one ramp


def integrate_gauss_markov(
    F: Array, Q: Array, state: int, integral: int, time: float, sigma: float, gain: float, dt: float
) -> None:
    """Enter a Gauss-Markov `state` of correlation `time` and `sigma`, and `gain` times its integral."""
    e = math.exp(-dt / time)
    F[state, state] = e
    F[integral, state] = gain * time * (1.0 - e)
    Q[state, state] = sigma**2 * (1.0 - e**2)
    Q[integral, state] = Q[state, integral] = gain * sigma**2 * time * (1.0 - e) ** 2
    Q[integral, integral] = (gain * sigma * time) ** 2 * (2.0 * dt / time - 3.0 + 4.0 * e - e**2)


@lru_cache(maxsize=64)  # sensors keep to their steps, but for a few nanoseconds
def turning(q: float, ramp: float, dt: float) -> tuple[Array, Array]:
    """Transition and process noise of (yaw, rate, acceleration) over `dt` seconds.

    Singer's model of a manoeuvre (1970, doi:10.1109/TAES.1970.310128): the acceleration is Gauss-Markov over `ramp`
    seconds. Over times longer than that the rate walks, by `q` (rad/s)^2 a second. The arrays are kept: copy them
    before you change them.
    """
    if dt > ramp:
        F, Q = turning(q, ramp, dt / 2.0)
        return F @ F, F @ Q @ F.T + Q
    F = np.eye(3)
    F[0, 1] = dt
    F[:, 2:] = _answer(ramp, np.array([dt]))
    answers = _answer(ramp, dt / 2.0 * (1.0 + _NODES))
    return F, q / ramp**2 * dt / 2.0 * (answers * _WEIGHTS) @ answers.T


def _answer(ramp: float, s: Array) -> Array:
    """What an acceleration of 1 rad/s^2 that fades over `ramp` has made of yaw, rate and itself after times `s`."""
    x = s / ramp
    fading = -np.expm1(-x)
    return np.stack([ramp**2 * (x - fading), ramp * fading, 1.0 - fading])
