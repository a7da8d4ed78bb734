"""Turn and parallax told apart: shifts and growths of sectors, and the turn that explains them (see `posterior`).

Where most sectors agree that there was nothing but a turn, all rows pooled say it best.
"""

from __future__ import annotations

import numpy as np

from compass.correlation import Floats, signed, upright_spectrum
from compass.increment import CompassStatus
from compass.local import CoarseShift, SectorShifts, coarse_shift, quantile
from compass.match import Match, Search
from compass.posterior import UNKNOWN_PX, SectorEvidence, turn_posterior
from compass.sectors import match_sectors
from compass.strip import Pixels, Strip
from compass.turn import pooled_turn, turn_variance
from compass.view import FEWEST, View, sector_index, sector_shifts, view

NARROWEST = 256  # columns; sectors of fewer than eight cannot tell parallax apart
AGREED = 1.5  # deviations: three sectors of four this near to all of them together saw nothing but a turn
GROWTH_FLOOR_PX = 0.1
FITTING = 0.7  # of its posterior's variance a turn has where every sector fits: most growths err by less than expected
DOUBT = 25.0  # and so much more per share of them that fits nothing: others are moved, too, then
CURVE_ERROR_PX = 0.03  # of a camera that turned by more than TURNING while parts moved apart by more than PUSHED_PX
TURNING = np.deg2rad(25.0)
PUSHED_PX = 0.7
UNRELATED_PX = 0.18  # a deviation beyond it: no turn explains the sectors, they show another place
LEAN_ERROR = 0.045  # of what is known of the camera's lean, rad


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
    posterior = turn_posterior(evidence)
    spread = quantile(np.abs(evidence.shift_px - posterior.mean_px), 0.75)
    left_out = _left_out(posterior.mean_px, spread, seen.tilt_left, columns)
    variance = posterior.variance_px2 * (FITTING + DOUBT * posterior.outliers) + left_out**2
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
    exact, spectrum = pooled_turn(reference, current, median)
    apart = _apart(sectors, exact.shift_px)
    if apart >= AGREED or exact.curvature >= 0.0:  # pixels that were doubled have no maximum half a column off
        return None
    shift = float(signed(exact.shift_px, reference.columns))
    spread = apart * quantile(sectors.sigma_px, 0.5)
    return Match(shift, turn_variance(exact, spectrum, reference), _confidence(sectors), coarse.status, spread)


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
