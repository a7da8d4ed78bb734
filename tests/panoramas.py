"""Panoramas for the tests of the compass: drawn ones, real ones, and both turned by any part of a column.

A turn to the left by psi moves the scene to the right by psi * width / (2 pi) columns. Positive shifts are to the
right, so positive shifts are positive yaws.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.fft import irfft, rfft
from scipy.spatial.transform import Rotation

from compass import CompassStatus, VisualCompass, YawIncrement

SHARED, COMMITTED = Path(__file__).parents[2] / "shared" / "data" / "panoramas", Path(__file__).parent / "data"
PHOTOS = SHARED if SHARED.is_dir() else COMMITTED
PHOTO_NAMES = tuple(sorted(file.stem for file in PHOTOS.glob("*.jpg")))
needs_two_places = pytest.mark.skipif(len(PHOTO_NAMES) < 2, reason=f"one photograph in {PHOTOS}; more in {SHARED}")
FRAME_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
STARTS = {  # headings to start from, rad
    "0": 0.0,
    "60": math.radians(60.0),
    "180": math.pi,
    "-120": math.radians(-120.0),
    "pi-eps": math.pi - 1e-6,
    "eps-pi": 1e-6 - math.pi,
}

Image = npt.NDArray[np.generic]
Maps = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]
WRAP = 8  # columns by which Lanczos' filter may reach over the seam


@lru_cache(maxsize=16)
def scene(seed: int = 0, width: int = 1024, height: int = 128) -> npt.NDArray[np.float32]:
    """Grey values 40..215 with detail of every size, as photographs have it: amplitude falls with frequency.

    The circle is closed, and nothing is finer than a third of the finest that the columns can carry, so that a shift
    by part of a column is exact.
    """
    noise = np.random.default_rng(seed).normal(size=(height, width))
    across = np.fft.rfftfreq(width)[None, :]
    radius = np.hypot(np.fft.fftfreq(height)[:, None], across)
    spectrum = np.fft.rfft2(noise) / np.maximum(radius, 4.0 / width) ** 1.2
    spectrum *= np.exp(-((across / 0.17) ** 8))
    image = np.fft.irfft2(spectrum, (height, width))
    image -= image.mean()
    return _shared((127.5 + np.clip(image / image.std() * 35.0, -87.5, 87.5)).astype(np.float32))


def _shared(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """The image, which nobody may write into any more: it is given to all who ask."""
    image.flags.writeable = False
    return image


def slanting(image: Image) -> npt.NDArray[np.float32]:
    """`image` with edges that lean to the right by 35 deg, above the middle and below it: a roof and its mirror."""
    rows = np.abs(np.arange(len(image)) - (len(image) - 1) / 2.0)
    return np.concatenate([shifted(line[None], 0.7 * row) for line, row in zip(image, rows, strict=True)])


def shifted(image: Image, columns: float) -> npt.NDArray[np.float32]:
    """`image` moved right by a number of columns, whole or not (Fourier's shift theorem, along axis 1)."""
    width = image.shape[1]
    wave = np.exp(-2j * np.pi * columns * np.fft.rfftfreq(width))
    if width % 2 == 0:
        wave[-1] = math.cos(math.pi * columns)  # the finest wave of an even circle has no phase
    spectrum = rfft(image.astype(np.float64), axis=1)  # scipy's, which takes half of numpy's time
    wave = wave.reshape(1, -1, *[1] * (image.ndim - 2))
    spectrum *= wave
    return irfft(spectrum, width, axis=1, overwrite_x=True).astype(np.float32)


def turned(image: Image, yaw: float) -> npt.NDArray[np.float32]:
    """`image` after a turn to the left by `yaw` rad."""
    return shifted(image, yaw * image.shape[1] / math.tau)


def as_bytes(image: Image, noise: float = 0.0, seed: int = 0) -> npt.NDArray[np.uint8]:
    """Round to 8 bits, with a camera's noise of this sigma."""
    grey = np.rint(image + _noise(noise, seed, image.shape) if noise else image)
    return np.clip(grey, 0, 255, out=grey).astype(np.uint8)


@lru_cache(maxsize=8)  # most tests ask for the same few, and drawing one takes longer than comparing two images
def _noise(sigma: float, seed: int, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """White noise."""
    return np.random.default_rng(seed).normal(0.0, sigma, shape)


@cache
def photo(name: str) -> npt.NDArray[np.float32]:
    """Grey photograph, contrast compressed so that neither a shift nor noise leaves 0..255."""
    image = cv2.imread(str(PHOTOS / f"{name}.jpg"), cv2.IMREAD_GRAYSCALE)
    return _shared(image.astype(np.float32) * np.float32(0.7) + np.float32(38.0))


def show(compass: VisualCompass, *images: Image, t_ns: int = START_NS, every_ns: int = FRAME_NS) -> YawIncrement | None:
    """Give the images to the compass at a steady rate; what it says of the last one."""
    increment = None
    for index, image in enumerate(images):
        increment = compass.update(t_ns + index * every_ns, image)
    return increment


def compare(compass: VisualCompass, reference: Image, current: Image) -> YawIncrement:
    """Increment between two images, which must be given."""
    compass.reset()
    increment = show(compass, reference, current)
    if increment is None or compass.status is not CompassStatus.OK:
        raise AssertionError(f"no increment: {compass.status}")
    return increment


def azimuths(width: int) -> npt.NDArray[np.float64]:
    """Azimuth of the middle of each column, rad, from +x to the left: pi at the left edge, -pi at the right one."""
    return math.pi - math.tau * (np.arange(width) + 0.5) / width


def elevations(height: int) -> npt.NDArray[np.float64]:
    """Elevation of the middle of each row of a full sphere, rad, pi / 2 at the upper edge."""
    return math.pi / 2.0 - math.pi * (np.arange(height) + 0.5) / height


def seen_from(image: Image, step: float, direction: float, distance: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """A full-sphere panorama (2:1) after a step of the camera, rad for `direction`, m otherwise.

    All that stands at an azimuth is at one horizontal distance, like a wall: `distance` is for each column or for all.
    To first order it moves by ``-step / distance * sin(a - direction)`` rad to the right and rises by
    ``step / distance * cos(a - direction) * sin(e) * cos(e)``; this is the exact geometry.
    """
    height, width = image.shape[:2]
    far = np.broadcast_to(np.asarray(distance, float), width)
    return _looked_up(image, *_maps_after_a_step(height, width, step, direction, far.tobytes()))


@lru_cache(maxsize=4)
def _maps_after_a_step(height: int, width: int, step: float, direction: float, distances: bytes) -> Maps:
    """Where in a panorama is what `seen_from` shows."""
    now, far = azimuths(width), np.frombuffer(distances)
    before = now.copy()
    for _ in range(20):  # where was it that is seen there now: converges like (step / distance)^n
        d = np.interp(-before, -now, far, period=math.tau)
        x, y = d * np.cos(before) - step * math.cos(direction), d * np.sin(before) - step * math.sin(direction)
        before = before + np.angle(np.exp(1j * (now - np.arctan2(y, x))))
    elevation = np.arctan(np.tan(elevations(height))[:, None] * (np.hypot(x, y) / d)[None, :])
    return _maps(before[None, :], elevation)


def tilted(image: Image, about_x: float, about_y: float) -> npt.NDArray[np.float32]:
    """A full-sphere panorama (2:1) after the scene has rotated about x and y of the camera (a rotation vector, rad)."""
    return _looked_up(image, *_maps_after_a_tilt(*image.shape[:2], about_x, about_y))


@lru_cache(maxsize=4)
def _maps_after_a_tilt(height: int, width: int, about_x: float, about_y: float) -> Maps:
    """Where in a panorama is what `tilted` shows."""
    a, e = azimuths(width)[None, :], elevations(height)[:, None]
    now = np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)
    rotation = Rotation.from_rotvec([about_x, about_y, 0.0]).as_matrix()
    x, y, z = (sum(r * part for r, part in zip(axis, now, strict=True)) for axis in rotation.T)
    return _maps(np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0)))


def _maps(azimuth: npt.NDArray[np.float64], elevation: npt.NDArray[np.float64]) -> Maps:
    """Columns and rows of these angles in a full-sphere panorama that is wrapped by `WRAP` columns on either side."""
    height, width = elevation.shape
    column = ((math.pi - azimuth) / math.tau * width - 0.5) % width
    row = (math.pi / 2.0 - elevation) / math.pi * height - 0.5
    return np.repeat((column + WRAP).astype(np.float32), height // len(column), axis=0), row.astype(np.float32)


def _looked_up(image: Image, column: npt.NDArray[np.float32], row: npt.NDArray[np.float32]) -> Image:
    """Grey values of a full-sphere panorama there."""
    around = np.concatenate([image[:, -WRAP:], image, image[:, :WRAP]], axis=1)
    return cv2.remap(around, column, row, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
