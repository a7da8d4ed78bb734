"""A strip as corners are tracked in it: of one brightness and contrast, softened, wrapped round the circle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from compass.agreement import DISAGREE
from compass.images.strip import Pixels, Strip

Grey = npt.NDArray[np.uint8]

# Columns of the other end on either side: ORB sees nothing within half of its patch of an edge, 15 pixels of its
# coarsest level, which are 54; corners that are tracked would do with 32
# (docs/lab-notes/halves-and-doubles-2026-11-30.md).
MARGIN = 64
# across neighbours, a deviation of 0.6 pixels: interpolation between sharp pixels pulls tracks to whole columns
SOFT = cv2.getGaussianKernel(3, 0.6, cv2.CV_32F)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Pixels round a point that are compared together.

    Attributes
    ----------
    half, side : int
        Pixels from the middle to the edge, and from edge to edge.
    across, down : (n,) arrays
        Columns and rows of the pixels from the middle.
    weights : (n,) array
        Gaussian, their sum is one.
    """

    half: int
    side: int
    across: Pixels
    down: Pixels
    weights: Pixels

    @staticmethod
    def of(half: int) -> Window:
        """So many pixels from the middle to the edge.

        The weights' deviation is 0.6 of that: with 0.4, 0.9 and even ones increments err by 1.08, 0.99 and 0.95 to 1.02
        (docs/lab-notes/walk-2026-11-30.md).
        """
        down, across = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1).astype(np.float32)
        weights: Pixels = np.exp(-(across**2 + down**2) / (2.0 * (0.6 * half) ** 2))
        return Window(half, 2 * half + 1, across, down, weights / weights.sum())


# Of a corner; with 4 and 7 pixels from the middle to the edge held-out drives' increments err by 1.07 and 1.03 times as
# much, their raw yaw by 1.1 and 1.9 (docs/lab-notes/constants-2026-11-30.md).
WINDOW = Window.of(5)


class Picture:
    """Grey values of a strip for tracking.

    Parameters
    ----------
    strip : Strip
        What it is made of.

    Attributes
    ----------
    soft : (rows, columns + 2 * MARGIN) float32 array
        Grey values of one mean and deviation, whatever the exposure was: the middle of 0..255, which few of them leave.
    """

    def __init__(self, strip: Strip) -> None:
        self.strip = strip
        middle, means = 0.5 * 255.0, np.asarray(strip.means, np.float32)
        share = 1.0 if strip.seen is None else max(strip.seen.share, 1e-3)
        gain = middle / DISAGREE / max(float(np.sqrt(strip.contrast**2 / share + means.var())), 1.0)
        grey = np.empty((len(strip.pixels), strip.columns + 2 * MARGIN), np.float32)
        np.add(strip.pixels, means, out=grey[:, MARGIN:-MARGIN])
        grey[:, :MARGIN], grey[:, -MARGIN:] = grey[:, -2 * MARGIN : -MARGIN], grey[:, MARGIN : 2 * MARGIN]
        offset = middle - gain * float(means.mean())
        self.soft: Pixels = np.asarray(cv2.sepFilter2D(grey, -1, gain * SOFT, SOFT, grey, delta=offset), np.float32)

    @cached_property
    def bytes(self) -> Grey:
        """(rows, columns + 2 * MARGIN) uint8 array: `cv2.calcOpticalFlowPyrLK` takes no other."""
        # as `cv2.add` to that type does it, in two thirds of the time
        return np.asarray(cv2.convertScaleAbs(cv2.threshold(self.soft, 0.0, 0.0, cv2.THRESH_TOZERO)[1]), np.uint8)

    @property
    def rows(self) -> int:
        """Rows of the strip."""
        return int(self.soft.shape[0])

    @property
    def columns(self) -> int:
        """Columns of the full circle."""
        return self.strip.columns

    @cached_property
    def clear(self) -> npt.NDArray[np.bool_] | None:
        """(rows, columns) where the patch about a pixel shows nothing but the world; None: everywhere."""
        if self.strip.seen is None:
            return None
        return self.strip.seen.clear_of(WINDOW.half + 3)  # and of the blur and the interpolation
