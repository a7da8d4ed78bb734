"""Which pixels of a strip show the world: not those of the robot, nor those that the camera does not see."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

Weights = npt.NDArray[np.float32]

# Of the circle, hidden in one piece; more, and the camera does not see all round. Of five tuned drives the raw yaw errs
# alike either way up to here, from 0.15 on less as of a camera that sees a part (docs/lab-notes/walk-2026-11-30.md).
MAST = 0.1


@dataclass(frozen=True, eq=False)
class Seen:
    """Which pixels of a strip show the world.

    Attributes
    ----------
    pixels : (rows, columns) float32 array
        1 for the world, 0 for the robot, and for what the camera does not see.
    merged : int
        Rows of it in one of `smoothed`.
    """

    pixels: Weights
    merged: int = 1
    _clear: dict[int, npt.NDArray[np.bool_]] = field(default_factory=dict, init=False)

    def clear_of(self, by: int) -> npt.NDArray[np.bool_]:
        """(rows, columns) where the world is seen in all pixels within `by` rows and columns, round the circle."""
        if by not in self._clear:
            hidden = cv2.copyMakeBorder(1.0 - self.pixels, 0, 0, by, by, cv2.BORDER_WRAP)
            near = cv2.dilate(np.asarray(hidden, np.float32), np.ones((2 * by + 1, 2 * by + 1), np.uint8))
            self._clear[by] = np.asarray(near[:, by:-by] < 0.5)
        return self._clear[by]

    @cached_property
    def counts(self) -> Weights:
        """(rows, 1) pixels of the world in each row; 1 where there are none, to divide by."""
        counts: Weights = np.maximum(self.pixels.sum(axis=1, keepdims=True), np.float32(1.0))
        return counts

    @cached_property
    def widest_hidden(self) -> float:
        """Share of the circle between two neighbouring columns that show anything of the world, at most."""
        columns = self.pixels.shape[1]
        shown = np.flatnonzero(self.pixels.any(axis=0))
        return float(np.diff(shown, append=shown[:1] + columns).max()) / columns if shown.size else 1.0

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
