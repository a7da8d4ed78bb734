"""Kalibr's ``imu.yaml``: noises of an IMU, as its tools read and write them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from compass.errors import ConfigError
from compass.files import read_bounded
from fusion.bounded_yaml import YamlError, parse_yaml

LARGEST = 100_000  # bytes
KALIBR_HEAD = "# Continuous-time noises of an IMU, for Kalibr; by visual-compass allan"  # how ours begin
KEYS = ("gyroscope_noise_density", "gyroscope_random_walk", "update_rate")


@dataclass(frozen=True, slots=True)
class KalibrImu:
    """Continuous-time noises.

    Attributes
    ----------
    gyroscope_noise_density, gyroscope_random_walk : float
        rad/s/sqrt(Hz) and rad/s^2/sqrt(Hz).
    update_rate : float
        Hz.
    rostopic : str
        Topic; empty where none is given.
    accelerometer_noise_density, accelerometer_random_walk : float or None
        m/s^2/sqrt(Hz) and m/s^3/sqrt(Hz).
    bounds : mapping of str to float
        Of what was not seen and is zero here: what it is at most. Kalibr takes no zero.
    """

    gyroscope_noise_density: float
    gyroscope_random_walk: float
    update_rate: float
    rostopic: str = ""
    accelerometer_noise_density: float | None = None
    accelerometer_random_walk: float | None = None
    bounds: Mapping[str, float] = field(default_factory=dict)

    def as_yaml(self) -> str:
        """As Kalibr reads it."""
        lines = [KALIBR_HEAD]
        for name in list(self.__dataclass_fields__)[:-1]:
            bound = self.bounds.get(name)
            value = getattr(self, name) if bound is None else bound
            if value not in (None, ""):
                line = yaml.safe_dump({name: value if isinstance(value, str) else float(f"{value:.4g}")}).strip()
                lines.append(line if bound is None else f"{line}  # not seen: at most this")
        return "\n".join(lines) + "\n"


def read_kalibr(path: Path) -> KalibrImu:
    """What a file says of the gyro.

    Raises
    ------
    ConfigError
        It cannot be read, or lacks a number.
    """
    text = read_bounded(path, LARGEST, "give Kalibr's imu.yaml").decode("utf-8", "replace")
    try:
        content = parse_yaml(text)
    except YamlError as error:
        raise ConfigError(f"{path}: {error}; give Kalibr's imu.yaml") from None
    if not isinstance(content, dict) or not set(KEYS) <= content.keys():
        raise ConfigError(f"{path}: {', '.join(KEYS)} are wanted, as in Kalibr's imu.yaml")
    density, walk, rate = (_positive(path, key, content[key], zero=key == KEYS[1]) for key in KEYS)
    return KalibrImu(density, walk, rate, str(content.get("rostopic") or ""))


def _positive(path: Path, key: str, value: object, *, zero: bool) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]  # YAML reads 1e-3 as text
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and (number > 0.0 or (zero and number == 0.0))):
        raise ConfigError(f"{path}: {key}: {str(value)[:60]!r} is no positive number")
    return number
