"""Motions of a camera on the ground between two views, each drawn by two corners that both show: RANSAC.

Fischler & Bolles 1981, doi:10.1145/358669.358692. What a corner says for a motion is measured in its tangent plane, as
`compass.features.solver` does, which refines the likeliest.
"""

from __future__ import annotations

import math

import numpy as np

from compass.features.bearings import Tangents
from compass.features.motion import DIRECTIONS
from compass.features.prior import TILT_SIGMA
from compass.features.solver import State
from compass.flow.correlation import Floats

# Pairs of corners; each gives two turns, and either travel ahead or back. Where a fifth are inliers, a pair of inliers
# is among them with a probability of 0.998.
DRAWS = 150


def likely_states(tangents: Tangents, seen: Floats, besides: float | None = None) -> Floats:
    """(`DIRECTIONS`, 5) states, see `Problem`: level motions that most corners agree on, no two of about one turn.

    Parameters
    ----------
    tangents, seen : Tangents, (3, n) array
        Where n corners were seen before, and the directions in which they are seen after, outliers among them.
    besides : float, optional
        A turn, rad, whose basin of attraction shall be left out.
    """
    turn, travel = _drawn(tangents.ahead, seen)
    support = _support(turn, travel, tangents, seen)
    if besides is not None:
        support[:, np.cos(turn - besides) > np.cos(math.tau / DIRECTIONS)] = -1.0
    found = np.zeros((DIRECTIONS, 5))
    for state in found:
        back, at = np.unravel_index(support.argmax(), support.shape)
        state[State.YAW], state[State.DIRECTION] = turn[at], travel[at] + back * math.pi
        support[:, np.cos(turn - turn[at]) > np.cos(TILT_SIGMA)] = -1.0
    return found


def _drawn(seen: Floats, again: Floats) -> Floats:
    """(2, 2 * DRAWS) turns and travels ahead, each of two bearings: t is the line that their epipolar planes share."""
    i, j = np.random.default_rng(0).integers(seen.shape[1], size=(2, DRAWS))
    a, b = (np.arctan2(one[1], one[0]) for one in (seen, again))
    e, f = (one[2] / np.hypot(one[0], one[1]) for one in (seen, again))
    whole = f[i] * f[j] * np.sin(a[i] - a[j]) + e[i] * e[j] * np.sin(b[i] - b[j])
    cosine = f[i] * e[j] * np.sin(a[i] - b[j]) + e[i] * f[j] * np.sin(b[i] - a[j])
    sine = e[i] * f[j] * np.cos(b[i] - a[j]) - f[i] * e[j] * np.cos(a[i] - b[j])
    either = np.arccos(np.clip(whole / np.maximum(np.hypot(cosine, sine), 1e-12), -1.0, 1.0))
    turn = np.arctan2(sine, cosine) + np.stack([either, -either])
    y, x = (f[i] * of(a[i]) - e[i] * of(b[i] + turn) for of in (np.sin, np.cos))
    return np.stack([turn.ravel(), np.arctan2(y, x).ravel()])


def _support(turn: Floats, travel: Floats, tangents: Tangents, seen: Floats) -> Floats:
    """(2, n) how many corners agree on each of n motions, ahead and back.

    Each counts by how little it is off its half of the epipolar line.

    Roll and pitch are not estimated yet: what a level motion may be off is what the scene may be tilted.
    """
    (x, y, z), (by_x, by_y, by_z) = seen, tangents.axes.astype(np.complex64)
    (cosine, sine), (ahead, left) = (
        np.stack([np.cos(angle), np.sin(angle)]).astype(np.float32)[:, :, None] for angle in (turn, travel)
    )
    moved = cosine * (x * by_x + y * by_y) + sine * (x * by_y - y * by_x) + z * by_z
    line = ahead * by_x + left * by_y
    residual = moved * -line.conj() / np.maximum(np.abs(line), np.float32(1e-6))
    bx, by, bz = tangents.ahead
    behind = cosine * (x * bx + y * by) + sine * (x * by - y * bx) + z * bz < 0.0
    across = np.where(behind, 0.0, 1.0 - (residual.imag / TILT_SIGMA) ** 2)
    short = (np.stack([np.minimum(residual.real, 0.0), np.maximum(residual.real, 0.0)]) / TILT_SIGMA) ** 2
    support: Floats = np.maximum(across - short, 0.0).sum(axis=2)
    return support
