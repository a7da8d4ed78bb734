"""Image -> strip: the region of interest in grey, at the size that is compared."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
import scipy.fft

from compass.attitude import Vector
from compass.config import CompassConfig
from compass.image import Image, to_grey
from compass.mask import RobotMask, Seen
from compass.risen import Risen, summed_down

Pixels = npt.NDArray[np.float32]
Spectrum = npt.NDArray[np.complex64]

SMOOTHED_ROWS = 40
UPRIGHT_ROWS = 24  # what rises or sinks by less than such a row does not disturb how far it moved sideways
HALVED_COLUMNS = 1024  # from so many on, half of them are enough to see what rises and sinks
_SOFT = np.array([0.25, 0.5, 0.25], np.float32)  # a kernel across neighbours
_ALONE = np.ones(1, np.float32)  # and one that leaves them as they are


@dataclass(frozen=True, eq=False)
class Strip:
    """A panorama's region of interest, ready to be compared.

    Attributes
    ----------
    t_ns : int
        Capture time, ns.
    pixels : (rows, columns) float32 array
        Grey values with the mean of each row taken out; 0 where the robot is.
    contrast : float
        Root of the mean square of `pixels`, grey values of 255.
    image_shape : tuple of int
        Of the image it was cut from.
    top, row_height : float
        Elevation of the upper edge and height of one row, rad.
    seen : Seen or None
        Which pixels show the world; None: all.
    means : (rows, 1) float32 array
        What was taken out of `pixels`.
    up : (3,) tuple of float or None
        The vertical in the camera's frame (x ahead, y left, z up), a unit vector; None where it is not known.
    risen : Risen or None
        What moved up or down and is brought back by `smoothed`, and by all that is made of it; not by `pixels`.
    """

    t_ns: int
    pixels: Pixels
    contrast: float
    image_shape: tuple[int, ...] = ()
    top: float = 0.0
    row_height: float = 0.0
    seen: Seen | None = None
    means: Pixels | float = 0.0
    up: Vector | None = None
    risen: Risen | None = None
    _averages: dict[int, tuple[Pixels, Pixels]] = field(default_factory=dict, init=False)

    def with_pixels(self, grey: Pixels, seen: Seen | None) -> Strip:
        """The same strip with other grey values, whose rows' means are still to be taken out."""
        pixels, means = _without_row_means(grey, seen)
        return replace(self, pixels=pixels, contrast=_contrast(pixels), seen=seen, means=means)

    @property
    def columns(self) -> int:
        """Columns of the full circle."""
        return int(self.pixels.shape[1])

    @cached_property
    def spectrum(self) -> Spectrum:
        """(rows, columns // 2 + 1) Fourier transform of each row."""
        return scipy.fft.rfft(self.pixels, axis=1)  # type: ignore[no-any-return]

    @cached_property
    def conjugate(self) -> Spectrum:
        """Complex conjugate of `spectrum`."""
        return np.conj(self.spectrum)

    def smoothed(self, at_most: int = SMOOTHED_ROWS) -> Pixels:
        """(at most so many, columns) rows averaged in groups, and columns by 1 2 1: sectors compare these.

        Without the highest frequencies a spline through the correlation at whole lags errs by thousandths of a
        column, with them by hundredths.
        """
        return self._averaged(at_most)[0]

    def _averaged(self, at_most: int) -> tuple[Pixels, Pixels]:
        """(at most so many, columns) rows averaged in groups, softened, and their (rows, 1) means, taken out."""
        if at_most not in self._averages:
            averages, means = self._grouped(_group(len(self.pixels), at_most))
            self._averages[at_most] = _softened_columns(averages), means
        return self._averages[at_most]

    def _grouped(self, group: int) -> tuple[Pixels, Pixels]:
        """(rows // group, columns) rows averaged in groups, and their (rows // group, 1) means, taken out."""
        if self.risen is not None:
            averages = self.risen.averages(self._sums, group, self.top, self.row_height)
            means = averages.mean(axis=1, keepdims=True)
            return averages - means, means
        rows = len(self.pixels) // group
        averages = self.pixels[: rows * group].reshape(rows, group, -1).sum(axis=1)
        averages *= np.float32(1.0 / group)
        means = np.broadcast_to(np.asarray(self.means, np.float32), (len(self.pixels), 1))
        return np.asarray(averages), means[: rows * group].reshape(rows, group, 1).mean(axis=1)

    @cached_property
    def _sums(self) -> Pixels:
        return summed_down(self.pixels + self.means)

    @cached_property
    def upright_spectrum(self) -> Spectrum:
        """(rows, columns // 2 + 1) Fourier transform of each row of `smoothed(UPRIGHT_ROWS)`."""
        return scipy.fft.rfft(self.smoothed(UPRIGHT_ROWS), axis=1)  # type: ignore[no-any-return]

    @property
    def column_stride(self) -> int:
        """Columns of `pixels` from one of `softened` to the next."""
        return 2 if self.columns % 2 == 0 and self.columns >= HALVED_COLUMNS else 1

    @cached_property
    def softened(self) -> Pixels:
        """Grey values, means included: every `column_stride`-th column, rows averaged by 1 2 1 for derivatives.

        What rises is told by how the rows differ. Without their means a plain wall shows the profile of all else upside
        down, and seems to rise as all else does.
        """
        averages, means = self._averaged(SMOOTHED_ROWS)
        columns = averages[:, :: self.column_stride] + means
        return np.asarray(cv2.sepFilter2D(columns, -1, _ALONE, _SOFT, borderType=cv2.BORDER_REPLICATE), np.float32)

    @cached_property
    def elevations(self) -> npt.NDArray[np.floating]:
        """Elevation of the middle of each row of `softened`, rad."""
        row = np.arange(self.softened.shape[0]) + 0.5
        return self.top - row * self.row_height * _group(len(self.pixels), SMOOTHED_ROWS)

    @cached_property
    def texture(self) -> float:
        """Standard deviation of `smoothed(UPRIGHT_ROWS)`, grey values of 255: of the scene, hardly of the noise."""
        smoothed = self.smoothed(UPRIGHT_ROWS)
        size = smoothed.size * (1.0 if self.seen is None else self.seen.share)
        return float(np.sqrt(np.vdot(smoothed, smoothed) / max(size, 1.0)))


def prepare_strip(
    t_ns: int,
    image: Image,
    config: CompassConfig,
    encoding: str = "",
    mask: RobotMask | None = None,
    up: Vector | None = None,
) -> Strip:
    """Cut the region of interest out of a panorama, make it grey and bring it to size.

    The strip is never larger than its source: enlarging adds no information, and interpolating over the seam where
    the panorama's circle is cut would add a false one. What belongs to the robot by `mask` is zero, the mean.
    """
    region = _region(image, config)
    grey = to_grey(region, encoding)
    height, width = grey.shape
    merged = -(-height // config.rows)  # whole rows merged into one: exact, and quick
    rows, columns = height // merged, min(config.columns, width)
    small: Pixels = grey[: rows * merged].astype(np.float32)
    if (rows, columns) != (height, width):
        small = np.asarray(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
    if grey.dtype == np.uint16:
        small *= np.float32(1.0 / 257.0)
    seen = None
    if mask is not None:
        first = _top(image.shape[0], config)
        cut = slice(first, first + rows * merged)
        seen = mask.seen(image.shape, cut, rows, columns, _group(rows, SMOOTHED_ROWS))
    small, means = _without_row_means(small, seen)
    per_row = math.tau / width  # square pixels
    above = config.horizon_row * image.shape[0] - _top(image.shape[0], config)
    contrast = _contrast(small)
    return Strip(t_ns, small, contrast, image.shape, above * per_row, merged * per_row, seen, means, up)


def _without_row_means(pixels: Pixels, seen: Seen | None) -> tuple[Pixels, Pixels]:
    """Take the mean of what is seen out of each row, in place; zero what is not seen. Gives the means, too."""
    if seen is None:
        means = np.asarray(cv2.reduce(pixels, 1, cv2.REDUCE_AVG), np.float32)
        pixels -= means
    else:
        pixels *= seen.pixels
        means = pixels.sum(axis=1, keepdims=True) / seen.counts
        pixels -= means
        pixels *= seen.pixels
    return pixels, means


def _contrast(pixels: Pixels) -> float:
    return float(np.sqrt(np.vdot(pixels, pixels) / pixels.size))


def _softened_columns(pixels: Pixels) -> Pixels:
    """Columns smoothed by 1 2 1, round the circle."""
    around = cv2.copyMakeBorder(pixels, 0, 0, 1, 1, cv2.BORDER_WRAP)
    return np.ascontiguousarray(cv2.sepFilter2D(around, -1, _SOFT, _ALONE)[:, 1:-1], np.float32)


def _group(rows: int, at_most: int) -> int:
    """How many of so many rows have to be averaged for at most so many to be left."""
    return -(-rows // at_most)


def _region(image: Image, config: CompassConfig) -> Image:
    """View of the region of interest; an image too small for it still gives one row."""
    if not isinstance(image, np.ndarray) or image.ndim < 2:
        return image  # to_grey says what is wrong
    height = image.shape[0]
    top = _top(height, config)
    return image[top : max(round(config.roi_bottom * height), top + 1)]


def _top(height: int, config: CompassConfig) -> int:
    """First row of the region of interest."""
    return max(min(round(config.roi_top * height), height - 1), 0)
