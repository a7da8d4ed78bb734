"""Image -> strip: the region of interest in grey, at the size that is compared."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
import scipy.fft

from compass.config import CompassConfig
from compass.images.decode import Image, to_grey
from compass.images.mask import RobotMask
from compass.images.orientation import Orientation
from compass.images.projection import projection_of
from compass.images.seen import Seen
from compass.images.unwrap import unwrapping
from compass.mount import CameraMount
from compass.tilt import Vector

Pixels = npt.NDArray[np.float32]
Spectrum = npt.NDArray[np.complex64]

# What rises or sinks by less than such a row does not disturb how far it moved sideways; 12 and 48 are as good
# (docs/lab-notes/walk-2026-11-30.md).
UPRIGHT_ROWS = 24
MIN_TEXTURE = 1.1  # grey values of 255; camera noise of 4 alone leaves 0.9 at 1024 columns


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
        The vertical in the robot's frame (x ahead, y left, z up), a unit vector; None where it is not known.
    mount : CameraMount
        How the camera is tilted on the robot, as far as it was known when the strip was cut.
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
    mount: CameraMount = field(default_factory=CameraMount)

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

    @cached_property
    def smoothed(self) -> Pixels:
        """(at most `UPRIGHT_ROWS`, columns) rows averaged in groups, and columns by 1 2 1."""
        group = _merged(len(self.pixels))
        rows = len(self.pixels) // group
        averages = self.pixels[: rows * group].reshape(rows, group, -1).sum(axis=1)
        averages *= np.float32(1.0 / group)
        return softened_columns(averages)

    @cached_property
    def upright_spectrum(self) -> Spectrum:
        """(rows, columns // 2 + 1) Fourier transform of each row of `smoothed`."""
        return scipy.fft.rfft(self.smoothed, axis=1)  # type: ignore[no-any-return]

    @cached_property
    def texture(self) -> float:
        """Standard deviation of `smoothed`, grey values of 255: of the scene, hardly of the noise."""
        size = self.smoothed.size * (1.0 if self.seen is None else self.seen.share)
        return math.sqrt(self.energy / max(size, 1.0))

    @cached_property
    def energy(self) -> float:
        """Sum of the squares of `smoothed`, grey values^2."""
        return float(np.vdot(self.smoothed, self.smoothed))


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
    the panorama's circle is cut would add a false one. What belongs to the robot by `mask` is zero, the mean, and so is
    what the image does not show, of other projections than the full equirectangular one.
    """
    oriented = Orientation.of(config)
    if not oriented.is_upright and isinstance(image, np.ndarray) and image.ndim >= 2:
        image = oriented.upright(image)
    if not config.is_full_panorama and isinstance(image, np.ndarray) and image.ndim >= 2:
        return _unwrapped(t_ns, image, config, encoding, mask, up, oriented)
    region = _region(image, config)
    grey = _grey(region, encoding, oriented)
    height, width = grey.shape
    merged = -(-height // config.rows)  # whole rows merged into one: exact, and quick
    rows, columns = height // merged, min(config.columns, width)
    small: Pixels = grey[: rows * merged].astype(np.float32)
    if (rows, columns) != (height, width):
        small = np.asarray(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
    _scale(small, grey)
    seen = None
    if mask is not None:
        first = _top(image.shape[0], config)
        cut = slice(first, first + rows * merged)
        seen = mask.seen(image.shape, cut, rows, columns, _merged(rows))
    small, means = _without_row_means(small, seen)
    per_row = math.tau / width  # square pixels
    above = config.horizon_row * image.shape[0] - _top(image.shape[0], config)
    contrast = _contrast(small)
    return Strip(t_ns, small, contrast, image.shape, above * per_row, merged * per_row, seen, means, up)


def _unwrapped(
    t_ns: int,
    image: Image,
    config: CompassConfig,
    encoding: str,
    mask: RobotMask | None,
    up: Vector | None,
    oriented: Orientation,
) -> Strip:
    """The strip of an upright image of any projection."""
    height, width = image.shape[:2]
    projection = projection_of(config, height, width)
    region = config.roi_top, config.roi_bottom
    how = unwrapping(projection, (height, width), region, config.columns, config.rows)
    small = how.strip(_grey(image[how.cut], encoding, oriented))
    _scale(small, image)
    merged = _merged(how.rows)
    seen = how.seen(merged) if mask is None else mask.seen_through(how, (height, width), merged)
    small, means = _without_row_means(small, seen)
    return Strip(t_ns, small, _contrast(small), image.shape, how.top, how.row_height, seen, means, up)


def _scale(pixels: Pixels, image: Image) -> None:
    """Bring the grey values of an image of 16 bits to 255, in place."""
    if image.dtype.itemsize == 2:
        pixels *= np.float32(1.0 / 257.0)


def _grey(region: Image, encoding: str, oriented: Orientation) -> Image:
    """Grey and contiguous, of a view of the upright image; turned once it is grey, which is less to move."""
    if oriented.is_upright:
        return to_grey(region, encoding)
    return np.ascontiguousarray(oriented.turned(to_grey(oriented.as_taken(region), encoding)))


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


def softened_columns(pixels: Pixels) -> Pixels:
    """Columns smoothed by 1 2 1, round the circle."""
    around = cv2.copyMakeBorder(pixels, 0, 0, 1, 1, cv2.BORDER_WRAP)
    return np.ascontiguousarray(cv2.GaussianBlur(around, (3, 1), 0.0)[:, 1:-1], np.float32)


def _merged(rows: int) -> int:
    """How many of so many rows have to be averaged for at most `UPRIGHT_ROWS` to be left."""
    return -(-rows // UPRIGHT_ROWS)


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
