"""The experiments by name: the paper's, section 4, and more."""

from __future__ import annotations

import difflib
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from compass.errors import VisualCompassError
from fusion.simulation import places, robot, yards
from fusion.simulation.effects import NO_EFFECTS, Effects
from fusion.simulation.imu import ImuModel
from fusion.simulation.trajectory import Ground, Leg, Trajectory, curve, spin, stand, straight
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


_SWAY = float(np.deg2rad(0.6))  # of a driver who follows a line
_SPIN_WANDER = 0.03  # m a turn: tracks do not turn on a point
_RESTS = [
    leg for a in (20, -40, 30, -10, 90, 25) for leg in (straight(0.9, 0.45), stand(1.8), spin(a, 0.7), stand(1.2))
]
_SLALOM = (curve(60, 1.2, 0.4), *4 * (curve(-120, 1.2, 0.4), curve(120, 1.2, 0.4)))[:5]

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
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
    ),
    Experiment(
        name="shifted",
        summary="4.1: one picture shifted by known angles, robot's body and all, no noise; -90 deg in all",
        place=places.laboratory,
        trajectory=Trajectory(_from_rest(spin(-45, 0.5), spin(30, 0.9), stand(0.5), spin(-75, 0.23)), ramp=0.3),
        published_deg=0.0,
        effects=NO_EFFECTS,
        rolled=True,
    ),
    Experiment(
        name="spin3_indoor",
        summary="4.2: three turns on the spot in a full room, a door frame 5 m ahead as the mark",
        place=places.close_room,
        trajectory=Trajectory(_from_rest(spin(1080, 0.6)), wander=_SPIN_WANDER),
        published_deg=11.11,
    ),
    Experiment(
        name="spin3_wall_outdoor",
        summary="4.2: three very slow turns on concrete panels beside a wall",
        place=yards.long_wall,
        trajectory=Trajectory(_from_rest(spin(1080, 0.3)), start=(6.0, 0.2, 0.0), wander=_SPIN_WANDER),
        published_deg=-2.16,
        surface=robot.CONCRETE,
    ),
    Experiment(
        name="spin5_yard",
        summary="4.2: five turns at full speed in a school yard, nearest thing 2 m away",
        place=yards.school_yard,
        trajectory=Trajectory(_from_rest(spin(1800, 1.0)), wander=_SPIN_WANDER),
        published_deg=-0.86,
        surface=robot.CONCRETE,
        frame_hz=12.0,
    ),
    Experiment(
        name="forward6_passage",
        summary="4.3: 6 m straight ahead through a passage 1.3 m wide",
        place=places.passage,
        trajectory=Trajectory(_from_rest(straight(6.0, 0.4)), start=(1.0, 0.05, 0.0), wobble=_SWAY),
        published_deg=-6.59,
    ),
    Experiment(
        name="forward7_outdoor",
        summary="4.3: 7 m along the joints of concrete panels, ending beside a wall",
        place=yards.long_wall,
        trajectory=Trajectory(_from_rest(straight(7.0, 0.45)), start=(32.5, 0.2, np.pi), wobble=_SWAY),
        published_deg=-4.93,
        surface=robot.CONCRETE,
    ),
    Experiment(
        name="forward25_outdoor",
        summary="4.3: 25 m along the joints of concrete panels, ending beside a wall",
        place=yards.long_wall,
        trajectory=Trajectory(_from_rest(straight(25.0, 0.6)), start=(-4.0, 0.2, 0.0), wobble=_SWAY),
        published_deg=17.72,
        surface=robot.CONCRETE,
    ),
    Experiment(
        name="free_race_passage",
        summary="4.4: twice through the passage, half a turn to the left at each end, 16 m",
        place=places.passage,
        trajectory=Trajectory(
            _from_rest(straight(8.0, 0.45), spin(180, 0.6), straight(8.0, 0.45), spin(180, 0.6)),
            start=(0.0, 0.0, 0.0),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
        published_deg=30.7,  # as printed; the 330.7 deg it measured are 29.3 short of a full turn
    ),
    Experiment(
        name="free_race_outdoor",
        summary="4.4: the same way in an open yard",
        place=yards.school_yard,
        trajectory=Trajectory(
            _from_rest(straight(8.0, 0.5), spin(180, 0.6), straight(8.0, 0.5), spin(180, 0.6)),
            start=(-4.0, -5.5, 0.0),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
        published_deg=0.58,
        surface=robot.CONCRETE,
    ),
    Experiment(
        name="square20",
        summary="4.4: a square of 5 m sides past goods in a store",
        place=places.hall,
        trajectory=Trajectory(
            _from_rest(*4 * (straight(5.0, 0.45), spin(90, 0.6))), wobble=_SWAY, wander=_SPIN_WANDER
        ),
        mixed=True,
        published_deg=8.3,
    ),
    Experiment(
        name="weave",
        summary="in and out between pillars, the camera off the turning centre, a mast and an arm in view",
        place=places.pillars,
        trajectory=Trajectory(_from_rest(*_SLALOM, spin(180, 0.7)), start=(0.0, -0.6, 0.0), wander=_SPIN_WANDER),
        mixed=True,
        effects=Effects(body="mast"),
        mount=(0.25, 0.08, 0.65),
    ),
    Experiment(
        name="rough_ground",
        summary="bends over bumps between trees: roll and pitch of several degrees",
        place=yards.rough_field,
        trajectory=Trajectory(
            _from_rest(
                straight(2.0, 0.4),
                curve(90, 1.2, 0.4),
                straight(1.5, 0.4),
                curve(-150, 1.1, 0.4),
                stand(1.0),
                spin(200, 0.7),
                straight(3.0, 0.45),
            ),
            start=(-1.5, 0.6, 0.0),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
            ground=Ground(height=0.02, seed=3),
        ),
        mixed=True,
        surface=robot.DIRT,
        effects=Effects(exposure=0.06),
    ),
    Experiment(
        name="crowd",
        summary="a turn and a drive in a lobby where eight people walk about, two of them round the robot",
        place=places.crowded_lobby,
        trajectory=Trajectory(
            _from_rest(stand(2.0), spin(360, 0.6), stand(2.0), straight(3.0, 0.4), spin(-180, 0.6), straight(3.0, 0.4)),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
    ),
    Experiment(
        name="symmetric_corridor",
        summary="a corridor that looks the same ahead and behind, and every 2.5 m",
        place=places.symmetric_corridor,
        trajectory=Trajectory(
            _from_rest(straight(5.0, 0.5), spin(180, 0.9), straight(3.0, 0.5), spin(-360, 0.9)),
            start=(-2.0, 0.1, 0.0),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
    ),
    Experiment(
        name="dark_gap",
        summary="bends in a room where the light fails for 3 s amid a turn",
        place=places.laboratory,
        trajectory=Trajectory(
            _from_rest(
                straight(2.0, 0.5), curve(180, 0.9, 0.45), straight(2.0, 0.5), curve(180, 0.9, 0.45), spin(-90, 0.6)
            ),
            start=(0.5, -0.9, 0.0),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
        effects=Effects(dark=(8.0, 11.0)),
    ),
    Experiment(
        name="stop_and_go",
        summary="short drives and turns in a store with rests between them",
        place=places.hall,
        trajectory=Trajectory(
            _from_rest(
*_RESTS,
straight(0.8, 0.4),
            ),
            start=(0.2, -0.1, 0.0),
            wobble=_SWAY,
            wander=_SPIN_WANDER,
        ),
        mixed=True,
    ),
)  # fmt: skip

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({experiment.name: experiment for experiment in _TABLE})


def find_experiment(name: str) -> Experiment:
    """The experiment called `name`; `SimulationError` names the nearest if there is none."""
    if name in EXPERIMENTS:
        return EXPERIMENTS[name]
    near = difflib.get_close_matches(name, EXPERIMENTS, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"one of: {', '.join(EXPERIMENTS)}"
    raise SimulationError(f"no experiment {name!r}; {hint}")
