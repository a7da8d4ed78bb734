"""How each part of the view has moved since the keyframe: aside, nearer and up, looked at twice.

The first look finds shifts as if nothing had risen, and growths as far as a gradient reaches. Then the rows are brought
back to where they were (see `risen`), and both are found anew, unless the view has hardly changed yet: what was missed
grows with it, and only the error of the last image before the keyframe moves stays. A tilt that an IMU tells of is
undone before.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from compass.correlation import Floats
from compass.growth import Growth, measure_growth
from compass.local import REACH_PX, TAPS, CoarseShift, SectorShifts, local_shifts
from compass.match import Search
from compass.strip import UPRIGHT_ROWS, Strip
from compass.untilt import tilt_between, untilted

SECTORS = 64
FEWEST = 8  # of them with an answer, or there is none
APART_PX = 2.0  # columns by which parts have moved apart from where on a second look tells more than the first
PER_CIRCLE = 32.0  # Hann windows of 11 deg, half as far apart
WORTH_UNDOING = 0.02  # rad of a tilt that an IMU tells of; smaller ones are its errors as often as not


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What the current strip shows, after a tilt has been `undone`, (2,) rad, that an IMU tells of.

    Attributes
    ----------
    growth : Growth or None
        None where the strip does not show the horizon and enough above it.
    """

    current: Strip
    sectors: SectorShifts
    growth: Growth | None
    undone: Floats

    @property
    def tilt_left(self) -> Floats:
        """(2,) what is left of the tilt, rad."""
        return np.zeros(2) if self.growth is None else self.growth.tilt

    @property
    def tilt(self) -> Floats:
        """(2,) all of it, rad."""
        return self.undone + self.tilt_left


def sector_shifts(reference: Strip, current: Strip, coarse: CoarseShift, reach_px: int = REACH_PX) -> SectorShifts:
    """Shifts of the sectors in rows so broad that what rises hardly disturbs them."""
    return local_shifts(reference, current, coarse.shift_px, SECTORS, PER_CIRCLE, UPRIGHT_ROWS, reach_px)


def view(reference: Strip, current: Strip, coarse: CoarseShift, sectors: SectorShifts, search: Search) -> View | None:
    """Shifts and growths, given the `sectors` of the first look; None where too few have an answer."""
    seen = _untilted(reference, current, coarse, sectors, search) or _look(reference, current, sectors)
    if seen is None or seen.sectors.apart_px < APART_PX:
        return seen
    return _look_again(reference, seen, coarse)


def sector_index(sectors: SectorShifts, columns: int) -> npt.NDArray[np.intp]:
    """Which of all `SECTORS` these are."""
    index: npt.NDArray[np.intp] = np.round(sectors.centre_px * SECTORS / columns).astype(np.intp) % SECTORS
    return index


def _look(
    reference: Strip, current: Strip, sectors: SectorShifts, undone: tuple[float, float] = (0.0, 0.0)
) -> View | None:
    if sectors.shift_px.size < FEWEST:
        return None
    growth = measure_growth(reference, current, sectors, SECTORS, PER_CIRCLE)
    return View(current, sectors, growth, np.array(undone))


def _look_again(reference: Strip, once: View, coarse: CoarseShift) -> View:
    """Shifts and growths of rows that follow what rose, where a sector matches better then."""
    if once.growth is None:
        return once
    columns = reference.columns
    current = replace(once.current, risen=once.growth.risen(once.sectors, columns))
    furthest = int(np.abs(once.sectors.shift_px - coarse.shift_px).max()) + 1
    again = sector_shifts(reference, current, coarse, min(furthest + TAPS + 1, REACH_PX))
    if again.shift_px.size < FEWEST:
        return once
    growth = measure_growth(reference, current, again, SECTORS, PER_CIRCLE, once.growth)
    if growth is None:
        return once
    correlation = np.full((2, SECTORS), -np.inf)
    correlation[0, sector_index(once.sectors, columns)] = once.sectors.correlation
    correlation[1, sector_index(again, columns)] = again.correlation
    worse = correlation[0] > correlation[1]
    return replace(
        once,
        sectors=_merged(once.sectors, again, worse, columns),
        growth=Growth(
            np.where(worse, once.growth.growth_px, growth.growth_px),
            np.where(worse, once.growth.sigma_px, growth.sigma_px),
            np.where(worse, once.growth.aside_px, growth.aside_px),
            growth.tilt,
        ),
    )


def _merged(once: SectorShifts, again: SectorShifts, worse: npt.NDArray[np.bool_], columns: int) -> SectorShifts:
    """Sectors of the first look where the second is `worse`, (SECTORS,), else of the second."""
    kept, new = worse[sector_index(once, columns)], ~worse[sector_index(again, columns)]
    order = np.concatenate([once.centre_px[kept], again.centre_px[new]]).argsort()
    parts = ((getattr(once, field.name)[kept], getattr(again, field.name)[new]) for field in fields(SectorShifts))
    return SectorShifts(*(np.concatenate(pair)[order] for pair in parts))


def _untilted(
    reference: Strip, current: Strip, coarse: CoarseShift, sectors: SectorShifts, search: Search
) -> View | None:
    """The view without the tilt that an IMU tells of; None where there is none, or the IMU errs."""
    if reference.up is None or current.up is None:
        return None
    turn = coarse.shift_px * 2.0 * np.pi / reference.columns
    tilt = tilt_between(reference.up, current.up, turn)
    if np.hypot(*tilt) < WORTH_UNDOING:
        return None
    level = untilted(current, tilt, turn, search.forward_px)
    better = sector_shifts(reference, level, coarse)
    if better.mean_correlation <= sectors.mean_correlation:
        return None
    seen = _look(reference, level, better, tilt)
    return seen if seen is not None and np.hypot(*seen.tilt_left) <= np.hypot(*seen.tilt) else None
