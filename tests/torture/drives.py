"""The three drives that every fault is tried on, without a fault; samples come as (time of arrival, ns; sample)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from robot_drive import HZ, Eyes, RobotDrive, robot_drive, sensed

from fusion import GyroSample, OdometrySample, Sensor
from fusion.buffer.events import Sample

SECONDS = 40.0
Stream = list[tuple[int, Sample]]
WHO = {"G": Sensor.GYRO, "T": Sensor.TRACKS, "C": Sensor.COMPASS}
DRIVES = ("stop and go", "long legs", "slow camera")
STANDS = 2.0  # s at either end
LIFTED = 2.0  # s that it takes to lift and turn the robot


def smooth(values: np.ndarray) -> np.ndarray:
    """Values each 1 ms, as a robot of some mass can follow them."""
    window = np.hanning(400) / np.hanning(400).sum()
    return np.convolve(values, window, "same")


def _legs(rng: np.random.Generator, seconds: tuple[float, float], fastest: float) -> tuple[np.ndarray, np.ndarray]:
    """Turn rate and speed each 1 ms: legs of so many seconds, straight and turning in turn, without a stop."""
    n = round(HZ * SECONDS)
    rate, speed, i, straight = np.zeros(n), np.zeros(n), round(STANDS * HZ), False
    end = n - round(STANDS * HZ)
    while i < end:
        stop = min(i + int(rng.uniform(*seconds) * HZ), end)
        if not straight:
            rate[i:stop] = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0) * fastest
        speed[i:stop], i, straight = 0.5, stop, not straight
    return smooth(rate), smooth(speed)


def _turned_by(angle: float, since: float) -> np.ndarray:
    """Turn rate of a robot that is lifted and turned, each 1 ms."""
    rate, pulse = np.zeros(round(HZ * SECONDS)), np.hanning(round(LIFTED * HZ))
    start = round(since * HZ)
    rate[start : start + pulse.size] = angle * HZ * pulse / pulse.sum()
    return rate


@lru_cache(maxsize=8)
def drive(name: str, seed: int, lifted_at: float | None = None) -> RobotDrive:
    """One of `DRIVES`, not one sample at fault; `lifted_at`: when it is lifted and turned left by 90 deg, s."""
    unseen = 0.0 if lifted_at is None else _turned_by(math.pi / 2.0, lifted_at)
    rng = np.random.default_rng(seed)
    # these compasses err by what `FusionConfig` claims
    lasts = {"lasts": 8e-5, "time": 6.0, "claims_all": False}
    if name == "stop and go":
        still, eyes = robot_drive(seed, seconds=SECONDS, eyes=Eyes(noise=5e-4, **lasts)), Eyes(noise=5e-4, **lasts)
        if lifted_at is None:
            return still
        rate = np.append(np.diff(still.yaw), 0.0) * HZ
        return sensed(rng, rate, 0.5 * (rate != 0.0), eyes=eyes, unseen=unseen)
    if name == "long legs":
        rate, speed = _legs(rng, (6.0, 11.0), 0.6)
        eyes, hertz, gyro_noise = Eyes(hold=10.0, noise=2e-4, **lasts), (200, 50, 30), 0.0025
    else:
        rate, speed = _legs(rng, (2.0, 6.0), 0.8)
        eyes, hertz, gyro_noise = Eyes(hold=4.0, noise=1e-3, **lasts), (50, 20, 2), 0.0025
    return sensed(
        rng, rate, speed, bias=-0.006, scale=1.2, hertz=hertz, eyes=eyes, unseen=unseen, gyro_noise=gyro_noise
    )


def stream_of(ride: RobotDrive, who: str = "GTC") -> Stream:
    """Samples of some sensors, each of which arrives at its stamp."""
    return [(s.t_ns, s) for s in ride.samples if sensor_letter(s) in who]


def sensor_letter(sample: Sample) -> str:
    """G, T or C."""
    return "G" if isinstance(sample, GyroSample) else "T" if isinstance(sample, OdometrySample) else "C"
