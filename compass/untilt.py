"""The view undone of a tilt that an IMU knows of, before it is compared with the keyframe.

What a tilt of some degrees moves up, down and aside is as much as a turn or a near wall would. Measured from the images
alone (see `growth`) it is known to a third of a degree while parts of the view move apart; an IMU knows it better.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from compass.attitude import Vector, about_z
from compass.mask import Seen
from compass.strip import Pixels, Strip

STEP = 8  # columns and rows from one point at which the way of a pixel is worked out to the next
WHOLLY = 0.99  # of a pixel must be of the world for it to count


def tilt_between(before: Vector, now: Vector, turn: float) -> tuple[float, float]:
    """Rotation of the scene about the camera's x and y, rad, after which the camera turned and the vertical was `now`.

    Parameters
    ----------
    before, now : (3,) tuple of float
        The vertical in the camera's frame, unit vectors.
    turn : float
        Of the camera about its own z axis, rad, to the left.
    """
    x, y, z = about_z(now, turn)
    aside_x, aside_y = x - before[0], y - before[1]
    aside = math.hypot(aside_x, aside_y)
    if aside < 1e-12:
        return 0.0, 0.0
    along_x, along_y = aside_x / aside, aside_y / aside
    angle = math.atan2(x * along_x + y * along_y, z)
    angle -= math.atan2(before[0] * along_x + before[1] * along_y, before[2])
    return -angle * along_y, angle * along_x


def untilted(strip: Strip, tilt: tuple[float, float], turn: float, forward_px: float) -> Strip:
    """What the camera would have seen if it had turned, but not tilted before.

    Rows that it did not see are those next to them.

    Parameters
    ----------
    tilt, turn : (2,) tuple of float, float
        As in `tilt_between`, rad.
    forward_px : float
        Column that looks along +x.
    """
    now = np.array(about_z((*tilt, 0.0), -turn))
    aside, down = _ways(strip, np.asarray(cv2.Rodrigues(now)[0], np.float64), forward_px)
    rows, columns = strip.pixels.shape
    margin = math.ceil(float(np.abs(aside).max())) + 1
    aside += np.arange(margin, margin + columns, dtype=np.float32)
    down += np.arange(rows, dtype=np.float32)[:, None]

    def moved(pixels: Pixels) -> Pixels:
        around = cv2.copyMakeBorder(pixels, 0, 0, margin, margin, cv2.BORDER_WRAP)
        return np.asarray(cv2.remap(around, aside, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)

    seen = strip.seen and Seen((moved(strip.seen.pixels) > WHOLLY).astype(np.float32), strip.seen.merged)
    return strip.with_pixels(moved(strip.pixels + strip.means), seen)


def _ways(strip: Strip, rotation: np.ndarray[tuple[int, int], np.dtype[np.float64]], forward_px: float) -> list[Pixels]:
    """(rows, columns) how far to the right, and how far down, each pixel's direction lies once it has been rotated."""
    rows, columns = strip.pixels.shape
    blocks = -(-rows // STEP), -(-columns // STEP)  # and one more on each side
    row, column = (STEP * (np.arange(-1, count + 1) + 0.5) for count in blocks)
    elevation = (strip.top - row * strip.row_height)[:, None]
    azimuth = -math.tau * (column - forward_px) / columns
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    x, y, z = (np.cos(elevation) * (r[0] * cosine + r[1] * sine) + np.sin(elevation) * r[2] for r in rotation)
    aside = np.arctan2(x * sine - y * cosine, x * cosine + y * sine) * columns / math.tau
    down = (elevation - np.arcsin(np.clip(z, -1.0, 1.0))) / strip.row_height
    size = STEP * (blocks[1] + 2), STEP * (blocks[0] + 2)
    whole = (cv2.resize(way.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) for way in (aside, down))
    return [np.ascontiguousarray(way[STEP : STEP + rows, STEP : STEP + columns], np.float32) for way in whole]
