"""What the tracks claim: a skid-steered robot turns less than its tracks say, and sometimes they slip.

The tracks' difference is read as ``claimed rate = (right - left) / nominal width``; dragged sideways, a tracked robot
turns as if it were wider (effective width, Mandow et al. 2007, doi:10.1109/IROS.2007.4399139), so the claim is
``scale * true rate`` with a scale above one that depends on the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter  # type: ignore[attr-defined]

from fusion.simulation.trajectory import Trajectory

Floats = npt.NDArray[np.float64]

TRACK_WIDTH = 0.40  # m, nominal
ODOMETRY_HZ = 40.0
_TICK = 5e-4  # m of track per encoder count
_FINE = 10  # steps of integration per reading


@dataclass(frozen=True, slots=True)
class Surface:
    """How tracks grip a ground.

    Attributes
    ----------
    scale : float
        Claimed over true turn rate, mean over drives.
    scale_spread : float
        Deviation of it from drive to drive.
    unsteady : float
        Deviation of each track's grip while driving, relative, correlated over half a second.
    slips : float
        Slip events of one track per second of driving.
    """

    scale: float
    scale_spread: float = 0.03
    unsteady: float = 0.015
    slips: float = 0.02


FLOOR = Surface(scale=1.35)
CONCRETE = Surface(scale=1.45, unsteady=0.02)
DIRT = Surface(scale=1.2, scale_spread=0.05, unsteady=0.04, slips=0.06)


@dataclass(frozen=True, slots=True)
class OdometryReading:
    """One message of the track odometry.

    Attributes
    ----------
    t_ns : int
        Stamp, ns.
    x, y, yaw : float
        Integrated pose since the start, m and rad (unwrapped), in the odometry frame.
    speed, yaw_rate : float
        Mean since the reading before, along +x of the base, m/s; positive to the left, rad/s.
    """

    t_ns: int
    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float


def wander(rng: np.random.Generator, count: int, dt: float, correlation: float) -> Floats:
    """First-order Gauss-Markov noise of unit deviation, `count` samples of `dt` s, correlated over `correlation` s."""
    keep = np.exp(-dt / correlation)
    drive = rng.standard_normal(count) * np.sqrt(1.0 - keep**2)
    drive[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], drive), np.float64)


def read_tracks(
    trajectory: Trajectory, surface: Surface, rng: np.random.Generator, start_ns: int
) -> list[OdometryReading]:
    """The odometry of one drive; `start_ns` is the stamp of the trajectory's time 0."""
    step = 1.0 / (ODOMETRY_HZ * _FINE)
    t = np.arange(0.0, trajectory.duration, step)
    motion = trajectory.in_place.at(t)
    scale = surface.scale + surface.scale_spread * rng.standard_normal()
    turning = motion.yaw_rate * scale * TRACK_WIDTH / 2.0
    mismatch = 0.003 * rng.standard_normal()  # one track a little longer than the other
    distances = []
    for side, ratio in ((-1.0, 1.0 - mismatch), (1.0, 1.0 + mismatch)):
        grip = 1.0 + surface.unsteady * wander(rng, t.size, step, 0.5) + _slip(t, surface, rng)
        travelled = np.cumsum((motion.speed + side * turning) * ratio * grip) * step
        distances.append(np.round(travelled[::_FINE] / _TICK) * _TICK)
    return _integrate(t[::_FINE], distances[0], distances[1], start_ns)


def _slip(t: Floats, surface: Surface, rng: np.random.Generator) -> Floats:
    """Extra speed of a track, relative: now and then it spins for up to 1.5 s."""
    extra = np.zeros_like(t)
    for _ in range(rng.poisson(surface.slips * t[-1])):
        begin, duration, strength = rng.uniform(0.0, t[-1]), rng.uniform(0.4, 1.5), rng.uniform(0.15, 0.8)
        inside = np.clip((t - begin) / duration, 0.0, 1.0)
        extra += strength * np.sin(np.pi * inside) ** 2
    return extra


def _integrate(t: Floats, left: Floats, right: Floats, start_ns: int) -> list[OdometryReading]:
    """Dead reckoning from the tracks' counted distances, as a robot's driver does it."""
    ahead, turn = np.diff((left + right) / 2.0), np.diff((right - left) / TRACK_WIDTH)
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    middle = yaw[:-1] + turn / 2.0
    x = np.concatenate([[0.0], np.cumsum(ahead * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(ahead * np.sin(middle))])
    speed, rate = np.append(0.0, ahead * ODOMETRY_HZ), np.append(0.0, turn * ODOMETRY_HZ)
    stamps = start_ns + np.round(t * 1e9).astype(np.int64)
    rows = zip(stamps.tolist(), x.tolist(), y.tolist(), yaw.tolist(), speed.tolist(), rate.tolist(), strict=True)
    return [OdometryReading(*row) for row in rows]
