"""Small bags as people report them: a robot that turns to and fro on the spot, one thing about it wrong.

Seven seconds: a turn to the left, a longer one to the right. A situation changes messages on their way into the bag:
each of its functions takes a message and gives one, several or none back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from panoramas import PHOTOS, scene, shifted
from tiny_bags import START_NS, TinyBag

SECONDS = 7.0
LEGS = ((1.0, 2.5, 0.8), (3.5, 6.2, -1.0))  # s, s, rad/s
RAMP = 0.3  # s that a leg takes to begin, and to end
GYRO_BIAS, GYRO_NOISE, FORCE_NOISE = 0.004, 0.002, 0.05  # rad/s, rad/s, m/s^2
TRACK_SCALE = 1.3  # claimed over true turn
WIDTH = 256
UNKNOWN = -1.0  # first number of a covariance: not measured
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Imu:
    """An IMU message; `rate` rad/s, `force` m/s^2, `orientation` x, y, z, w."""

    t_ns: int
    rate: Vector
    force: Vector
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    orientation_known: bool = False
    rate_known: bool = True
    force_known: bool = True

    @property
    def t(self) -> float:
        return (self.t_ns - START_NS) * 1e-9

    @property
    def turn_rate(self) -> float:
        return self.rate[2]


@dataclass(frozen=True)
class Tracks:
    """An odometry message; rad, rad/s."""

    t_ns: int
    yaw: float
    rate: float

    @property
    def t(self) -> float:
        return (self.t_ns - START_NS) * 1e-9


@dataclass(frozen=True)
class Picture:
    """A panorama; `raw_stamp` (sec, nanosec) takes the place of the stamp where it is no time at all."""

    t_ns: int
    pixels: np.ndarray
    raw_stamp: tuple[int, int] | None = None

    @property
    def t(self) -> float:
        return (self.t_ns - START_NS) * 1e-9


Message = Imu | Tracks | Picture


def turn_rate(t: Any) -> Any:
    """rad/s at these times, s."""
    t = np.asarray(t, float)
    return sum(w * np.clip((t - a) / RAMP, 0, 1) * np.clip((b - t) / RAMP, 0, 1) for a, b, w in LEGS)


_GRID = np.arange(-1.0, SECONDS + 1.0, 1e-3)
_YAW = np.concatenate([[0.0], np.cumsum(0.5 * (turn_rate(_GRID[1:]) + turn_rate(_GRID[:-1])) * 1e-3)])
TURNED_DEG = math.degrees(float(_YAW[-1]))  # -82.5


def yaw(t: Any) -> Any:
    """rad at these times, s."""
    return np.interp(t, _GRID, _YAW)


@lru_cache(maxsize=1)
def _place() -> np.ndarray:
    """A photograph of the shared ones, or a drawn panorama where they are absent; 2:1."""
    size = WIDTH, WIDTH // 2
    if (PHOTOS / "lobby.jpg").is_file():
        grey = cv2.imread(str(PHOTOS / "lobby.jpg"), cv2.IMREAD_GRAYSCALE)
        return cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return scene(5, *size)


def panorama(heading: float, rng: np.random.Generator) -> np.ndarray:
    """What the camera sees when the robot has turned left by this, rad; with noise of 2 grey values."""
    image = shifted(_place(), heading * WIDTH / math.tau)
    return np.clip(np.rint(image + rng.normal(0.0, 2.0, image.shape)), 0, 255).astype(np.uint8)


@lru_cache(maxsize=2)
def messages(*, image_hz: float = 8.0, gyro_hz: float = 50.0, seed: int = 3) -> tuple[Message, ...]:
    """All of the drive, by stamp, with nothing wrong."""
    return tuple(_drawn(image_hz, gyro_hz, seed))


def _drawn(image_hz: float, gyro_hz: float, seed: int) -> Iterator[Message]:
    rng = np.random.default_rng(seed)
    events = [(k / hertz, kind) for kind, hertz in (("imu", gyro_hz), ("tracks", 20.0), ("picture", image_hz))
              for k in range(int(SECONDS * hertz) + 1)]  # fmt: skip
    for t, kind in sorted(events):
        t_ns = START_NS + round(t * 1e9)
        if kind == "imu":
            x, y, z = FORCE_NOISE * rng.normal(size=3)
            yield Imu(t_ns, (0.0, 0.0, float(turn_rate(t)) + GYRO_BIAS + GYRO_NOISE * rng.normal()), (x, y, 9.81 + z))
        elif kind == "tracks":
            yield Tracks(t_ns, TRACK_SCALE * float(yaw(t)), TRACK_SCALE * float(turn_rate(t)))
        else:
            pixels = panorama(float(yaw(t)), rng)
            pixels.flags.writeable = False  # shared by all who ask
            yield Picture(t_ns, pixels)


def changed(found: Iterable[Message], change: Callable[[Message], Any]) -> Iterator[Message]:
    """Each message as the situation makes it."""
    for message in found:
        made = change(message)
        yield from made if isinstance(made, list) else [made] if made is not None else []


def write(path: Path, found: Iterable[Message], storage: str = "mcap") -> Path:
    """The bag, recorded in this order."""
    with TinyBag(path, storage=storage) as bag:
        for message in found:
            if isinstance(message, Imu):
                _write_imu(bag, message)
            elif isinstance(message, Tracks):
                bag.odometry("/odom", message.t_ns, message.yaw, message.rate)
            else:
                _write_picture(bag, message)
    return path


def _covariance(known: bool) -> np.ndarray:
    return np.array([0.0 if known else UNKNOWN] + [0.0] * 8)


def _write_imu(bag: TinyBag, imu: Imu) -> None:
    bag.write(
        "/imu/data",
        bag.make(
            "sensor_msgs/msg/Imu",
            header=bag.header(imu.t_ns),
            orientation=bag.quaternion(*imu.orientation),
            orientation_covariance=_covariance(imu.orientation_known),
            angular_velocity=bag.vector(*imu.rate),
            angular_velocity_covariance=_covariance(imu.rate_known),
            linear_acceleration=bag.vector(*imu.force),
            linear_acceleration_covariance=_covariance(imu.force_known),
        ),
    )


def _write_picture(bag: TinyBag, picture: Picture) -> None:
    header = bag.header(picture.t_ns)
    if picture.raw_stamp is not None:
        sec, nanosec = picture.raw_stamp
        header = replace(header, stamp=bag.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec))
    data = cv2.imencode(".jpg", picture.pixels, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].reshape(-1)
    bag.write("/pano/compressed", bag.make("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=data))
