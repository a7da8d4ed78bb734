"""An inertial unit of the Xsens MTi class: gyro, accelerometer and attitude filter without a magnetometer.

Figures of the MTi 100 series' data sheet (Movella, MTi-300, May 2023): gyro noise 0.01 deg/s/sqrt(Hz), bias
stability in run 10 deg/h, accelerometer noise 60 ug/sqrt(Hz), roll and pitch good to 0.2 deg. The bias left after
switching on is a few tenths of a degree per second, as the maker tells for units in use. A tracked robot shakes its
sensors while it drives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fusion.simulation.robot import wander
from fusion.simulation.trajectory import Motion, Trajectory

Floats = npt.NDArray[np.float64]

IMU_HZ = 100.0
GRAVITY = 9.80665


@dataclass(frozen=True, slots=True)
class ImuModel:
    """Errors of the unit; deviations, angles in rad.

    Attributes
    ----------
    gyro_noise : float
        Density, rad/s/sqrt(Hz).
    gyro_bias : float
        After switching on, rad/s.
    gyro_bias_walk : float
        Random walk of the bias, rad/s/sqrt(s); 10 deg/h are walked in 90 s.
    gyro_scale : float
        Scale factor's error, relative.
    vibration_gyro, vibration_accelerometer : float
        Added noise while the robot moves, rad/s and m/s^2.
    accelerometer_noise : float
        Density, m/s^2/sqrt(Hz).
    attitude : float
        Roll and pitch of the attitude filter, rad.
    yaw_residual : float
        Share of the gyro's bias that the attitude filter does not remove from its yaw.
    """

    gyro_noise: float = float(np.deg2rad(0.01))
    gyro_bias: float = float(np.deg2rad(0.2))
    gyro_bias_walk: float = float(np.deg2rad(3e-4))
    gyro_scale: float = 5e-4
    vibration_gyro: float = float(np.deg2rad(0.1))
    vibration_accelerometer: float = 0.25
    accelerometer_noise: float = 60e-6 * GRAVITY
    attitude: float = float(np.deg2rad(0.2))
    yaw_residual: float = 0.2


@dataclass(frozen=True, slots=True)
class ImuReading:
    """One message of the unit, mounted level at the robot's base.

    Attributes
    ----------
    t_ns : int
        Stamp, ns.
    angular_velocity : tuple of float
        About x, y, z of the unit, rad/s.
    linear_acceleration : tuple of float
        Specific force along x, y, z of the unit, m/s^2; +9.8 along z at rest.
    orientation : tuple of float
        Quaternion x, y, z, w; its yaw starts at 0 and drifts.
    """

    t_ns: int
    angular_velocity: tuple[float, float, float]
    linear_acceleration: tuple[float, float, float]
    orientation: tuple[float, float, float, float]


def read_imu(trajectory: Trajectory, model: ImuModel, rng: np.random.Generator, start_ns: int) -> list[ImuReading]:
    """The unit's messages of one drive; `start_ns` is the stamp of the trajectory's time 0."""
    t = np.arange(0.0, trajectory.duration, 1.0 / IMU_HZ)
    motion = trajectory.at(t)
    moving = np.clip(np.abs(motion.speed) / 0.3 + np.abs(motion.yaw_rate) / 0.5, 0.0, 1.0)[:, None]
    bias = model.gyro_bias * rng.standard_normal(3)
    walk = model.gyro_bias_walk / np.sqrt(IMU_HZ) * np.cumsum(rng.standard_normal((t.size, 3)), axis=0)
    scale = 1.0 + model.gyro_scale * rng.standard_normal(3)
    gyro_noise = np.hypot(model.gyro_noise * np.sqrt(IMU_HZ), model.vibration_gyro * moving)
    gyro = true_rates(motion, trajectory) * scale + bias + walk + gyro_noise * rng.standard_normal((t.size, 3))
    force_noise = np.hypot(model.accelerometer_noise * np.sqrt(IMU_HZ), model.vibration_accelerometer * moving)
    force = _specific_force(motion, trajectory) + force_noise * rng.standard_normal((t.size, 3))
    attitude = _attitude(motion, model, bias[2] + walk[:, 2], rng)
    stamps = start_ns + np.round(t * 1e9).astype(np.int64)
    rows = zip(stamps.tolist(), gyro.tolist(), force.tolist(), attitude.tolist(), strict=True)
    return [ImuReading(stamp, tuple(w), tuple(a), tuple(q)) for stamp, w, a, q in rows]


def true_rates(motion: Motion, trajectory: Trajectory) -> Floats:
    """Turn rates about the body's axes, shape (n, 3), rad/s."""
    half = 0.5e-3
    before, after = trajectory.at(motion.t - half), trajectory.at(motion.t + half)
    roll_rate, pitch_rate = (after.roll - before.roll) / (2 * half), (after.pitch - before.pitch) / (2 * half)
    sin_roll, cos_roll = np.sin(motion.roll), np.cos(motion.roll)
    level = motion.yaw_rate * np.cos(motion.pitch)
    x = roll_rate - motion.yaw_rate * np.sin(motion.pitch)
    return np.stack([x, pitch_rate * cos_roll + level * sin_roll, level * cos_roll - pitch_rate * sin_roll], axis=1)


def _rotation(yaw: Floats, pitch: Floats, roll: Floats) -> Rotation:
    rotation: Rotation = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))
    return rotation


def _specific_force(motion: Motion, trajectory: Trajectory) -> Floats:
    """Acceleration minus gravity in the body's frame, shape (n, 3), m/s^2."""
    half = 5e-3
    before, after = trajectory.at(motion.t - half), trajectory.at(motion.t + half)
    columns = ((getattr(after, k) - 2 * getattr(motion, k) + getattr(before, k)) / half**2 for k in "xyz")
    world = np.stack(list(columns), axis=1) + np.array([0.0, 0.0, GRAVITY])
    return np.asarray(_rotation(motion.yaw, motion.pitch, motion.roll).inv().apply(world), np.float64)


def _attitude(motion: Motion, model: ImuModel, bias: Floats, rng: np.random.Generator) -> Floats:
    """Quaternions of the attitude filter: roll and pitch held by gravity, yaw adrift."""
    error = [model.attitude * wander(rng, motion.t.size, 1.0 / IMU_HZ, 5.0) for _ in range(2)]
    yaw = motion.yaw - motion.yaw[0] + model.yaw_residual * np.cumsum(bias) / IMU_HZ
    held = _rotation(yaw, motion.pitch + error[0], motion.roll + error[1])
    return np.asarray(held.as_quat(), np.float64)
