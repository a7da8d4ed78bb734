"""People who walk about."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fusion.simulation import materials
from fusion.simulation.surfaces import Skin
from fusion.simulation.world import Crowd, Solid

Path = Callable[[float], tuple[float, float]]

_PARTS = ((0.17, 0.20, 0.80), (0.21, 0.48, 1.00), (0.10, 0.27, 1.48))  # radius, height, foot of hips, trunk, head; m
_LEG = (0.075, 0.80)  # radius, height
_DENSITY = 120.0


def pacing(start: tuple[float, float], end: tuple[float, float], speed: float, phase: float = 0.0) -> Path:
    """To and fro between two points, m, at `speed` m/s; `phase` in lengths of the way."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))

    def at(t: float) -> tuple[float, float]:
        share = abs((t * speed / length + phase + 1.0) % 2.0 - 1.0)
        share = share * share * (3.0 - 2.0 * share)  # slower at the turns
        return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])

    return at


def circling(centre: tuple[float, float], radius: float, speed: float, phase: float = 0.0) -> Path:
    """Round a point, m, counter-clockwise at `speed` m/s (clockwise if negative); `phase` in rad."""

    def at(t: float) -> tuple[float, float]:
        angle = speed / radius * t + phase
        return centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)

    return at


@dataclass(frozen=True, eq=False)
class Person:
    """Someone of upright rounds: legs that stride, hips, trunk, head."""

    path: Path
    skins: tuple[Skin, ...]
    size: float

    @classmethod
    def dressed(cls, rng: np.random.Generator, path: Path) -> Person:
        """A person with clothes of their own."""
        shapes = [(radius, height) for radius, height, _ in _PARTS] + [_LEG]
        skins = []
        for radius, height in shapes:
            around = 2.0 * np.pi * radius
            skins.append(Skin(materials.cloth(rng, around, height, _DENSITY), around, height))
        return cls(path, tuple(skins), float(rng.uniform(0.92, 1.08)))

    def solids(self, t: float) -> tuple[Solid, ...]:
        """The parts of the body at time `t`, s."""
        x, y = self.path(t)
        ahead, behind = self.path(t + 0.05), self.path(t - 0.05)
        step_x, step_y = ahead[0] - behind[0], ahead[1] - behind[1]
        speed = float(np.hypot(step_x, step_y)) / 0.1
        along = (step_x / (0.1 * speed), step_y / (0.1 * speed)) if speed > 0.05 else (1.0, 0.0)
        stride = 0.22 * min(speed, 1.3) * np.sin(2.0 * np.pi * 0.9 * t + self.size * 40.0)
        parts = [self._round(x, y, *part, skin) for part, skin in zip(_PARTS, self.skins, strict=False)]
        for side in (-1.0, 1.0):
            leg_x = x + side * (stride * along[0] - 0.1 * along[1])
            leg_y = y + side * (stride * along[1] + 0.1 * along[0])
            parts.append(self._round(leg_x, leg_y, *_LEG, 0.0, self.skins[-1]))
        return tuple(parts)

    def _round(self, x: float, y: float, radius: float, height: float, foot: float, skin: Skin) -> Solid:
        low = (x - radius, y - radius, foot * self.size)
        return Solid(low, (x + radius, y + radius, (foot + height) * self.size), skin, round=True)


def crowd(rng: np.random.Generator, paths: Sequence[Path]) -> Crowd:
    """One person on each path."""
    people = [Person.dressed(rng, path) for path in paths]

    def at(t: float) -> tuple[Solid, ...]:
        return tuple(solid for person in people for solid in person.solids(t))

    return at
