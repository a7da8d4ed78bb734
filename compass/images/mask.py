"""What belongs to the robot in the panorama, and must not be compared: it stands still however the robot turns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from compass.config import CompassConfig
from compass.errors import ConfigError, ImageError
from compass.files import read_bounded
from compass.images.decode import MOST_PIXELS, image_from_compressed

Weights = npt.NDArray[np.float32]

WHITE = 127  # grey values above are the robot's
MARGIN_PX = 2  # by which the robot is taken to be larger in the strip: its edges are blurred


@dataclass(frozen=True, eq=False)
class Seen:
    """Which pixels of a strip show the world.

    Attributes
    ----------
    pixels : (rows, columns) float32 array
        1 for the world, 0 for the robot.
    merged : int
        Rows of it in one of `smoothed`.
    """

    pixels: Weights
    merged: int = 1

    @cached_property
    def counts(self) -> Weights:
        """(rows, 1) pixels of the world in each row; 1 where there are none, to divide by."""
        counts: Weights = np.maximum(self.pixels.sum(axis=1, keepdims=True), np.float32(1.0))
        return counts

    @cached_property
    def share(self) -> float:
        """Of the strip that shows the world."""
        return float(self.pixels.mean())

    @cached_property
    def smoothed(self) -> Weights:
        """(rows // merged, columns) share of the world in each pixel of the smoothed strip."""
        rows = len(self.pixels) // self.merged
        smoothed: Weights = self.pixels[: rows * self.merged].reshape(rows, self.merged, -1).mean(axis=1)
        return smoothed


@dataclass(frozen=True, eq=False)
class RobotMask:
    """The picture in which the robot is white.

    Attributes
    ----------
    robot : (H, W) array of bool
        True where the robot is, for a panorama of any size.
    """

    robot: npt.NDArray[np.bool_]
    _seen: dict[tuple[int, ...], Seen] = field(default_factory=dict)

    def seen(self, image_shape: tuple[int, ...], region: slice, rows: int, columns: int, merged: int) -> Seen:
        """Which pixels of a strip of this size, cut from the rows `region` of a panorama, show the world."""
        key = (*image_shape[:2], region.start, region.stop, rows, columns, merged)
        if key not in self._seen:
            height, width = image_shape[:2]
            # what is only touched by the robot belongs to it, both when the picture is smaller and when it is larger
            full = cv2.resize(self.robot.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
            robot = np.asarray(cv2.resize(full[region], (columns, rows), interpolation=cv2.INTER_AREA))
            grown = _grown((robot > 1e-3).astype(np.uint8), MARGIN_PX)
            self._seen.clear()  # a camera changes its size seldom
            self._seen[key] = Seen(1.0 - grown.astype(np.float32), merged)
        return self._seen[key]


def load_mask(config: CompassConfig) -> RobotMask | None:
    """The mask that the settings name; None where they name none.

    Raises
    ------
    ConfigError
        The file is missing, no picture, or larger than any panorama.
    """
    if not config.mask:
        return None
    remedy = "give the path of a PNG in which the robot is white, or '' for no mask"
    try:
        # not compressed at all, in 8 bits, the largest picture is no larger than this
        picture = image_from_compressed(read_bounded(Path(config.mask), MOST_PIXELS, remedy))
    except ConfigError as error:
        raise ConfigError(f"mask: {error}") from None
    except ImageError as error:
        raise ConfigError(f"mask: {config.mask}: not a picture that can be read: {error}; {remedy}") from None
    return RobotMask((picture >> 8 if picture.dtype == np.uint16 else picture) > WHITE)


def _grown(robot: npt.NDArray[np.uint8], by: int) -> npt.NDArray[np.uint8]:
    """`robot` (0 or 1), larger by so many rows and columns, round the circle."""
    around = np.take(robot, np.arange(-by, robot.shape[1] + by), axis=1, mode="wrap")
    grown = cv2.dilate(np.ascontiguousarray(around), np.ones((2 * by + 1, 2 * by + 1), np.uint8))
    return np.asarray(grown, np.uint8)[:, by : by + robot.shape[1]]
