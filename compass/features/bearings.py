"""Corners as directions on the sphere, and in the tangent planes there.

In the orthographic projection about a direction b great circles through b are straight lines: what was seen in b before
the camera moved along t is afterwards seen on the line through b's image and t's, away from t, however far it moved.
Epipolar geometry of panoramas: Svoboda & Pajdla 2002, doi:10.1023/A:1019869530073.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from compass.features.points import SECTORS, Floats
from compass.flow.correlation import FLOOR_PX
from compass.images.strip import Strip
from compass.tilt import turned

Complexes = npt.NDArray[np.complexfloating]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Projection:
    """Columns and rows of a strip to directions: x ahead, y left, z up.

    Attributes
    ----------
    per_column, per_row : float
        rad.
    forward : float
        Column that looks along +x.
    top : float
        Elevation of the strip's upper edge, rad.
    """

    per_column: float
    per_row: float
    forward: float
    top: float

    @staticmethod
    def of(strip: Strip, forward_px: float) -> Projection:
        """Of a strip, whose column `forward_px` looks along +x."""
        return Projection(math.tau / strip.columns, strip.row_height, forward_px, strip.top)

    def angles(self, at: Floats) -> tuple[Floats, Floats]:
        """Azimuths to the left and elevations, rad, of (n, 2) columns and rows."""
        return -self.per_column * (at[:, 0] + 0.5 - self.forward), self.top - self.per_row * (at[:, 1] + 0.5)

    def directions(self, at: Floats) -> Floats:
        """(3, n) unit vectors towards (n, 2) columns and rows."""
        azimuth, elevation = self.angles(at)
        level = np.cos(elevation)
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])

    def covariance(self, directions: Floats, right: Floats, mixed: Floats, down: Floats) -> Complexes:
        """Covariances of (3, n) directions from those of their pixels.

        Parameters
        ----------
        right, mixed, down : (n,) arrays
            Variance to the right, covariance, and variance downwards, pixels^2; `FLOOR_PX` is added.

        Returns
        -------
        (2, n) complex array
            As `compass.features.solver.Problem` has them.
        """
        column, row = np.hypot(*directions[:2]) * self.per_column, self.per_row
        least = (FLOOR_PX * self.per_column) ** 2
        left, up = column**2 * right + least, row**2 * down + least
        covariance = np.empty((2, len(left)), np.complex128)
        covariance[:] = 0.5 * (left + up), 0.5 * (left - up) + 1j * column * row * mixed
        return covariance

    def pixels(self, directions: Floats) -> Floats:
        """(n, 2) columns and rows of (3, n) vectors of unit length."""
        x, y, z = directions
        column = self.forward - 0.5 - np.arctan2(y, x) / self.per_column
        return np.stack(
            [column, (self.top - np.arcsin(np.minimum(np.maximum(z, -1.0), 1.0))) / self.per_row - 0.5], axis=1
        )


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Tangent planes at n directions, as complex planes: left is real, up imaginary.

    Attributes
    ----------
    ahead : (3, n) array
        Unit vectors, the directions themselves.
    axes : (3, n) complex array
        Their planes' axes: ``vector @ axes`` is what a vector has to the left and up.
    sector : (n,) array
        In which of the circle's `SECTORS` they lie, by azimuth.
    """

    ahead: Floats
    axes: Complexes
    sector: Index

    @staticmethod
    def at(directions: Floats) -> Tangents:
        """At (3, n) unit vectors, none of them straight up or down."""
        x, y, z = directions
        level = np.hypot(x, y)
        axes = np.stack([-y - 1j * z * x, x - 1j * z * y, 1j * level * level]) / level
        return Tangents(directions, axes, ((np.arctan2(y, x) / math.tau % 1.0) * SECTORS).astype(np.intp))

    def some(self, index: Index | slice) -> Tangents:
        """Those of an index or a slice."""
        return Tangents(self.ahead[:, index], self.axes[:, index], self.sector[index])

    def project(self, directions: Floats) -> Complexes:
        """(n,) orthographic images of (3, n) unit vectors.

        Great circles through a plane's direction are straight lines in it, and what is off such a line is the sine of
        the angle to the circle, however far along it.
        """
        image: Complexes = (directions * self.axes).sum(axis=0)
        return image

    def rotating(self, directions: Floats) -> Complexes:
        """(3, n) rad per rad by which those move as the rotation that undoes yaw, and tilt about x and y, changes."""
        x, y, z = directions
        by_x, by_y, by_z = self.axes
        # undoing a tilt rotates the other way
        return np.stack([x * by_y - y * by_x, z * by_y - y * by_z, x * by_z - z * by_x])


def undo(yaw: float, tilt_x: float, tilt_y: float) -> Floats:
    """(3, 3) rotation that brings what is seen back to before the scene tilted about x and y and the camera turned."""
    untilt: Floats = np.asarray(cv2.Rodrigues(np.array([-tilt_x, -tilt_y, 0.0]))[0]) @ turned(yaw)
    return untilt
