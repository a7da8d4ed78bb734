"""The experiments by name: the paper's, section 4, and more."""

from __future__ import annotations

import difflib
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from compass.errors import VisualCompassError
from fusion.simulation import places, robot
from fusion.simulation.effects import Effects
from fusion.simulation.imu import ImuModel
from fusion.simulation.trajectory import Leg, Trajectory, curve, spin, stand, straight
from fusion.simulation.world import World

_CAMERA = Effects()
_MTI = ImuModel()


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
    mount: tuple[float, float, float] = (0.06, 0.0, 0.65)
    frame_hz: float = 10.0
    rolled: bool = False

    def world(self, variant: int = 0) -> World:
        """Its place, the `variant`-th of its kind: same layout, other textures and things on the walls."""
        return self.place(np.random.default_rng([zlib.crc32(self.name.encode()), variant]))

    @property
    def distance(self) -> float:
        """Length of the way, m."""
        return float(sum(abs(leg.speed) * leg.duration for leg in self.trajectory.legs))

    @property
    def turns(self) -> float:
        """Turning done, left and right alike, in full turns."""
        return float(sum(abs(leg.yaw_rate) * leg.duration for leg in self.trajectory.legs) / (2.0 * np.pi))


def _from_rest(*legs: Leg) -> Sequence[Leg]:
    """The legs with a second of standing before and after."""
    return (stand(1.0), *legs, stand(1.0))


_TABLE = (
    Experiment(
        name="demo",
        summary="half a minute in a furnished room: a turn, along a wall, bends, a stop",
        place=places.laboratory,
        trajectory=Trajectory(
            _from_rest(
                spin(360, 0.8),
                stand(0.5),
                straight(3.0, 0.5),
                curve(90, 1.2, 0.45),
                straight(0.8, 0.45),
                stand(2.0),
                curve(180, 0.8, 0.4),
                straight(1.5, 0.5),
                curve(-120, 0.7, 0.4),
                straight(0.6, 0.4),
                spin(-150, 0.8),
            ),
            start=(-1.0, -1.45, 0.0),
            wobble=np.deg2rad(0.6),
            wander=0.03,
        ),
        mixed=True,
    ),
)

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({experiment.name: experiment for experiment in _TABLE})


def find_experiment(name: str) -> Experiment:
    """The experiment called `name`; `SimulationError` names the nearest if there is none."""
    if name in EXPERIMENTS:
        return EXPERIMENTS[name]
    near = difflib.get_close_matches(name, EXPERIMENTS, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"one of: {', '.join(EXPERIMENTS)}"
    raise SimulationError(f"no experiment {name!r}; {hint}")
