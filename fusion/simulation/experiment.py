"""What makes an experiment: a place, a drive through it, and the sensors' tempers."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from compass.errors import VisualCompassError
from fusion.simulation import robot
from fusion.simulation.effects import Effects
from fusion.simulation.imu import ImuModel
from fusion.simulation.stamps import StampModel
from fusion.simulation.trajectory import Trajectory
from fusion.simulation.world import World

_CAMERA = Effects()
_MTI = ImuModel()
_DRIVER = StampModel()

FIRST_FRAME = 0.05  # s from the start of the drive to the first frame


class SimulationError(VisualCompassError, ValueError):
    """A simulation cannot be done as asked."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A drive in a place, and what is known of it.

    Attributes
    ----------
    name, summary : str
        What it is called, and one line on what is special about it.
    place : callable
        Builds the world with a random generator.
    trajectory : Trajectory
        The true way.
    mixed : bool
        Whether it drives as well as turns.
    published_deg : float or None
        Error of the total angle that the paper reports, deg; None where it has no such experiment.
    surface : Surface
        How the tracks grip.
    effects : Effects
        What the camera does to the picture.
    imu : ImuModel
        The inertial unit.
    stamps : StampModel or None
        How the camera's driver stamps images; None: with the very moment of exposure.
    mount : tuple of float
        Camera on the robot: x, y, z in m from the turning centre on the ground.
    frame_hz : float
        Frames per second.
    rolled : bool
        Synthetic data: one picture, shifted.
    """

    name: str
    summary: str
    place: Callable[[np.random.Generator], World]
    trajectory: Trajectory
    mixed: bool = False
    published_deg: float | None = None
    surface: robot.Surface = robot.FLOOR
    effects: Effects = _CAMERA
    imu: ImuModel = _MTI
    stamps: StampModel | None = _DRIVER
    mount: tuple[float, float, float] = (0.06, 0.0, 0.65)
    frame_hz: float = 10.0
    rolled: bool = False

    def world(self, variant: int = 0) -> World:
        """Its place, the `variant`-th of its kind: same layout, other textures and things on the walls."""
        return self.place(np.random.default_rng([zlib.crc32(self.name.encode()), variant]))

    def frame_times(self) -> npt.NDArray[np.float64]:
        """When frames are exposed, s since the start; not quite evenly, except in synthetic data."""
        count = int((self.trajectory.duration - FIRST_FRAME) * self.frame_hz)
        jitter = np.random.default_rng(zlib.crc32(self.name.encode())).normal(0.0, 1e-3, count)
        jitter = np.zeros(count) if self.rolled else np.clip(jitter, -4e-3, 4e-3)
        return np.rint((FIRST_FRAME + np.arange(count) / self.frame_hz + jitter) * 1e9) / 1e9

    @property
    def distance(self) -> float:
        """Length of the way, m."""
        return float(sum(abs(leg.speed) * leg.duration for leg in self.trajectory.legs))

    @property
    def turns(self) -> float:
        """Turning done, left and right alike, in full turns."""
        return float(sum(abs(leg.yaw_rate) * leg.duration for leg in self.trajectory.legs) / (2.0 * np.pi))
