"""Rows averaged where what they show has moved to, up or down, since the keyframe.

A wall that comes nearer moves its texture through the rows by more than one of them, and what slants is moved aside by
that. Rows that follow it are compared as if nothing had risen. They are sums of pixels between two edges that lie
anywhere: differences of the cumulative sum down each column, one interpolation per edge instead of one per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]
Pixels = npt.NDArray[np.float32]

LOWEST = 0.5  # pixels of which an average is taken at least


@dataclass(frozen=True, slots=True, eq=False)
class Risen:
    """How far up what each column of a strip shows has moved, columns of the circle.

    Attributes
    ----------
    growth_px : (columns,) array
        By so much times ``sin(elevation) cos(elevation)``,
    rise_px : (columns,) array
        and by so much at every elevation.
    """

    growth_px: Floats
    rise_px: Floats

    def averages(self, sums: Pixels, group: int, top: float, row_height: float) -> Pixels:
        """(rows // group, columns) averages of what was in groups of rows before it rose.

        Parameters
        ----------
        sums : (rows + 1, columns) float32 array
            From `summed_down`.
        top, row_height : float
            As in `Strip`, rad.
        """
        rows, columns = len(sums) - 1, sums.shape[1]
        edge = np.arange(0, rows + 1, group, dtype=np.float32)
        elevation = top - edge * row_height
        per_row = np.float32(row_height * columns / (2.0 * np.pi))
        lifted = np.sin(elevation) * np.cos(elevation) / per_row
        edges = edge[:, None] - lifted.astype(np.float32)[:, None] * self.growth_px.astype(np.float32)
        edges -= self.rise_px.astype(np.float32) / per_row
        np.clip(edges, 0.0, np.float32(rows), out=edges)
        column = np.broadcast_to(np.arange(columns, dtype=np.float32), edges.shape)
        below = np.asarray(cv2.remap(sums, np.ascontiguousarray(column), edges, cv2.INTER_LINEAR), np.float32)
        height = np.maximum(np.diff(edges, axis=0), np.float32(LOWEST))
        return np.asarray(np.diff(below, axis=0) / height, np.float32)


def summed_down(pixels: Pixels) -> Pixels:
    """(rows + 1, columns) sums of all rows above each edge; `np.cumsum` down columns takes thirty times as long."""
    sums = np.zeros((len(pixels) + 1, pixels.shape[1]), np.float32)
    for row, above, below in zip(pixels, sums, sums[1:], strict=False):
        np.add(above, row, out=below)
    return sums
