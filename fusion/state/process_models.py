"""How what is not known moves on: quantities that fade and their integrals, in closed form over any time."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_SIX = np.polynomial.legendre.leggauss(6)
# Gauss-Legendre over (0, 1), nodes and weights: exact to the last digit over one ramp
_RULE = tuple((0.5 + 0.5 * float(node), 0.5 * float(weight)) for node, weight in zip(*_SIX, strict=True))
_SERIES = 0.1  # below, the closed form loses more than four digits; the terms left out of the series are 1e-15 of it
_INTEGRATED = tuple((2.0**n - 4.0) / math.factorial(n) for n in range(14, 2, -1))
KNOWN_STEPS = 400  # of which the model is kept: those that an image late by a second replays; not derived


def integrate_gauss_markov(
    F: Array, Q: Array, state: int, integral: int, time: float, sigma: float, gain: float, dt: float
) -> None:
    """Enter a Gauss-Markov `state` of correlation `time` and `sigma`, and `gain` times its integral.

    In closed form what Van Loan 1978, doi:10.1109/TAC.1978.1101743, computes as a matrix exponential.
    """
    x = dt / time
    faded = -math.expm1(-x)
    F[state, state] = math.exp(-x)
    F[integral, state] = gain * time * faded
    Q[state, state] = -(sigma**2) * math.expm1(-2.0 * x)
    Q[integral, state] = Q[state, integral] = gain * sigma**2 * time * faded**2
    Q[integral, integral] = (gain * sigma * time) ** 2 * _integrated(x)


def _integrated(x: float) -> float:
    """2 x - 3 + 4 exp(-x) - exp(-2 x): the noise in the integral of a Gauss-Markov state, in units of its time.

    It grows from 2/3 x^3, of which the closed form leaves nothing but rounding (of either sign) for small x; there it
    is the power series, sum of (4 - 2^n) (-x)^n / n! from n = 3 on.
    """
    if x > _SERIES:
        return 2.0 * x - 3.0 + 4.0 * math.exp(-x) - math.exp(-2.0 * x)
    total = 0.0
    for coefficient in _INTEGRATED:
        total = coefficient - x * total
    return x**3 * total


@lru_cache(maxsize=KNOWN_STEPS)  # some sensors keep to their steps to the nanosecond, too
def turning(ramp: float, dt: float) -> tuple[Array, Array]:
    """Transition and process noise of (yaw, rate, acceleration) over `dt` seconds.

    Singer's model of a manoeuvre (1970, doi:10.1109/TAES.1970.310128): the acceleration is Gauss-Markov over `ramp`
    seconds. Over times longer than that the rate walks, here by 1 (rad/s)^2 a second: the noise is in proportion. The
    arrays are kept: copy them before you change them.
    """
    if dt > ramp:
        F, Q = turning(ramp, dt / 2.0)
        return F @ F, F @ Q @ F.T + Q
    # plain numbers: arrays of three cost three times as much
    yy = yr = ya = rr = ra = aa = 0.0
    for share, weight in _RULE:
        yaw, rate, acceleration = _answers(ramp, share * dt)
        of_yaw, of_rate = weight * yaw, weight * rate
        yy += of_yaw * yaw
        yr += of_yaw * rate
        ya += of_yaw * acceleration
        rr += of_rate * rate
        ra += of_rate * acceleration
        aa += weight * acceleration * acceleration
    yaw, rate, acceleration = _answers(ramp, dt)
    F = np.array([[1.0, dt, yaw], [0.0, 1.0, rate], [0.0, 0.0, acceleration]])
    return F, dt / ramp**2 * np.array([[yy, yr, ya], [yr, rr, ra], [ya, ra, aa]])


def _answers(ramp: float, seconds: float) -> tuple[float, float, float]:
    """Yaw, rate and acceleration after some time, of an acceleration of 1 rad/s^2 that fades over `ramp` seconds."""
    x = seconds / ramp
    faded = -math.expm1(-x)
    return ramp**2 * (x - faded), ramp * faded, 1.0 - faded
