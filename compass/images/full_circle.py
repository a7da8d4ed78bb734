"""Whether a panorama shows the full circle, once: that its ends join, its middle does, and its halves differ.

Half a circle taken for a whole doubles every turn, a picture that shows the circle twice halves it, and both match from
image to image as well as any. What tells is the images alone. Columns that are neighbours look alike, also those on
either side of the seam where the circle is cut: the step across the seam is compared with that between neighbours
elsewhere (0) and with that between columns far apart (1). And when the camera turns, what leaves at one end comes in at
the other: it is as much like what it was before (1) as all that stays in the picture, or it is something else (0).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
import scipy.fft

from compass.flow.coarse_shift import PEAKS_PER_CIRCLE
from compass.images.decode import Image, to_grey
from compass.images.seen import MAST
from compass.images.strip import MIN_TEXTURE, UPRIGHT_ROWS, Pixels, Strip
from compass.images.unwrap import BORDER_PX

EVERY = 5  # images from one that is looked at to the next, ten times as many after the first verdict
VIEWS = 8  # different ones: as many tosses of a coin agree by chance in one case of 2^8, about three deviations
DARK = 16.0  # grey values of 255: black of video (ITU-R BT.601), as corners are that two round pictures leave
# Halfway from what neighbours have to what any columns have. Medians over views of six photographs cut anywhere, two
# real videos, a simulated corridor / the same photographs and a video of which half a circle, or nine tenths, are left:
# step across the seam at most 0.09, and 0.25 for an imperfect seam / 0.78 to 1.2, and 0.55 to 1.0; correlation of the
# halves at most 0.22 / 0.64 to 0.94 where the circle is shown twice.
HALFWAY = 0.5
# Likeness from which on what crosses a seam is the same on both sides. Of what crosses the picture's ends three of four
# views have less, and of what crosses a blank part more. Drives, photographs and a video, 37 in all, across their ends:
# at least 0.98 of a full circle and 0.92 of one with a black border; at most 0.85 in 18 of 19 of halves, all of nine
# tenths, 13 of 16 of 350 deg. Across a blank part: at least 0.95 in 15 of 16 circles beside a bar, at most 0.84 in 11
# of 12 with a dark part.
JOINS = 0.9
TURN_FACTOR_SIGMA = 0.5  # of the turns it shows: of half a circle half is true, two of them show half of it


@dataclass(frozen=True, slots=True)
class CircleVerdict:
    """What is seen of the circle; numbers are medians over `views`, NaN where nothing was seen.

    Attributes
    ----------
    since_ns : int
        Stamp of the first view.
    views : int
        Different views looked at.
    seam, middle : float
        Step between the picture's ends, and in its middle; 0: as between neighbours, 1: as between any columns.
    crossing : float
        How alike is what leaves at one end and comes in at the other; 1: as much as what stays in the picture.
    twice : float
        Correlation of the two halves, -1..1.
    blank : float
        Share of the width that never shows anything.
    closing : float
        As `crossing`, of the picture without what shows nothing; the lower quartile.
    discs : bool
        Whether it is two round pictures side by side.
    """

    since_ns: int
    views: int
    seam: float
    middle: float
    crossing: float
    twice: float
    blank: float
    closing: float
    discs: bool

    @property
    def turn_factor_sigma(self) -> float:
        """Standard deviation of the factor by which all turns may be wrong alike."""
        dark = self.blank > MAST and not self.discs and not self.has_bars  # of a full circle a part may be dark
        return TURN_FACTOR_SIGMA if self.fault and not dark else 0.0

    @property
    def has_bars(self) -> bool:
        """Whether the circle lies beside something blank: what is shown joins across it."""
        return self.closing >= JOINS

    @property
    def fault(self) -> str:
        """What is wrong, in words; empty where nothing is."""
        if self.discs:
            return "they are two round pictures side by side, as a camera with two fisheye lenses takes them"
        if self.twice > HALFWAY:
            return f"their two halves show the same (correlation {self.twice:.2f}): the circle twice, as in stereo"
        if self.has_bars:
            return f"{100.0 * self.blank:.0f} % of their width are blank bars, beside a circle whose ends join"
        if self.blank > MAST:
            return f"{100.0 * self.blank:.0f} % of their width shows nothing"
        if self.middle > HALFWAY:
            return f"two pictures lie side by side that do not join in the middle ({self._step(self.middle)})"
        if self.seam > HALFWAY:
            return f"their left and right ends do not join ({self._step(self.seam)})"
        if self.crossing < JOINS:
            return (
                "what leaves at one end does not come in at the other, so that their ends do not join"
                f" (a likeness of {self.crossing:.2f}; 1: as of what stays in the picture)"
            )
        return ""

    def _step(self, step: float) -> str:
        return f"a step of {step:.2f} there; 0: as between neighbouring columns, 1: as between any two"


class CircleCheck:
    """Gathers views of a panorama, and says whether they show the full circle."""

    def __init__(self) -> None:
        self._count = 0
        self._since_ns = 0
        self._last: Pixels | None = None  # view
        self._last_strip: Strip | None = None
        self._near = self._far = 0.0  # steps between its columns: neighbours, and far apart
        self._views = 0
        self._looked = 0
        self._discs = 0
        self._steps: tuple[deque[float], deque[float]] = (deque(maxlen=8 * VIEWS), deque(maxlen=8 * VIEWS))
        self._crossing: deque[float] = deque(maxlen=8 * VIEWS)
        self._closing: deque[float] = deque(maxlen=8 * VIEWS)
        self._twice: deque[float] = deque(maxlen=8 * VIEWS)
        self._blank: npt.NDArray[np.bool_] | None = None
        self._verdict: CircleVerdict | None = None

    def look(self, strip: Strip, image: Image, encoding: str = "") -> None:
        """Take in an image that has texture, with the strip cut out of it."""
        self._count += 1
        every = EVERY if self._views <= 2 * VIEWS else 10 * EVERY  # a look takes half as long as an update
        if (self._count - 1) % every or strip.columns < 4 * (BORDER_PX + 1):
            return
        self._looked += 1
        self._discs += _two_discs(image, encoding)
        stride = max(len(strip.pixels) // UPRIGHT_ROWS, 1)
        pixels = np.ascontiguousarray(strip.pixels[::stride])
        if self._last is not None and not self._is_new(pixels, self._last):
            return
        blank = None
        if strip.seen is None:
            grey = pixels + np.asarray(strip.means, np.float32)[::stride]
            blank = grey.std(axis=0) < MIN_TEXTURE
        if self._last is None or self._last_strip is None:
            self._since_ns = strip.t_ns
        else:
            self._views += 1
            changed = _difference(pixels, self._last) > self._near
            self._judge_steps(pixels, changed)
            self._crossing.extend(_likeness_of_crossing(self._last_strip, strip, changed))
            self._twice.append(_likeness_of_halves(strip))
            blank = None if self._blank is None or blank is None else self._blank & blank
            if blank is not None and 2 * BORDER_PX < np.count_nonzero(blank) < blank.size:
                rest = _shown_in_one_piece(blank)
                before, now = (_part(one, rest) for one in (self._last_strip, strip))
                self._closing.extend(_likeness_of_crossing(before, now, changed[rest]))
        self._last, self._last_strip, self._blank, self._verdict = pixels, strip, blank, None
        shown = pixels if blank is None else pixels[:, ~blank]
        if shown.size:
            self._near, self._far = (float(_steps(shown, apart).mean()) for apart in (1, shown.shape[1] // 4))

    def _is_new(self, pixels: Pixels, last: Pixels) -> bool:
        """Whether half of what the columns show, those that never show anything left out, has changed.

        A column has changed that differs by more than neighbours do, in which the camera's noise is the same.
        """
        some = slice(None, None, 4)
        changed = np.abs(pixels[:, some] - last[:, some]).mean(axis=0) > self._near
        shown = changed.size if self._blank is None else np.count_nonzero(~self._blank[some])
        return bool(0 < shown <= 2 * np.count_nonzero(changed))

    def _judge_steps(self, pixels: Pixels, changed: npt.NDArray[np.bool_]) -> None:
        """Steps at the seam and in the middle, except where something belongs to the robot, which does not change."""
        columns = pixels.shape[1]
        apart = [(skipped, _steps(pixels, 2 * skipped + 1)) for skipped in (0, BORDER_PX)]  # a stitcher may leave black
        near = [float(np.median(steps)) for _, steps in apart]
        for at, found in zip((0, columns // 2), self._steps, strict=True):
            if changed[at - 1 - BORDER_PX] and changed[at + BORDER_PX]:
                across = [float(steps[at - 1 - skipped]) for skipped, steps in apart]
                found.append(min((a - n) / max(self._far - n, 1e-3) for a, n in zip(across, near, strict=True)))

    @property
    def verdict(self) -> CircleVerdict | None:
        """What was seen so far; None before enough different views were."""
        if self._verdict is None and (self._views >= VIEWS or self._discs >= VIEWS):
            seam, middle = (float(np.median(steps)) if len(steps) >= VIEWS else math.nan for steps in self._steps)
            crossing, closing = (
                float(np.quantile(found, part)) if 2 * len(found) >= VIEWS else math.nan
                for found, part in ((self._crossing, 0.75), (self._closing, 0.25))
            )
            twice = float(np.median(self._twice)) if self._twice else math.nan
            blank = 0.0 if self._blank is None else float(self._blank.mean())
            discs = 2 * self._discs > self._looked
            numbers = seam, middle, crossing, twice, blank, closing
            self._verdict = CircleVerdict(self._since_ns, self._views, *numbers, discs)
        return self._verdict


def _steps(pixels: Pixels, apart: int) -> Pixels:
    """(columns,) mean difference of each column from the one so far to its right."""
    return _difference(pixels, np.roll(pixels, -apart, axis=1))


def _difference(one: Pixels, other: Pixels) -> Pixels:
    """(columns,) mean difference between the columns of two pictures."""
    return np.asarray(cv2.reduce(cv2.absdiff(one, other), 0, cv2.REDUCE_AVG)[0], np.float32)


def _likeness_of_halves(strip: Strip) -> float:
    """Correlation of the strip with itself half a circle further on, or nearly so."""
    columns = strip.columns
    spectrum = strip.upright_spectrum
    likeness = scipy.fft.irfft((spectrum.real**2 + spectrum.imag**2).sum(axis=0), columns)
    near = columns // (2 * PEAKS_PER_CIRCLE)  # stereo: the second picture may lie beside the middle
    around = likeness[columns // 2 - near : columns // 2 + near + 1]
    return float(around.max() / max(float(likeness[0]), 1e-9))


def _likeness_of_crossing(before: Strip, now: Strip, changed: npt.NDArray[np.bool_]) -> list[float]:
    """Correlation with the view before of what has crossed the seam, over that of the rest; none where little has.

    Columns that have not `changed` belong to the robot, and cross nothing.
    """
    columns, seen = now.columns, now.seen
    spectrum = np.sum(np.conj(before.upright_spectrum) * now.upright_spectrum, axis=0)
    shift = (int(np.argmax(scipy.fft.irfft(spectrum, columns))) + columns // 2) % columns - columns // 2
    crossed = np.zeros(columns, np.bool_)
    crossed[slice(0, shift) if shift > 0 else slice(columns + shift, columns)] = True
    shows = changed & np.roll(changed, shift)
    if (crossed & shows).sum() < 2 * BORDER_PX:  # as many on either side of the seam are blurred
        return []
    was, is_now = np.roll(before.smoothed, shift, axis=1), now.smoothed
    if seen is not None:
        world = np.floor(seen.smoothed)
        both = world * np.roll(world, shift, axis=1)
        was, is_now = was * both, is_now * both
    across, within = (_correlation(was[:, part], is_now[:, part]) for part in (crossed & shows, ~crossed & shows))
    return [across / within] if within > JOINS else []


def _shown_in_one_piece(blank: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Columns that show something, from the end of the widest gap on, so that the gap is where their ends meet."""
    shown = np.flatnonzero(~blank)
    gaps = np.diff(shown, prepend=shown[-1] - blank.size)
    return np.roll(shown, -int(gaps.argmax()))


def _part(strip: Strip, columns: npt.NDArray[np.intp]) -> Strip:
    """Some columns of a strip, as if they were all."""
    pixels = strip.pixels[:, columns]
    return replace(strip, pixels=pixels - pixels.mean(axis=1, keepdims=True))


def _correlation(one: Pixels, other: Pixels) -> float:
    """Normalised, of values whose mean is zero."""
    return float(np.vdot(one, other) / max(math.sqrt(float(np.vdot(one, one)) * float(np.vdot(other, other))), 1e-9))


def _two_discs(image: Image, encoding: str) -> bool:
    """Whether the corners that two round pictures leave are black, and they themselves are not.

    A row that is all black is none of theirs: it was not decoded.
    """
    height, width = image.shape[:2]
    y, x = ((np.arange(16) + 0.5) / 16.0, (np.arange(64) + 0.5) / 64.0)
    grey = to_grey(image[(y * height).astype(np.intp)][:, (x * width).astype(np.intp)], encoding).astype(np.float32)
    if image.dtype == np.uint16:
        grey /= np.float32(257.0)
    radius = np.hypot(2.0 * x % 1.0 - 0.5, y[:, None] - 0.5)  # from the middle of a disc, in its widths
    shown = grey.any(axis=1, keepdims=True)
    corner, disc = grey[(radius > 0.5) & shown], grey[(radius < 0.5) & shown]
    return bool(corner.size and np.median(corner) < DARK < np.median(disc))
