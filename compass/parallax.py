"""Turn and parallax told apart by the sign of the parallax.

When the camera moves by a step t in direction phi, a point at azimuth a and distance d moves by ``-t sin(a - phi) / d``
beside the turn: nothing ahead and behind, one sign on the left, the other on the right, and never the wrong sign,
because distances are positive. Each sector's shift is therefore the turn, plus noise, plus a push of known sign and
unknown size. Which direction, and how large the pushes typically are, is unknown too: every combination of a grid is a
hypothesis, among them that of no push at all, and the turn's posterior is the sum over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from compass.correlation import Floats, Peak, signed
from compass.local import SectorShifts, coarse_shift, local_shifts
from compass.match import Match, Search
from compass.sectors import match_sectors
from compass.strip import Strip

NARROWEST = 256  # columns; sectors of fewer than eight cannot tell parallax apart
SECTORS = 64
PER_CIRCLE = 32.0  # Hann windows of 11 deg, half as far apart
DIRECTIONS = 64  # directions of travel that are tried: all near the best of every eighth
COARSE = 8
SCALES_PX = (0.1, 0.3, 1.0, 3.0, 10.0)  # typical pushes that are tried
PUSHES_PX = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # mean pushes that are tabulated, log-spaced after none
OUTLIER = -8.0  # log-likelihood of a sector that fits nothing: people, reflections, wrong peaks
INDEPENDENT = 0.5  # share of the sectors: each has half its columns in common with its neighbours
GRID = 25


@dataclass(frozen=True, slots=True)
class Posterior:
    """Turn in columns: mean and variance, and how probable it is that nothing but a turn happened."""

    mean_px: float
    variance_px2: float
    pure_turn: float


def match_parallax(reference: Strip, current: Strip, search: Search) -> Match:
    """Shift of each sector, and the turn that explains them with pushes of the right sign."""
    if reference.columns < NARROWEST:
        return match_sectors(reference, current, search)
    coarse, status = coarse_shift(reference, current, search)
    sectors = local_shifts(reference, current, coarse.shift_px, SECTORS, PER_CIRCLE)
    if sectors.shift_px.size < SECTORS // 8:
        return Match(coarse.shift_px, np.inf, max(coarse.value, 0.0))
    posterior = turn_posterior(sectors, search.forward_px, reference.columns)
    turn, variance = _with_pooled(posterior, coarse, reference.pixels.size)
    spread = float(np.percentile(np.abs(sectors.shift_px - turn), 75))
    confidence = float(np.clip(sectors.mean_correlation, 0.0, 1.0))
    return Match(float(signed(turn, reference.columns)), variance, confidence, status, spread)


def turn_posterior(sectors: SectorShifts, forward_px: float, columns: int) -> Posterior:
    """Posterior of the turn from the shifts of sectors, on a grid that closes in on it."""
    index = np.round(sectors.centre_px * SECTORS / columns).astype(np.intp)
    expected = _hypotheses(columns, forward_px)
    chosen = _hypotheses_of(np.arange(0, DIRECTIONS, COARSE))
    low, high = (float(edge) for edge in np.percentile(sectors.shift_px, (3, 97)))
    low, high = low - 0.3, high + 0.3
    while True:
        grid, step = np.linspace(low, high, GRID, retstep=True)
        likelihood = INDEPENDENT * (expected[chosen] @ _log_likelihoods(sectors, index, grid))
        each = np.exp(likelihood - likelihood.max())
        weight = each.sum(axis=0, dtype=np.float64)
        pure = float(each[0].sum() / weight.sum())
        weight /= weight.sum()
        mean = float(weight @ grid)
        variance = float(weight @ (grid - mean) ** 2)
        if variance > step**2 or step < 1e-4:
            return Posterior(mean, variance + float(step**2) / 12.0, pure)
        best, at = np.unravel_index(likelihood.argmax(), likelihood.shape)
        if best:
            direction = (chosen[best] - 1) // len(SCALES_PX)
            chosen = _hypotheses_of((direction + np.arange(-COARSE // 2, COARSE // 2 + 1)) % DIRECTIONS)
        low, high = float(grid[at]) - 3.0 * step, float(grid[at]) + 3.0 * step


def _hypotheses_of(directions: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Indices of the hypothesis of no push, and of all those with these directions."""
    scales = len(SCALES_PX)
    return np.concatenate([[0], (1 + directions[:, None] * scales + np.arange(scales)).ravel()])


def _log_likelihoods(sectors: SectorShifts, index: npt.NDArray[np.intp], grid: Floats) -> npt.NDArray[np.float32]:
    """Log-likelihood of each sector's shift for each tabulated mean push, each sign, each turn of the grid.

    Noise is normal, a push exponential. Their convolution is approximated by one expression that is the normal for
    the wrong sign and for small pushes, and the exponential for large ones.

    Returns
    -------
    (2 * pushes * SECTORS, GRID) array
        Zero for sectors without an answer.
    """
    residual = (sectors.shift_px[:, None] - grid).astype(np.float32)
    sigma = sectors.sigma_px[:, None].astype(np.float32)
    square = residual * residual
    mean = np.asarray(PUSHES_PX, np.float32)[:, None, None]
    table = np.empty((2, len(PUSHES_PX), *residual.shape), np.float32)
    for sign, pushed in enumerate((np.maximum(residual, 0.0), np.maximum(-residual, 0.0))):
        np.multiply(mean, pushed, out=table[sign])
    table += 2.0 * sigma * sigma
    np.divide(square, table, out=table)
    table += np.log(mean + 2.5 * sigma)
    everywhere = np.zeros((2, len(PUSHES_PX), SECTORS, grid.size), np.float32)
    everywhere[:, :, index] = np.maximum(-table, np.float32(OUTLIER))
    return everywhere.reshape(-1, grid.size)


@lru_cache(maxsize=4)
def _hypotheses(columns: int, forward_px: float) -> npt.NDArray[np.float32]:
    """Which mean push each hypothesis expects of each sector, as weights of the tabulated ones.

    Returns
    -------
    (1 + DIRECTIONS * scales, 2 * pushes * SECTORS) array
        The first hypothesis is a turn without any push. First pushes to the right, then to the left.
    """
    azimuth = -2.0 * np.pi * (np.arange(SECTORS) / SECTORS - forward_px / columns)
    weights = np.zeros((1 + DIRECTIONS * len(SCALES_PX), 2, len(PUSHES_PX), SECTORS), np.float32)
    weights[0, 0, 0] = 1.0
    level = np.log(PUSHES_PX[1:])
    for index in range(DIRECTIONS * len(SCALES_PX)):
        direction, scale = divmod(index, len(SCALES_PX))
        across = np.sin(azimuth - 2.0 * np.pi * direction / DIRECTIONS)
        push = np.log(np.maximum(SCALES_PX[scale] * np.abs(across), PUSHES_PX[1]))
        position = np.interp(push, level, 1.0 + np.arange(level.size))
        below = np.minimum(position.astype(int), len(PUSHES_PX) - 2)
        sign = np.where(across > 0.0, 1, 0)  # what lies to the left of the way moves left
        sector = np.arange(SECTORS)
        weights[1 + index, sign, below, sector] = 1.0 - (position - below)
        weights[1 + index, sign, below + 1, sector] = position - below
    return weights.reshape(len(weights), -1)


def _with_pooled(posterior: Posterior, coarse: Peak, pixels: int) -> tuple[float, float]:
    """Where nothing but a turn happened, all rows pooled know it best: they reach the Cramer-Rao bound."""
    bound = 2.0 * max(1.0 - coarse.value, 1e-6) / (pixels * max(-coarse.curvature, 1e-12))
    apart = coarse.shift_px - posterior.mean_px
    pure = posterior.pure_turn if apart**2 < 9.0 * posterior.variance_px2 else 0.0
    turn = posterior.mean_px + pure * apart
    variance = pure * bound + (1.0 - pure) * posterior.variance_px2 + pure * (1.0 - pure) * apart**2
    return turn, variance
