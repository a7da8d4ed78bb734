"""From a trajectory to clean frames: where the camera is at each frame, and what it sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fusion.simulation.body import robot_body
from fusion.simulation.camera import PanoramaCamera
from fusion.simulation.painter import CameraPose
from fusion.simulation.trajectory import Motion
from fusion.simulation.world import World

Frame = npt.NDArray[np.uint8]
Mount = tuple[float, float, float]


def camera_poses(motion: Motion, mount: Mount) -> list[CameraPose]:
    """Poses of a camera fixed at `mount` (x, y, z in m on the robot) along `motion`."""
    angles = np.stack([motion.yaw, motion.pitch, motion.roll], axis=1)
    base = np.stack([motion.x, motion.y, motion.z], axis=1)
    place = base + Rotation.from_euler("ZYX", angles).apply(np.asarray(mount, np.float64))
    rows = np.concatenate([place, angles], axis=1).tolist()
    return [CameraPose(*row) for row in rows]


@dataclass(frozen=True, eq=False)
class Renderer:
    """Renders the frames of one drive.

    Attributes
    ----------
    camera : PanoramaCamera
        Its size.
    poses : list of CameraPose
        One per frame.
    times : list of float
        s since the start, for what moves in the world.
    rolled : bool
        True for synthetic data: all frames are the first one with the robot's body in it, shifted by the turn.
    """

    camera: PanoramaCamera
    poses: list[CameraPose]
    times: list[float]
    rolled: bool = False

    def key(self) -> bytes:
        """What the frames depend on, beside the world and the code that renders."""
        return repr((self.camera, self.poses, self.times, self.rolled)).encode()

    def start(self, make_world: Callable[[], World]) -> Callable[[int], Frame]:
        """Build the world; return the function that renders frame number i."""
        world = make_world()
        if self.rolled:
            return self._roll(world)

        def render(index: int) -> Frame:
            return quantise(self.camera.render(world, self.poses[index], self.times[index]))

        return render

    def _roll(self, world: World) -> Callable[[int], Frame]:
        body, cover = robot_body("deck", self.camera.width, self.camera.height)
        first = self.camera.render(world, self.poses[0], self.times[0]) * (1.0 - cover) + body * cover

        def render(index: int) -> Frame:
            turn = self.poses[index].yaw - self.poses[0].yaw
            return quantise(roll(first, turn / (2.0 * np.pi) * self.camera.width))

        return render


def roll(image: npt.NDArray[np.float32], columns: float) -> npt.NDArray[np.float32]:
    """Shift a panorama to the right by any number of columns, by the theorem of Fourier's shift."""
    width = image.shape[1]
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(width) * columns)
    return np.fft.irfft(np.fft.rfft(image, axis=1) * phase, width, axis=1).astype(np.float32)


def quantise(image: npt.NDArray[np.float32]) -> Frame:
    """Round to 8 bit."""
    return np.asarray(np.clip(np.rint(image), 0, 255).astype(np.uint8))
