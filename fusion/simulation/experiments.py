"""The experiments by name: the paper's, section 4, and eight beyond it."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from fusion.simulation import places, yards
from fusion.simulation.effects import NO_EFFECTS, Effects
from fusion.simulation.experiment import FIRST_FRAME, Experiment, SimulationError
from fusion.simulation.robot import CONCRETE, DIRT
from fusion.simulation.trajectory import Ground, Leg, Trajectory, curve, spin, stand, straight

_LEVEL = Ground()


def _drive(
    *legs: Leg, start: tuple[float, float, float] = (0.0, 0.0, 0.0), ground: Ground = _LEVEL, sunk: float = 0.0
) -> Trajectory:
    """A drive by hand on tracks, with a second of standing before and after.

    The driver steers by 0.6 deg; tracks that grip and let go turn unevenly, and drift 3 cm in a turn on the spot.
    """
    way = (stand(1.0), *legs, stand(1.0))
    return Trajectory(way, start, wobble=float(np.deg2rad(0.6)), unsteady=0.15, wander=0.03, ground=ground, sunk=sunk)


def _columns(count: int, per_frame: int) -> Leg:
    """Turn by columns of 1024: an even number per frame at 10 Hz, so that each picture is shifted by whole ones."""
    return Leg(abs(count) / per_frame / 10.0, 0.0, float(np.copysign(per_frame * 10.0 * 2.0 * np.pi / 1024.0, count)))


_DEMO = (
    *(spin(360, 0.8), stand(0.5), straight(3.0, 0.5), curve(90, 1.2, 0.45), straight(0.8, 0.45), stand(2.0)),
    *(curve(180, 0.8, 0.4), straight(1.5, 0.5), curve(-120, 0.7, 0.4), straight(0.6, 0.4), spin(-150, 0.8)),
)
_SHIFTS = (stand(1.05 + FIRST_FRAME), _columns(-120, 6), _columns(84, 14), stand(0.5), _columns(-220, 4), stand(1.0))
_THERE_AND_BACK = (straight(8.0, 0.45), spin(180, 0.6), straight(8.0, 0.45), spin(180, 0.6))
_U_TURNS = 2 * (straight(8.0, 0.45), curve(180, 0.15, 0.1))
_SQUARE = 4 * (straight(5.0, 0.45), spin(90, 0.6))
_SLALOM = (curve(60, 1.2, 0.4), *2 * (curve(-120, 1.2, 0.4), curve(120, 1.2, 0.4)), spin(180, 0.7))
_BUMPS = (
    *(straight(2.0, 0.4), curve(90, 1.2, 0.4), straight(1.5, 0.4), curve(-150, 1.1, 0.4)),
    *(stand(1.0), spin(200, 0.7), straight(3.0, 0.45)),
)
_LOBBY = (stand(2.0), spin(360, 0.6), stand(2.0), straight(3.0, 0.4), spin(-180, 0.6), straight(3.0, 0.4))
_CORRIDOR = (straight(5.0, 0.5), spin(180, 0.9), straight(3.0, 0.5), spin(-360, 0.9))
_OVAL = (*2 * (straight(2.0, 0.5), curve(180, 0.9, 0.45)), spin(-90, 0.6))
_RESTS = (
    *(leg for a in (20, -40, 30, -10, 90, 25) for leg in (straight(0.9, 0.45), stand(1.8), spin(a, 0.7), stand(1.2))),
    straight(0.8, 0.4),
)

_TABLE = (
    Experiment(
        name="demo",
        summary="half a minute in a furnished room: a turn, along a wall, bends, a stop",
        place=places.laboratory,
        trajectory=_drive(*_DEMO, start=(-1.0, -1.45, 0.0)),
        mixed=True,
    ),
    Experiment(
        name="shifted",
        summary="4.1: one picture shifted by whole columns, robot's body and all, without noise; -90 deg in all",
        place=places.laboratory,
        trajectory=Trajectory(_SHIFTS, ramp=0.1),
        published_deg=0.0,
        effects=NO_EFFECTS,
        stamps=None,
        rolled=True,
    ),
    Experiment(
        name="spin3_indoor",
        summary="4.2: three turns on the spot in a full room, a door frame 5 m ahead as the mark",
        place=places.close_room,
        trajectory=_drive(spin(1080, 0.6)),
        published_deg=11.11,
    ),
    Experiment(
        name="spin3_wall_outdoor",
        summary="4.2: three very slow turns on concrete panels, 1.2 m from a wall",
        place=yards.long_wall,
        trajectory=_drive(spin(1080, 0.3), start=(6.0, 1.0, 0.0)),
        published_deg=-2.16,
        surface=CONCRETE,
    ),
    Experiment(
        name="spin5_yard",
        summary="4.2: five turns at full speed in a school yard, nearest thing 2 m away",
        place=yards.school_yard,
        trajectory=_drive(spin(1800, 1.0)),
        published_deg=-0.86,
        surface=CONCRETE,
        frame_hz=12.0,
    ),
    Experiment(
        name="forward6_passage",
        summary="4.3: 6 m straight ahead through a passage 1.3 m wide",
        place=places.passage,
        trajectory=_drive(straight(6.0, 0.4), start=(1.0, 0.05, 0.0)),
        published_deg=-6.59,
    ),
    Experiment(
        name="forward7_outdoor",
        summary="4.3: 7 m along the joints of concrete panels, the last 2 beside a wall",
        place=yards.long_wall,
        trajectory=_drive(straight(7.0, 0.45), start=(34.0, 0.6, np.pi)),
        published_deg=-4.93,
        surface=CONCRETE,
    ),
    Experiment(
        name="forward25_outdoor",
        summary="4.3: 25 m along the joints of concrete panels, the last 5 beside a wall",
        place=yards.long_wall,
        trajectory=_drive(straight(25.0, 0.6), start=(-20.0, 0.2, 0.0)),
        published_deg=17.72,
        surface=CONCRETE,
    ),
    Experiment(
        name="free_race_passage",
        summary="4.4: 16 m, twice through the passage, keeping to the right, half a turn to the left at each end",
        place=places.passage,
        trajectory=_drive(*_U_TURNS, start=(0.0, -0.15, 0.0)),
        mixed=True,
        published_deg=30.7,  # as printed; the 330.7 deg it measured are 29.3 short of a full turn
    ),
    Experiment(
        name="free_race_outdoor",
        summary="4.4: the same way in an open yard",
        place=yards.school_yard,
        trajectory=_drive(*_THERE_AND_BACK, start=(-4.0, -5.5, 0.0)),
        mixed=True,
        published_deg=0.58,
        surface=CONCRETE,
    ),
    Experiment(
        name="square20",
        summary="4.4: a square of 5 m sides past goods in a store",
        place=places.hall,
        trajectory=_drive(*_SQUARE),
        mixed=True,
        published_deg=8.3,
    ),
    Experiment(
        name="weave",
        summary="in and out between pillars, the camera off the turning centre, a mast and an arm in view",
        place=places.pillars,
        trajectory=_drive(*_SLALOM, start=(0.0, -0.6, 0.0)),
        mixed=True,
        effects=Effects(body="mast"),
        mount=(0.25, 0.08, 0.65),
    ),
    Experiment(
        name="rough_ground",
        summary="bends over bumps between trees: roll and pitch of up to 6 deg",
        place=yards.rough_field,
        trajectory=_drive(*_BUMPS, start=(-1.5, 0.6, 0.0), ground=Ground(height=0.02, seed=3)),
        mixed=True,
        surface=DIRT,
        effects=Effects(exposure=0.06),
    ),
    Experiment(
        name="sunken_floor",
        summary="the demo's drive in a room that has sunk by 20 deg at one side",
        place=places.laboratory,
        trajectory=_drive(*_DEMO, start=(-1.0, -1.45, 0.0), sunk=float(np.deg2rad(20.0))),
        mixed=True,
    ),
    Experiment(
        name="crowd",
        summary="a turn and a drive in a lobby where eight people walk about, two of them round the robot",
        place=places.crowded_lobby,
        trajectory=_drive(*_LOBBY),
        mixed=True,
    ),
    Experiment(
        name="symmetric_corridor",
        summary="a corridor that looks the same ahead and behind, and every 2.5 m",
        place=places.symmetric_corridor,
        trajectory=_drive(*_CORRIDOR, start=(-2.0, 0.1, 0.0)),
        mixed=True,
    ),
    Experiment(
        name="dark_gap",
        summary="an oval in a room where the light fails for 3 s amid a bend",
        place=places.laboratory,
        trajectory=_drive(*_OVAL, start=(0.5, -0.9, 0.0)),
        mixed=True,
        effects=Effects(dark=(7.5, 10.5)),
    ),
    Experiment(
        name="stop_and_go",
        summary="short drives and turns in a store with rests between them",
        place=places.hall,
        trajectory=_drive(*_RESTS, start=(0.2, -0.1, 0.0)),
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
