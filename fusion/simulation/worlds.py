"""Which world a drive is driven in: its experiment's own place, or one that no constant was chosen on."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fusion.simulation.experiment import Experiment, SimulationError
from fusion.simulation.held_out import HELD_OUT, Floats
from fusion.simulation.world import Crowd, Solid, World, nobody

TUNED_WORLDS, HELD_OUT_WORLDS = "tuned", "held-out"
WORLDS = 3  # of each experiment's own place
SEEDS_PER_WORLD = 7


@dataclass(frozen=True, slots=True)
class WorldChoice:
    """A world that can be built.

    Attributes
    ----------
    name : str
        Of the place, or of the variant of the experiment's own.
    held_out : bool
        Whether no constant may be chosen on it.
    key : bytes
        All that the world depends on beside the code and the drive.
    build : callable
        Makes it; takes a second or more.
    """

    name: str
    held_out: bool
    key: bytes
    build: Callable[[], World]


def choose_world(experiment: Experiment, seed: int, worlds: str = TUNED_WORLDS) -> WorldChoice:
    """The world in which an experiment is driven with `seed`.

    Parameters
    ----------
    worlds : str
        ``"tuned"``: the experiment's own place in one of three variants; ``"held-out"``: one of the `HELD_OUT` places;
        or the name of one of them. A held-out place is drawn anew for every seed.

    Raises
    ------
    SimulationError
        There are no such worlds.
    """
    if worlds == TUNED_WORLDS:
        variant = seed // SEEDS_PER_WORLD % WORLDS
        key = f"{experiment.place.__name__} {variant}".encode()
        return WorldChoice(str(variant), False, key, lambda: experiment.world(variant))
    place = worlds
    if worlds == HELD_OUT_WORLDS:
        places = sorted(HELD_OUT)
        place = places[(zlib.crc32(experiment.name.encode()) + seed) % len(places)]
    if place not in HELD_OUT:
        known = ", ".join([TUNED_WORLDS, HELD_OUT_WORLDS, *HELD_OUT])
        raise SimulationError(f"no worlds {worlds!r}; one of: {known}")
    key = f"{place} round {experiment.name}, {seed}".encode()
    return WorldChoice(place, True, key, lambda: held_out(experiment, place, seed))


def held_out(experiment: Experiment, place: str, seed: int = 0) -> World:
    """A held-out place built round an experiment's way, with the people whom the experiment has walking about.

    The seed draws what the kind of place leaves open: where things stand, how large they are, what they look like.
    """
    crowd = experiment.world().crowd
    rng = np.random.default_rng([seed, zlib.crc32(place.encode()), zlib.crc32(experiment.name.encode())])
    world = HELD_OUT[place](rng, _way(experiment, crowd))
    return world if crowd is nobody else replace(world, crowd=_both(crowd, world.crowd))


def _way(experiment: Experiment, crowd: Crowd) -> Floats:
    """Where the robot and the people go, m, to 5 cm; shape (n, 2)."""
    times = np.arange(0.0, experiment.trajectory.duration, 0.1)
    motion = experiment.trajectory.in_place.at(times)
    points = [np.stack([motion.x, motion.y], axis=1)]
    for t in times.tolist():
        corners = [np.add(solid.low[:2], solid.high[:2]) / 2.0 for solid in crowd(t)]
        points += [np.array(corners)] if corners else []
    return np.asarray(np.unique(np.round(np.concatenate(points) / 0.05), axis=0) * 0.05, np.float64)


def _both(first: Crowd, second: Crowd) -> Crowd:
    def at(t: float) -> tuple[Solid, ...]:
        return first(t) + second(t)

    return at
