"""What keeps variances finite and positive, whatever the settings and however long nobody measures."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
LONGEST_STEP = 3600.0  # s; after a longer silence nothing is less known than after this: scale, bias and delay walk
# rad, 16 turns: a yaw less well known is not known; its square leaves 12 digits to differences of yaws
LOST_YAW = 100.0
ROUNDING = 1e-12  # of a state's variance, lost to rounding at most when two that nearly cancel are subtracted
_HALF = np.array(0.5)  # numpy multiplies with an array in half the time of a number
LOOSE = 1e-9  # of a state's variance, by which states are made a little less alike that rounding can't tell apart


def symmetric(P: Array) -> Array:
    """A covariance without what rounding has made unsymmetric."""
    half: Array = P.T.copy()  # numpy adds a transposed array at a third of the speed
    half += P
    half *= _HALF
    return half


def limit_turn(F: Array, Q: Array, P: Array, yaw: int) -> None:
    """Limit to `LOST_YAW` what a step of transition F and process noise Q, from covariance P, adds to the yaw's sigma.

    The yaw's change, noise and all, is scaled down: what is left is the covariance of a robot that turned by less.
    """
    change = F[yaw].copy()
    change[yaw] = 0.0
    variance = float(change.dot(P).dot(change)) + float(Q[yaw, yaw])
    if variance > LOST_YAW**2:
        share = LOST_YAW / math.sqrt(variance)
        F[yaw] = share * change
        F[yaw, yaw] = 1.0
        Q[yaw] *= share
        Q[:, yaw] *= share


def forget_beyond(P: Array, yaw: int, yaws: npt.NDArray[np.bool_]) -> Array:
    """Transformation of the errors that limits the yaw's sigma to `LOST_YAW`; the unit matrix where it is below.

    Past yaws keep their difference to the present one, and its uncertainty.
    """
    T = np.eye(len(P))
    T[yaws, yaw] -= 1.0 - min(LOST_YAW / math.sqrt(float(P[yaw, yaw])), 1.0)
    return T


def rounding(H: Array, P: Array) -> float:
    """Variance by which rounding blurs a measurement of Jacobian H, shape (n,): it may see a small difference."""
    return ROUNDING * float((H * H).dot(P.diagonal()))


def blurred(P: Array, by: Array) -> Array:
    """A covariance with what rounding may have lost of the variances `by`, which went into it; symmetric."""
    P = symmetric(P)
    P.reshape(-1)[:: len(P) + 1] += ROUNDING * by  # the diagonal
    return P


def loosened(P: Array) -> Array:
    """A covariance, positive but for rounding, made so; for when a measurement would leave a variance below zero.

    That takes yaws that are all but the same beside a sigma of many turns: one in a million of the events of filters
    with random settings. Such a measurement is left out.
    """
    return blurred(P, LOOSE / ROUNDING * np.diagonal(P))
