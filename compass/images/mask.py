"""What belongs to the robot in the panorama, and must not be compared: it stands still however the robot turns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from compass.config import CompassConfig
from compass.errors import ConfigError, ImageError
from compass.files import read_bounded
from compass.images.decode import MOST_PIXELS, image_from_compressed
from compass.images.orientation import Orientation
from compass.images.seen import Seen, Weights
from compass.images.unwrap import BORDER_PX, Unwrapping


@dataclass(frozen=True, eq=False)
class RobotMask:
    """The picture in which the robot is white.

    Attributes
    ----------
    robot : (H, W) array of bool
        True where the robot is, for upright images of any size.
    """

    robot: npt.NDArray[np.bool_]
    _seen: dict[tuple[object, ...], Seen] = field(default_factory=dict)

    def seen(self, image_shape: tuple[int, ...], region: slice, rows: int, columns: int, merged: int) -> Seen:
        """Which pixels of a strip of this size, cut from the rows `region` of a panorama, show the world."""
        key = (*image_shape[:2], region.start, region.stop, rows, columns, merged)
        if key not in self._seen:
            robot = cv2.resize(self._sized(image_shape)[region], (columns, rows), interpolation=cv2.INTER_AREA)
            self._remember(key, _without(np.asarray(robot, np.float32)), merged)
        return self._seen[key]

    def seen_through(self, how: Unwrapping, image_shape: tuple[int, ...], merged: int) -> Seen:
        """The same of a strip that is unwrapped from an image of another projection, which shows less, too."""
        key = (how, merged)
        if key not in self._seen:
            world = _without(how.strip(self._sized(image_shape)[how.cut]))
            self._remember(key, world if how.shown is None else world * how.shown, merged)
        return self._seen[key]

    def _sized(self, image_shape: tuple[int, ...]) -> Weights:
        """The robot in images of a size; what it only touches belongs to it, be the picture smaller or larger."""
        height, width = image_shape[:2]
        return np.asarray(
            cv2.resize(self.robot.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA), np.float32
        )

    def _remember(self, key: tuple[object, ...], pixels: Weights, merged: int) -> None:
        self._seen.clear()  # a camera changes its size seldom
        self._seen[key] = Seen(pixels, merged)


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
    white = picture > np.iinfo(picture.dtype).max // 2
    return RobotMask(np.ascontiguousarray(Orientation.of(config).turned(white)))


def _without(robot: Weights) -> Weights:
    """1 where a strip of the robot shows none of it, nor its blurred edges, else 0."""
    return np.asarray(1.0 - _grown((robot > 1e-3).astype(np.uint8), BORDER_PX).astype(np.float32), np.float32)


def _grown(robot: npt.NDArray[np.uint8], by: int) -> npt.NDArray[np.uint8]:
    """`robot` (0 or 1), larger by so many rows and columns, round the circle."""
    around = np.take(robot, np.arange(-by, robot.shape[1] + by), axis=1, mode="wrap")
    grown = cv2.dilate(np.ascontiguousarray(around), np.ones((2 * by + 1, 2 * by + 1), np.uint8))
    return np.asarray(grown, np.uint8)[:, by : by + robot.shape[1]]
