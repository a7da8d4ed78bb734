"""From turns about the camera's own axis to its heading.

A camera that rolls and pitches as it turns comes back to the same view with another heading: rotations do not commute.
Three degrees of tilt make an eighth of a degree, each time anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

Vector = tuple[float, float, float]

STEEPEST_COSINE = 0.3  # cosine of the pitch; steeper, and the heading is that of nothing
# rad, error of a tilt by corners and IMU: two rotations in either order differ by half of their product, and
# `tilt_sigma` is 0.02
TILT_NOISE = 0.01
# So long is good what is summed up from image to image: a tilt that is not confirmed is forgotten, a view is compared
# with no more. On rough ground in a held-out place raw yaw errs by 0.48, 0.32, 0.27, 0.23, 0.23 deg where tilts last 0,
# 2.5, 5, 10 s and for ever; error^2/variance is 0.9, for ever 1.4. Long baselines of 4 s err by 1.03 times as much as
# those of 5, of any length by 1.3 (docs/lab-notes/constants-2026-11-30.md).
GOOD_FOR_S = 5.0


@dataclass(frozen=True, slots=True)
class Tilted:
    """Roll and pitch of the camera, its heading left out.

    Attributes
    ----------
    matrix : (3, 3) array
        Rotation from the camera's frame to that of its heading.
    """

    matrix: npt.NDArray[np.float64] = field(default_factory=lambda: np.eye(3))

    @staticmethod
    def upright(up: Vector) -> Tilted:
        """Of a camera in whose frame `up`, a unit vector, is the vertical; level where it looks straight up or down."""
        level = math.sqrt(max(1.0 - up[0] ** 2, 0.0))
        if level < STEEPEST_COSINE:
            return Tilted()
        x, y, z = up
        # plain numbers: `np.cross` takes as long as a step of the filter
        ahead = a, b, c = (1.0 - x**2) / level, -x * y / level, -x * z / level
        return Tilted(np.array([ahead, (y * c - z * b, z * a - x * c, x * b - y * a), up]))

    def after(self, turn: float, tilt: tuple[float, float]) -> tuple[Tilted, float]:
        """Its tilt, and how its heading has changed, rad, once the scene has rotated by `tilt` and then turned.

        Parameters
        ----------
        turn : float
            Of the camera about its own axis, rad, to the left.
        tilt : tuple of float
            Rotation of the scene about the camera's x and y before that, rad.
        """
        return _without_heading(self.matrix @ camera_rotation(turn, tilt))

    def before(self, turn: float, tilt: tuple[float, float]) -> tuple[Tilted, float]:
        """What its tilt was before the scene rotated and the camera turned as in `after`, and how its heading changed.

        The newest tilt is the one to start from: how the IMU is mounted is found out while the robot turns, and what
        was taken for its tilt before that may have been the mount.
        """
        tilted, heading = _without_heading(self.matrix @ camera_rotation(turn, tilt).T)
        return tilted, -heading

    def variance(self, turn: float, sigma: float) -> float:
        """Variance of that change of heading, rad^2, for errors `sigma` (rad) of roll and pitch; for small tilts."""
        sine_squared: float = 1.0 - self.matrix[2, 2] ** 2  # of the tilt
        return (sigma * math.sin(turn)) ** 2 * sine_squared

    def later(self, seconds: float) -> Tilted:
        """The same some time later: level again, little by little."""
        rotation = cv2.Rodrigues(self.matrix)[0].ravel() * math.exp(-max(seconds, 0.0) / GOOD_FOR_S)
        return Tilted(_rotation(*rotation.tolist()))


def about_z(vector: Vector, angle: float) -> Vector:
    """A vector rotated about the z axis by an angle, rad."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1], vector[2]


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


def beyond_error(up: Vector, sigma: float) -> Vector:
    """The vertical with the tilt shrunk so that level ground, seen with errors of `sigma` (rad), is level.

    The effect of a tilt on the heading goes with its square, and a measured square is biased by that of its errors.
    """
    sine = math.hypot(up[0], up[1])  # of the tilt
    if up[2] > 0.0 and sine <= sigma:
        return 0.0, 0.0, 1.0
    less = math.sqrt(1.0 - (sigma / max(sine, sigma)) ** 2) if sine else 1.0
    x, y = less * up[0], less * up[1]
    return x, y, math.copysign(math.sqrt(max(1.0 - x * x - y * y, 0.0)), up[2])


def turned(angle: float) -> npt.NDArray[np.float64]:
    """(3, 3) rotation about the z axis by an angle, rad."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def camera_rotation(turn: float, tilt: tuple[float, float]) -> npt.NDArray[np.float64]:
    """Rotation of a camera before which the scene rotates by `tilt`, and that then turns, see `Tilted.after`."""
    return np.asarray(_rotation(-tilt[0], -tilt[1], 0.0) @ turned(turn), np.float64)


def _without_heading(rotation: npt.NDArray[np.float64]) -> tuple[Tilted, float]:
    """The tilt of an attitude, and its heading, rad."""
    heading = math.atan2(rotation[1, 0], rotation[0, 0])
    return Tilted(turned(-heading) @ rotation), heading


def _rotation(x: float, y: float, z: float) -> npt.NDArray[np.float64]:
    """Matrix of a rotation vector, rad."""
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0], np.float64)
