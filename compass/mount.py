"""How the camera is tilted on the robot, by the axis about which it turns.

A camera that is not mounted level sees a turn of the robot as one about an axis that is askew by as much: a turn about
its own z axis, too small by the cosine (1.5 % at 10 deg), and a tilt that goes to and fro with the heading. An IMU
knows how the robot itself tilts; what is left shows the mount.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from compass.agreement import DISAGREE
from compass.history import RECENT
from compass.tilt import STEEPEST_COSINE, TILT_NOISE, Vector, about_z, beyond_error, camera_rotation, tilt_between

# Half and double of each: docs/lab-notes/mount-2026-11-30.md.
# Of a mount that nothing is known of; with 3 deg one that is knocked askew errs ten times as much.
SIGMA = math.radians(6.0)
# rad, least noise of the tilts that corners and IMU give together: of a simulated drive on level ground. With ten times
# as much, one that is knocked askew may stay unnoticed in small turns.
LEAST_NOISE = 0.001
LASTS = 5.0  # images in which an error is much the same, as they are compared with one keyframe


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Tilt of the camera on the robot.

    Attributes
    ----------
    x, y : float
        Of the robot's z axis in the camera's frame, a unit vector.
    variance : float
        Of either, rad^2.
    noise : float
        Variance of a tilt about either axis as corners and IMU give it, rad^2.
    """

    x: float = 0.0
    y: float = 0.0
    variance: float = SIGMA**2
    noise: float = TILT_NOISE**2

    @property
    def roll(self) -> float:
        """Of the camera on the robot, rad: positive where its right side is lower."""
        return math.atan2(self.y, math.sqrt(1.0 - self.x**2 - self.y**2))

    @property
    def pitch(self) -> float:
        """Of the camera on the robot, rad: positive where its front is lower."""
        return -math.asin(self.x)

    @property
    def sigma(self) -> float:
        """Standard deviation of either as it is told, rad.

        That of one tilt is in it: the error of the IMU's vertical is much the same in all of them.
        """
        return math.sqrt(self.variance + self.noise)

    def on_robot(self, turn: float, tilt: tuple[float, float]) -> tuple[float, tuple[float, float]]:
        """Turn and tilt of the robot, rad, of those that its camera saw, see `compass.tilt.Tilted.after`."""
        to_camera = self._rotation()
        return (turn, tilt) if to_camera is None else _parts(to_camera.T @ camera_rotation(turn, tilt) @ to_camera)

    def on_camera(self, turn: float) -> float:
        """Turn about its own axis, rad, that the camera sees when a level robot turns by so much."""
        to_camera = self._rotation()
        return turn if to_camera is None else _parts(to_camera @ camera_rotation(turn, (0.0, 0.0)) @ to_camera.T)[0]

    def seen(self, up: Vector) -> Vector:
        """The vertical in the camera's frame, of that in the robot's."""
        to_camera = self._rotation()
        if to_camera is None:
            return up
        x, y, z = (to_camera @ np.array(up)).tolist()
        return x, y, z

    def after(self, turn: float, tilt: tuple[float, float], before: Vector, now: Vector) -> CameraMount:
        """With what was seen of a turn: a Kalman filter's update.

        A mount that is off by m makes the tilt off by (R - 1) m, where R is the turn.

        Parameters
        ----------
        turn, tilt : float, (float, float)
            Of the camera, rad.
        before, now : (3,) tuple of float
            The vertical in the robot's frame at its ends.
        """
        turn, tilt = CameraMount(self.x, self.y, 0.0).on_robot(turn, tilt)
        expected = tilt_between(before, now, turn)
        aside = tilt[1] - expected[1], expected[0] - tilt[0], 0.0  # by how much the vertical seems to have moved
        back = about_z(aside, -turn)
        chord = 2.0 * (1.0 - math.cos(turn))  # squared, (R - 1)' (R - 1)
        variance, noise = self.variance, self.noise
        missed = aside[0] ** 2 + aside[1] ** 2
        if missed > 2.0 * DISAGREE**2 * (variance * chord + LASTS * noise):  # it was knocked, or the IMU errs this once
            return CameraMount(self.x, self.y)
        gain = variance / (variance * chord + LASTS * noise)
        x, y = self.x + gain * (back[0] - aside[0]), self.y + gain * (back[1] - aside[1])
        steepest = math.sqrt(1.0 - STEEPEST_COSINE**2)  # beyond it a camera does not look at the horizon
        less = min(steepest / max(math.hypot(x, y), steepest), 1.0)
        left = (1.0 - gain * chord) * missed / 2.0  # its noise is learnt: with a fixed one a knock is found late
        noise = max(noise + (left - noise) / RECENT, LEAST_NOISE**2)
        return CameraMount(less * x, less * y, (1.0 - gain * chord) * variance, noise)

    def _rotation(self) -> npt.NDArray[np.float64] | None:
        """From the robot's frame to the camera's, as far as it is beyond doubt; None where that is level."""
        up = self.x, self.y, math.sqrt(1.0 - self.x**2 - self.y**2)
        x, y, _ = beyond_error(up, math.sqrt(self.variance))
        sine = math.hypot(x, y)
        if not sine:
            return None
        angle = math.asin(sine) / sine
        return np.asarray(cv2.Rodrigues(np.array([-y * angle, x * angle, 0.0]))[0], np.float64)


def _parts(rotation: npt.NDArray[np.float64]) -> tuple[float, tuple[float, float]]:
    """Turn and tilt, rad, of the rotation that `camera_rotation` makes of them."""
    turn = math.atan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    cosine, sine = math.cos(turn), math.sin(turn)
    tilted = rotation @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    x, y, _ = cv2.Rodrigues(tilted)[0].ravel().tolist()
    return turn, (-x, -y)
