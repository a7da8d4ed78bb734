"""Turn and parallax told apart: by the sign of the parallax, and by what grows.

When the camera moves by a step t in direction phi, a point at azimuth a and distance d moves by
``-rho sin(a - phi)`` beside the turn, ``rho = t / d``: nothing ahead and behind, one sign on the left, the other on the
right, and never the wrong sign, because distances are positive. And it grows by ``rho cos(a - phi)``, as by no turn.
Each sector's shift is therefore the turn, plus noise, plus a push of known sign whose size its growth tells, or, abeam
where nothing grows, the size that pushes typically have. The direction, most likely along the robot's x, and the
typical size are unknown: every combination of a grid is a hypothesis, among them that of no push at all, and the turn's
posterior is the sum over them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from compass.correlation import Floats, Peak, continuous_peak, pooled_spectrum, signed, upright_spectrum
from compass.increment import CompassStatus
from compass.local import CoarseShift, SectorShifts, coarse_shift, quantile
from compass.match import Match, Search
from compass.sectors import match_sectors
from compass.strip import Pixels, Strip
from compass.view import FEWEST, View, sector_index, sector_shifts, view

NARROWEST = 256  # columns; sectors of fewer than eight cannot tell parallax apart
AGREED = 1.5  # deviations: three sectors of four this near to all of them together saw nothing but a turn
COARSE = 16  # directions of travel that are tried first
FINE = 2.0 * np.pi / 128 * np.arange(-4, 5)  # and then about the best of them, rad
ALONG = 0.05  # rad by which a robot that drives along its x, ahead or back, slips aside or its camera looks
ALONG_ODDS = 25.0  # that it does so
SCALES_PX = np.array([0.1, 0.3, 1.0, 3.0, 10.0], np.float32)  # typical pushes that are tried
GROWTH_ERROR = 0.4  # of a growth itself: the parts of a sector lie at several distances
GROWTH_FLOOR_PX = 0.1
UNKNOWN_PX = 1e3
MISLED = 0.15  # probability that a sector's growth has nothing to do with its push
MISLED_PX = 3.0  # how large such a growth is
OUTLIER = -8.0  # log-likelihood of a sector that fits nothing: people, reflections, wrong peaks
INDEPENDENT = 1.0  # share of the sectors: each has half its columns in common with its neighbours
FLAT = -6.0  # log-probability that no growth of the image tells a push: another projection, only upright lines
ROUGH_GRID = 13  # turns that are tried first
BLUNT = 0.25  # of a step between those: sharper likelihoods would fall between them
GRID = 25
NEGLIGIBLE = 12.0  # log-likelihood below the best of a hypothesis that is dropped
CURVE_ERROR_PX = 0.03  # of a camera that turned by more than TURNING while parts moved apart by more than PUSHED_PX
TURNING = np.deg2rad(15.0)
PUSHED_PX = 0.7
UNRELATED_PX = 0.18  # a deviation beyond it: no turn explains the sectors, they show another place
LEAN_ERROR = 0.045  # of what is known of the camera's lean, rad
MASKED_ERROR_PX = 0.007  # what the edges of a mask, which stay, leave in all rows pooled
ABEAM = 0.02  # cosine below which a growth says nothing


@dataclass(frozen=True, slots=True)
class Posterior:
    """Turn in columns: mean and variance."""

    mean_px: float
    variance_px2: float


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

    def every_other(self) -> SectorEvidence:
        """Half of the sectors, all round."""
        return SectorEvidence(*(getattr(self, field.name)[::2] for field in fields(self)))

    def without_growth(self) -> SectorEvidence:
        """The shifts alone."""
        unknown = np.full_like(self.growth_px, UNKNOWN_PX)
        return replace(self, growth_px=np.zeros_like(unknown), growth_noise_px=unknown)


def match_parallax(reference: Strip, current: Strip, search: Search) -> Match:
    """Shift and growth of each sector, and the turn that explains them with pushes of the right sign and size."""
    columns = reference.columns
    if columns < NARROWEST:
        return match_sectors(reference, current, search)
    coarse = coarse_shift(upright_spectrum(reference, current), columns, search)
    sectors = sector_shifts(reference, current, coarse)
    turned = _match_turn(reference, current, coarse, sectors)
    if turned is not None:
        return turned
    seen = view(reference, current, coarse, sectors, search)
    if seen is None:
        return Match(float(coarse.shift_px), np.inf, max(coarse.correlation, 0.0))
    evidence = _evidence(seen, search.forward_px, columns)
    posterior = turn_posterior(evidence, coarse.shift_px * np.pi / columns)
    spread = quantile(np.abs(evidence.shift_px - posterior.mean_px), 0.75)
    variance = posterior.variance_px2 + _left_out(posterior.mean_px, spread, seen.tilt_left, columns) ** 2
    status = CompassStatus.LOW_CONFIDENCE if variance > UNRELATED_PX**2 else coarse.status
    shift = float(signed(posterior.mean_px, columns))
    tilt_x, tilt_y = seen.tilt.tolist()
    return Match(shift, variance, _confidence(seen.sectors), status, spread, (tilt_x, tilt_y))


def _match_turn(reference: Strip, current: Strip, coarse: CoarseShift, sectors: SectorShifts) -> Match | None:
    """All rows pooled, where most sectors agree with them that there was nothing but a turn; else None."""
    if sectors.shift_px.size < FEWEST:
        return None
    median = quantile(sectors.shift_px, 0.5)
    if _apart(sectors, median) >= AGREED:
        return None
    exact = continuous_peak(pooled_spectrum(reference, current), reference.columns, median)
    apart = _apart(sectors, exact.shift_px)
    if apart >= AGREED:
        return None
    shift = float(signed(exact.shift_px, reference.columns))
    spread = apart * quantile(sectors.sigma_px, 0.5)
    return Match(shift, _bound(exact, reference), _confidence(sectors), coarse.status, spread)


def _confidence(sectors: SectorShifts) -> float:
    return float(np.clip(sectors.mean_correlation, 0.0, 1.0))


def _apart(sectors: SectorShifts, shift_px: float) -> float:
    """How far, in their deviations, three sectors of four at most lie from a shift."""
    return quantile(np.abs(sectors.shift_px - shift_px) / sectors.sigma_px, 0.75)


def _left_out(turn_px: float, spread_px: float, tilt: Floats, columns: int) -> float:
    """Error of a turn that the posterior does not know of, columns.

    A camera that turns as it is pushed moves on a curve, not on a line. And what a tilt has to do with the heading
    depends on how the camera leans (see `attitude`).
    """
    turning = min(abs(turn_px) * 2.0 * np.pi / columns / TURNING, 1.0) * min(spread_px / PUSHED_PX, 1.0)
    leaning = LEAN_ERROR * np.hypot(*tilt) * columns / (2.0 * np.pi)
    return float(np.hypot(CURVE_ERROR_PX * turning, leaning))


def _evidence(seen: View, forward_px: float, columns: int) -> SectorEvidence:
    """Sectors where their texture is, with the share of growth and tilt taken out of their shifts."""
    sectors, growth = seen.sectors, seen.growth
    azimuth: Floats = -2.0 * np.pi * (sectors.texture_px + 0.5 - forward_px) / columns  # of columns' middles
    shift: Floats
    noise: Floats
    shift, grown, noise = sectors.shift_px, np.zeros_like(azimuth), np.full_like(azimuth, UNKNOWN_PX)
    if growth is not None:
        index = sector_index(sectors, columns)
        grown, shift = growth.growth_px[index], shift - growth.aside_px[index]
        noise = np.hypot(growth.sigma_px[index], GROWTH_FLOOR_PX)
    return SectorEvidence(_single(azimuth), shift, _single(sectors.sigma_px), _single(grown), _single(noise))


def _single(values: Floats) -> Pixels:
    return values.astype(np.float32)


def turn_posterior(sectors: SectorEvidence, chord: float) -> Posterior:
    """Posterior of the turn from the shifts and growths of sectors, on a grid that closes in on it.

    Parameters
    ----------
    chord : float
        Where a robot drives to, or comes from, that follows its x while it turns: to the left by half the turn, rad.
    """
    low, high = quantile(sectors.shift_px, 0.03) - 0.3, quantile(sectors.shift_px, 0.97) + 0.3
    sectors, directions, scales, low, high = _roughly(sectors, chord, low, high)
    while True:
        grid, step = _grid(low, high, GRID)
        residual = (sectors.shift_px - grid[:, None]).astype(np.float32)
        typical = _log_typical(sectors, directions, scales, residual)
        pushed = _log_likelihood_pushed(sectors, directions, scales, residual, typical)
        pushed += _log_along(directions - chord)[:, None, None]
        likelihood = np.vstack([_log_likelihood_unpushed(sectors, residual), pushed.reshape(-1, GRID)])
        weight = np.exp(likelihood - likelihood.max()).sum(axis=0, dtype=np.float64)
        weight /= weight.sum()
        mean = float(weight @ grid)
        variance = float(weight @ (grid - mean) ** 2)
        if variance > 0.25 * step**2 or step < 1e-4:  # a normal's sum over such steps is its integral
            return Posterior(mean, variance)
        peaks = pushed.max(axis=2)
        likely = peaks > peaks.max() - NEGLIGIBLE
        directions, scales = directions[likely.any(axis=1)], scales[likely.any(axis=0)]
        best = float(grid[int(likelihood.argmax()) % GRID])
        low, high = best - 3.0 * step, best + 3.0 * step


def _roughly(
    sectors: SectorEvidence, chord: float, low: float, high: float
) -> tuple[SectorEvidence, Floats, Pixels, float, float]:
    """What every other sector says: whether growths are of use, directions, scales and turns worth a closer look."""
    directions = chord + 2.0 * np.pi / COARSE * np.arange(COARSE)
    grid, step = _grid(low, high, ROUGH_GRID)
    asked = sectors.every_other()
    asked = replace(asked, sigma_px=np.hypot(asked.sigma_px, np.float32(BLUNT * step)))
    residual = (asked.shift_px - grid[:, None]).astype(np.float32)
    typical = _log_typical(asked, directions, SCALES_PX, residual)
    along = _log_along(directions - chord)[:, None, None]
    flat = _log_likelihood_flat(asked, typical) + FLAT + along
    pushed = _log_likelihood_pushed(asked, directions, SCALES_PX, residual, typical) + along
    if flat.max() > pushed.max():
        sectors, pushed = sectors.without_growth(), flat
    unpushed = _log_likelihood_unpushed(asked, residual)
    best = float(grid[int(np.vstack([unpushed, pushed.reshape(-1, ROUGH_GRID)]).argmax()) % ROUGH_GRID])
    direction, scale = np.unravel_index(int(pushed.max(axis=2).argmax()), pushed.shape[:2])
    near = SCALES_PX[max(scale - 1, 0) : scale + 2]
    return sectors, directions[direction] + FINE, near, best - 2.0 * step, best + 2.0 * step


def _log_along(aside: Floats) -> Pixels:
    """Log-odds of directions of travel, so far from the robot's chord, rad: along it rather than any other way.

    They say nothing of whether the robot travels at all; less a constant (2.5) no result changed in five drives.
    """
    off = np.arcsin(np.sin(aside))
    return _single(np.log1p(ALONG_ODDS * np.exp(-0.5 * (off / ALONG) ** 2)))


def _grid(low: float, high: float, count: int) -> tuple[Floats, float]:
    """Turns and the step between them, columns."""
    step = (high - low) / (count - 1)
    return low + step * np.arange(count), step


def _log_likelihood_unpushed(sectors: SectorEvidence, residual: Pixels) -> Pixels:
    """Of each turn of the grid if nothing but a turn happened."""
    grown = _log_normal(sectors.growth_px, sectors.growth_sigma_px) + np.log(1.0 - MISLED)
    total = _log_normal(residual, sectors.sigma_px)
    total += np.maximum(grown, sectors.log_misled + np.log(MISLED))
    return _sum_of_sectors(np.maximum(total, sectors.log_misled + OUTLIER))


def _log_likelihood_pushed(
    sectors: SectorEvidence, directions: Floats, scales: Pixels, residual: Pixels, typical: Pixels
) -> Pixels:
    """Of each turn of the grid for each direction of travel and each typical push.

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
    (directions, scales, GRID) array
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
    np.maximum(typical, misled + OUTLIER, out=typical)
    return _sum_of_sectors(typical)


def _log_likelihood_flat(sectors: SectorEvidence, typical: Pixels) -> Pixels:
    """The same if growths are but noise, whatever the push."""
    noise = np.maximum(_log_normal(sectors.growth_px, sectors.growth_noise_px), sectors.log_misled + np.log(MISLED))
    return _sum_of_sectors(np.maximum(typical + noise, sectors.log_misled + OUTLIER))


def _sum_of_sectors(likelihood: Pixels) -> Pixels:
    """(..., sectors) -> (...): of all together, which are not independent."""
    return likelihood @ np.full(likelihood.shape[-1], INDEPENDENT, np.float32)


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


def _bound(peak: Peak, reference: Strip) -> float:
    """Cramer-Rao bound of the variance of the shift of all rows pooled, columns^2."""
    bound = 2.0 * max(1.0 - peak.value, 1e-6) / (reference.pixels.size * max(-peak.curvature, 1e-12))
    return bound if reference.seen is None else bound + MASKED_ERROR_PX**2
