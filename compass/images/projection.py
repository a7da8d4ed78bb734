"""Where a camera's image shows a direction: one class a kind of projection, all with the same two questions.

Directions are azimuths, to the left of where the camera looks, and elevations, rad. The equidistant fisheye and its
distortion are OpenCV's (Kannala & Brandt 2006, doi:10.1109/TPAMI.2006.153); a ring's radius grows with the elevation
evenly (Chahl & Srinivasan 1997, doi:10.1364/AO.36.008275).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from compass.config import CompassConfig

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Places = tuple[Floats, Floats, Flags]

USUAL_FISHEYE = math.radians(190.0)  # a lens of a dual fisheye camera, if the settings do not say


class Projection(Protocol):
    """What an image of `height` x `width` pixels shows."""

    def __hash__(self) -> int: ...

    def locate(self, azimuth: Floats, elevation: Floats, height: int, width: int) -> Places:
        """Columns and rows where directions are seen, 0 in the middle of the first pixel, and whether they are."""

    def density(self, height: int, width: int) -> float:
        """Pixels per rad, where most are."""

    def elevation(self, part: float, height: int, width: int) -> float:
        """Elevation of a fraction of the height, as `roi_top` counts it, rad."""


@dataclass(frozen=True, slots=True)
class Panorama:
    """A panorama of a known angle across its width.

    Attributes
    ----------
    field_of_view : float
        Of the width, rad.
    tangent : bool
        Whether rows go by the tangent of the elevation (cylinder), not by the elevation itself.
    horizon_row : float
        A fraction of the height.
    """

    field_of_view: float
    tangent: bool
    horizon_row: float

    def locate(self, azimuth: Floats, elevation: Floats, height: int, width: int) -> Places:
        """See `Projection`."""
        density = self.density(height, width)
        steep = np.tan(elevation) if self.tangent else elevation
        x = np.broadcast_to(0.5 * width - azimuth * density - 0.5, np.broadcast(azimuth, elevation).shape)
        y = np.broadcast_to(self.horizon_row * height - steep * density - 0.5, x.shape)
        return x, y, (np.abs(x - 0.5 * (width - 1)) <= 0.5 * width) & (y >= -0.5) & (y <= height - 0.5)

    def density(self, height: int, width: int) -> float:
        """See `Projection`."""
        return width / self.field_of_view

    def elevation(self, part: float, height: int, width: int) -> float:
        """See `Projection`: of the image's own rows."""
        steep = (self.horizon_row - part) * height / self.density(height, width)
        return math.atan(steep) if self.tangent else steep


@dataclass(frozen=True, slots=True)
class Circle:
    """A round picture: centre and radius as fractions of the image's width, height and height; 0: as large as fits.

    `roll` is by how much it must be turned clockwise to stand upright, rad.
    """

    x: float
    y: float
    radius: float
    roll: float = 0.0

    def placed(self, x: Floats, y: Floats, height: int, width: int) -> tuple[Floats, Floats]:
        """Columns and rows of what lies `x` to the right and `y` below the centre, pixels, of the upright circle."""
        cosine, sine = math.cos(self.roll), math.sin(self.roll)
        return self.x * width - 0.5 + cosine * x + sine * y, self.y * height - 0.5 - sine * x + cosine * y

    def radius_px(self, height: int, width: int) -> float:
        """Radius, pixels."""
        fits = min(self.x * width, (1.0 - self.x) * width, self.y * height, (1.0 - self.y) * height)
        return self.radius * height if self.radius else fits


@dataclass(frozen=True, slots=True)
class Fisheye:
    """One fisheye lens.

    Attributes
    ----------
    circle : Circle
        The lens's picture.
    field_of_view : float
        Angle across the circle, rad.
    looks : str
        up, down, ahead or astern.
    focal : float
        A fraction of the height; 0: that with which the field of view fills the circle.
    k : tuple of 4 float
        Distortion.
    """

    circle: Circle
    field_of_view: float
    looks: str
    focal: float = 0.0
    k: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def locate(self, azimuth: Floats, elevation: Floats, height: int, width: int) -> Places:
        """See `Projection`."""
        right, down, along = _seen_along(self.looks, azimuth, elevation)
        off = np.hypot(right, down)
        from_axis = np.arctan2(off, along)
        # beyond the field of view the distortion's polynomial means nothing
        radius = self._focal_px(height, width) * self._distorted(np.minimum(from_axis, 0.5 * self.field_of_view))
        scale = radius / np.maximum(off, 1e-12)
        x, y = self.circle.placed(scale * right, scale * down, height, width)
        inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
        return x, y, inside & (from_axis <= 0.5 * self.field_of_view)

    def off_axis(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Cosines of the angles from the lens's axis."""
        return np.asarray(_seen_along(self.looks, azimuth, elevation)[2])

    def density(self, height: int, width: int) -> float:
        """See `Projection`."""
        return self._focal_px(height, width)

    def elevation(self, part: float, height: int, width: int) -> float:
        """See `Projection`: as in a panorama of the sphere."""
        return math.pi * (0.5 - part)

    def _focal_px(self, height: int, width: int) -> float:
        if self.focal:
            return self.focal * height
        widest = float(self._distorted(np.array(0.5 * self.field_of_view)))
        return self.circle.radius_px(height, width) / max(widest, 1e-9)

    def _distorted(self, angle: Floats) -> Floats:
        square = angle * angle
        k1, k2, k3, k4 = self.k
        return np.asarray(angle * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4)))))


@dataclass(frozen=True, slots=True)
class DualFisheye:
    """Two fisheye lenses back to back; each direction is taken from the lens whose axis is nearer."""

    ahead: Fisheye
    astern: Fisheye

    def locate(self, azimuth: Floats, elevation: Floats, height: int, width: int) -> Places:
        """See `Projection`."""
        first = self.ahead.off_axis(azimuth, elevation) >= 0.0
        one = self.ahead.locate(azimuth, elevation, height, width)
        other = self.astern.locate(azimuth, elevation, height, width)
        x, y, shown = (np.where(first, a, b) for a, b in zip(one, other, strict=True))
        return x, y, shown

    def density(self, height: int, width: int) -> float:
        """See `Projection`."""
        return self.ahead.density(height, width)

    def elevation(self, part: float, height: int, width: int) -> float:
        """See `Projection`."""
        return self.ahead.elevation(part, height, width)


@dataclass(frozen=True, slots=True)
class Ring:
    """A curved mirror, or a ring lens: azimuth round a centre, elevation evenly from an inner to an outer radius.

    `inner` is a fraction of the height; elevations are rad.
    """

    circle: Circle
    inner: float
    inner_elevation: float
    outer_elevation: float
    looks: str

    def locate(self, azimuth: Floats, elevation: Floats, height: int, width: int) -> Places:
        """See `Projection`."""
        right, down, _ = _seen_along(self.looks, azimuth, np.zeros_like(elevation))
        outer, inner = self.circle.radius_px(height, width), self.inner * height
        part = (elevation - self.inner_elevation) / (self.outer_elevation - self.inner_elevation)
        radius = inner + part * (outer - inner)
        x, y = self.circle.placed(radius * right, radius * down, height, width)
        inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
        return x, y, inside & (part >= 0.0) & (part <= 1.0)

    def density(self, height: int, width: int) -> float:
        """See `Projection`: along the radius, but no more than there are round the circle."""
        outer, inner = self.circle.radius_px(height, width), self.inner * height
        return min(outer, abs((outer - inner) / (self.outer_elevation - self.inner_elevation)))

    def elevation(self, part: float, height: int, width: int) -> float:
        """See `Projection`: as in a panorama of the sphere."""
        return math.pi * (0.5 - part)


def projection_of(config: CompassConfig, height: int, width: int) -> Projection:
    """The projection that the settings name, of images of this size; two circles lie along its longer side."""
    c = config
    view = math.radians(c.field_of_view_deg)
    if c.projection in ("equirectangular", "cylinder"):
        return Panorama(view or math.tau, c.projection == "cylinder", c.horizon_row)
    circle = Circle(c.circle_x or 0.5, c.circle_y or 0.5, c.circle_radius, math.radians(c.circle_roll_deg))
    if c.projection == "ring":
        elevations = math.radians(c.ring_inner_elevation_deg), math.radians(c.ring_outer_elevation_deg)
        return Ring(circle, c.ring_inner, *elevations, c.lens_looks)
    view, k = view or USUAL_FISHEYE, (c.fisheye_k1, c.fisheye_k2, c.fisheye_k3, c.fisheye_k4)
    if c.projection == "fisheye":
        return Fisheye(circle, view, c.lens_looks, c.fisheye_focal, k)
    first, second = ((0.25, 0.5), (0.75, 0.5)) if width >= height else ((0.5, 0.25), (0.5, 0.75))
    fits = min(width / 4, height / 2) if width >= height else min(width / 2, height / 4)
    radius = c.circle_radius or fits / height
    circle = Circle(c.circle_x or first[0], c.circle_y or first[1], radius, math.radians(c.circle_roll_deg))
    other = Circle(
        c.circle2_x or second[0], c.circle2_y or second[1], c.circle2_radius or radius, math.radians(c.circle2_roll_deg)
    )
    return DualFisheye(
        Fisheye(circle, view, "ahead", c.fisheye_focal, k), Fisheye(other, view, "astern", c.fisheye_focal, k)
    )


def _seen_along(looks: str, azimuth: Floats, elevation: Floats) -> tuple[Floats, Floats, Floats]:
    """To the right and down in the image, and along the lens's axis: parts of unit vectors of directions."""
    level = np.cos(elevation)
    ahead, left, up = level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth
    if looks == "up":
        return left, -ahead, up
    if looks == "down":
        return -left, -ahead, -up
    if looks == "ahead":
        return -left, -up, ahead
    return left, -up, -ahead
