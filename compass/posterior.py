"""Turn and parallax told apart: by the sign of the parallax, and by what grows.

When the camera moves by a step t in direction phi, a point at azimuth a and distance d moves by
``-rho sin(a - phi)`` beside the turn, ``rho = t / d``: nothing ahead and behind, one sign on the left, the other on the
right, and never the wrong sign, because distances are positive. And it grows by ``rho cos(a - phi)``, as by no turn.
Each sector's shift is therefore the turn, plus noise, plus a push of known sign whose size its growth tells, or, abeam
where nothing grows, the size that pushes typically have. The direction and the typical size are unknown: every
combination of a grid is a hypothesis, among them that of no push at all, and the turn's posterior is the sum over them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from compass.correlation import Floats
from compass.local import quantile
from compass.strip import Pixels

COARSE = 16  # directions of travel that are tried first
FINE = 2.0 * np.pi / 128 * np.arange(-4, 5)  # then about the best of them, rad
FINER = 4  # parts of a step between those, for the ones that are LIKELY and their neighbours
LIKELY = 6.0  # log-likelihood below the best of directions, scales and turns that are looked at more closely
SCALES_PX = np.array([0.1, 0.3, 1.0, 3.0, 10.0], np.float32)  # typical pushes that are tried
GROWTH_ERROR = 0.4  # of a growth itself: the parts of a sector lie at several distances
UNKNOWN_PX = 1e3
MISLED = 0.15  # probability that a sector's growth has nothing to do with its push
MISLED_PX = 3.0  # how large such a growth is
OUTLIER = -8.0  # log-likelihood of a sector that fits nothing: people, reflections, wrong peaks
FLAT = -6.0  # log-probability that no growth of the image tells a push: another projection, only upright lines
ROUGH_GRID = 13  # turns that are tried first
BLUNT = 0.25  # of a step between those: sharper likelihoods would fall between them
GRID = 25
NEGLIGIBLE = 12.0  # log-likelihood below the best of a hypothesis that is dropped
ABEAM = 0.02  # cosine below which a growth says nothing


@dataclass(frozen=True, slots=True)
class Posterior:
    """Turn in columns, mean and variance, and the share of sectors that by the likeliest hypothesis fit nothing."""

    mean_px: float
    variance_px2: float
    outliers: float


@dataclass(frozen=True, eq=False)
class SectorEvidence:
    """Sectors that have an answer; arrays of one length, float32 but for the shift.

    Attributes
    ----------
    azimuth : array
        From the robot's +x to the left, rad.
    shift_px, sigma_px : array
        Shift to the right and its deviation, columns.
    growth_px, growth_noise_px : array
        Growth and the deviation of its noise, columns; `UNKNOWN_PX` where it is not known.
    """

    azimuth: Pixels
    shift_px: Floats
    sigma_px: Pixels
    growth_px: Pixels
    growth_noise_px: Pixels

    @cached_property
    def growth_sigma_px(self) -> Pixels:
        """Deviation of a growth from what the push of its sector would have it be, columns."""
        sigma: Pixels = np.hypot(self.growth_noise_px, np.float32(GROWTH_ERROR) * self.growth_px)
        return sigma

    @cached_property
    def log_misled(self) -> Pixels:
        """Log-likelihood of each growth if it has nothing to do with a push."""
        return _log_normal(self.growth_px, np.hypot(self.growth_sigma_px, np.float32(MISLED_PX)))

    @cached_property
    def log_outlier(self) -> Pixels:
        """Log-likelihood of each sector if it fits nothing."""
        return self.log_misled + np.float32(OUTLIER)

    def every_other(self) -> SectorEvidence:
        """Half of the sectors, all round."""
        return SectorEvidence(*(getattr(self, field.name)[::2] for field in fields(self)))

    def blunted(self, sigma_px: float) -> SectorEvidence:
        """Shifts with so much more error: their likelihood does not fall between two turns of a grid."""
        return replace(self, sigma_px=np.hypot(self.sigma_px, np.float32(sigma_px)))

    def without_growth(self) -> SectorEvidence:
        """The shifts alone."""
        unknown = np.full_like(self.growth_px, UNKNOWN_PX)
        return replace(self, growth_px=np.zeros_like(unknown), growth_noise_px=unknown)


def turn_posterior(sectors: SectorEvidence) -> Posterior:
    """Posterior of the turn from the shifts and growths of sectors, on a grid that closes in on it."""
    low, high = quantile(sectors.shift_px, 0.03) - 0.3, quantile(sectors.shift_px, 0.97) + 0.3
    sectors, directions, scales, low, high = _roughly(sectors, low, high)
    directions, scales, low, high = _closer(sectors, directions, scales, low, high)
    while True:
        grid, step = _grid(low, high, GRID)
        each, likelihood = _log_likelihoods(sectors, directions, scales, grid)
        weight = np.exp(likelihood - likelihood.max()).sum(axis=0, dtype=np.float64)
        weight /= weight.sum()
        mean = float(weight @ grid)
        variance = float(weight @ (grid - mean) ** 2)
        hypothesis, turn = np.unravel_index(int(likelihood.argmax()), likelihood.shape)
        if variance > 0.25 * step**2 or step < 1e-4:  # a normal's sum over such steps is its integral
            outliers = each[hypothesis, turn] <= sectors.log_outlier
            return Posterior(mean, variance, float(outliers.mean()))
        peaks = likelihood[1:].max(axis=1).reshape(directions.size, scales.size)
        likely = peaks > peaks.max() - NEGLIGIBLE
        directions, scales = directions[likely.any(axis=1)], scales[likely.any(axis=0)]
        low, high = grid[turn] - 3.0 * step, grid[turn] + 3.0 * step


def _roughly(sectors: SectorEvidence, low: float, high: float) -> tuple[SectorEvidence, Floats, Pixels, float, float]:
    """What every other sector says: whether growths are of use, directions, scales and turns worth a closer look."""
    directions = 2.0 * np.pi / COARSE * np.arange(COARSE)
    grid, step = _grid(low, high, ROUGH_GRID)
    asked = sectors.every_other().blunted(BLUNT * step)
    residual = (asked.shift_px - grid[:, None]).astype(np.float32)
    typical = _log_typical(asked, directions, SCALES_PX, residual)
    flat = _of_all(_if_flat(asked, typical)) + FLAT
    pushed = _of_all(_if_pushed(asked, directions, SCALES_PX, residual, typical))
    if flat.max() > pushed.max():
        sectors, pushed = sectors.without_growth(), flat
    best = grid[int(np.maximum(pushed.max(axis=(0, 1)), _of_all(_if_unpushed(asked, residual))).argmax())]
    direction, scale = np.unravel_index(int(pushed.max(axis=2).argmax()), pushed.shape[:2])
    near = SCALES_PX[max(scale - 1, 0) : scale + 2]
    return sectors, directions[direction] + FINE, near, best - 2.0 * step, best + 2.0 * step


def _closer(
    sectors: SectorEvidence, directions: Floats, scales: Pixels, low: float, high: float
) -> tuple[Floats, Pixels, float, float]:
    """Directions in finer steps, scales and turns that are likely by what every other sector says."""
    grid, step = _grid(low, high, ROUGH_GRID)
    asked = sectors.every_other().blunted(BLUNT * step)
    _, likelihood = _log_likelihoods(asked, directions, scales, grid)
    pushed = likelihood[1:].reshape(directions.size, scales.size, ROUGH_GRID)
    likely = pushed > pushed.max() - LIKELY
    near = FINER * np.flatnonzero(likely.any(axis=(1, 2)))
    finer = np.unique(near[:, None] + np.arange(1 - FINER, FINER))
    turns = np.flatnonzero(likelihood.max(axis=0) > likelihood.max() - LIKELY)
    low, high = grid[max(turns[0] - 1, 0)], grid[min(turns[-1] + 1, ROUGH_GRID - 1)]
    return directions[0] + (FINE[1] - FINE[0]) / FINER * finer, scales[likely.any(axis=(0, 2))], low, high


def _log_likelihoods(
    sectors: SectorEvidence, directions: Floats, scales: Pixels, grid: Floats
) -> tuple[Pixels, Pixels]:
    """Of each turn of the grid by each hypothesis: first that of no push, then all directions with all scales.

    Returns
    -------
    (hypotheses, grid, sectors) and (hypotheses, grid) arrays
        Of each sector, and of all together.
    """
    residual = (sectors.shift_px - grid[:, None]).astype(np.float32)
    typical = _log_typical(sectors, directions, scales, residual)
    pushed = _if_pushed(sectors, directions, scales, residual, typical)
    each = np.concatenate([_if_unpushed(sectors, residual)[None], pushed.reshape(-1, *residual.shape)])
    return each, _of_all(each)


def _grid(low: float, high: float, count: int) -> tuple[Floats, float]:
    """Turns and the step between them, columns."""
    step = (high - low) / (count - 1)
    return low + step * np.arange(count), step


def _if_unpushed(sectors: SectorEvidence, residual: Pixels) -> Pixels:
    """(GRID, sectors) log-likelihood if nothing but a turn happened."""
    grown = _log_normal(sectors.growth_px, sectors.growth_sigma_px) + np.log(1.0 - MISLED)
    total = _log_normal(residual, sectors.sigma_px)
    total += np.maximum(grown, sectors.log_misled + np.log(MISLED))
    return np.maximum(total, sectors.log_outlier, out=total)


def _if_pushed(
    sectors: SectorEvidence, directions: Floats, scales: Pixels, residual: Pixels, typical: Pixels
) -> Pixels:
    """Log-likelihood of each turn of the grid for each direction of travel and each typical push.

    A push whose size the growth tells is normal, else all that is known is `typical`. Which of the two holds is decided
    by the larger, weighted by how much the growth leaves unknown.

    Parameters
    ----------
    directions, scales : arrays
        Of travel, rad, and typical pushes, columns.
    residual : (GRID, sectors) array
        Shifts less each turn of the grid, columns.
    typical : (directions, scales, GRID, sectors) array
        From `_log_typical`; what is in it is lost.

    Returns
    -------
    (directions, scales, GRID, sectors) array
    """
    aside = sectors.azimuth - directions[:, None].astype(np.float32)
    sine, cosine = np.sin(aside), np.cos(aside)
    steep = np.maximum(np.abs(cosine), ABEAM)
    ahead = sectors.growth_px * np.sign(cosine)
    size_sigma = sectors.growth_sigma_px / steep
    push = (-ahead / steep * sine).astype(np.float32)
    push_sigma: Pixels = np.hypot(sectors.sigma_px, sine * size_sigma)
    told = _log_normal(residual - push[:, None], push_sigma[:, None])
    grown = _log_exponential(ahead, sectors.growth_sigma_px, scales[:, None] * steep[:, None])
    unknown = 1.0 / (1.0 + (scales[:, None] / size_sigma[:, None]) ** 2)
    misled = sectors.log_misled
    weight_told = grown + np.log((1.0 - MISLED) * (1.0 - unknown) + 1e-9)
    weight_typical = np.maximum(grown + np.log((1.0 - MISLED) * unknown + 1e-9), misled + np.log(MISLED))
    typical += weight_typical[:, :, None]
    np.maximum(typical, told[:, None] + weight_told[:, :, None], out=typical)
    return np.maximum(typical, sectors.log_outlier, out=typical)


def _if_flat(sectors: SectorEvidence, typical: Pixels) -> Pixels:
    """The same if growths are but noise, whatever the push."""
    noise = np.maximum(_log_normal(sectors.growth_px, sectors.growth_noise_px), sectors.log_misled + np.log(MISLED))
    flat: Pixels = np.maximum(typical + noise, sectors.log_outlier)
    return flat


def _of_all(likelihood: Pixels) -> Pixels:
    """(..., sectors) -> (...) log-likelihood of all sectors together."""
    return likelihood @ np.ones(likelihood.shape[-1], np.float32)


def _log_typical(sectors: SectorEvidence, directions: Floats, scales: Pixels, residual: Pixels) -> Pixels:
    """(directions, scales, GRID, sectors) log-likelihood of each shift if all that is known of pushes is their mean.

    Noise is normal, a push a priori exponential. Their convolution is approximated by one expression that is the normal
    for the wrong sign and for small pushes, and the exponential for large ones.
    """
    sigma = sectors.sigma_px
    sine = np.sin(sectors.azimuth - directions[:, None].astype(np.float32))
    mean = scales[:, None] * np.abs(sine)[:, None]
    to_the_right = np.where(sine > 0.0, np.float32(-1.0), np.float32(1.0))  # what lies left of the way moves left
    pushed = np.maximum(residual * to_the_right[:, None], 0.0)
    total: Pixels = mean[:, :, None] * pushed[:, None]
    total += 2.0 * sigma * sigma
    np.divide(-residual * residual, total, out=total)
    total -= np.log(mean + 2.5 * sigma)[:, :, None]
    return total


def _log_exponential(ahead: Pixels, sigma: Pixels, mean: Pixels) -> Pixels:
    """(directions, scales, sectors) log-likelihood of each growth, positive ahead, if pushes have a known mean."""
    grown = ahead[:, None]
    return -(grown**2) / (2.0 * sigma**2 + mean * np.maximum(grown, 0.0)) - np.log(mean + 2.5 * sigma)


def _log_normal(value: Pixels, sigma: Pixels) -> Pixels:
    """Log-density of a normal; the root of 2 pi is 2.5 here as in the other densities."""
    density: Pixels = -0.5 * (value / sigma) ** 2 - np.log(2.5 * sigma)
    return density
