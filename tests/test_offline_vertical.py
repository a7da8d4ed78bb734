"""The gyro's vertical: any mount, tilted and rolling, with and without orientation."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.imu.levelling import ImuConfig, ImuLevel

RATE_HZ = 100
MOUNTS = {
    "upright": Rotation.identity(),
    "upside_down": Rotation.from_euler("x", 180, degrees=True),
    "y_up": Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "askew": Rotation.from_euler("zyx", [0, 35, -50], degrees=True),
}


def wobbling_drive(mount: Rotation, turns: float = 2.0, start_deg: float = 0.0, seconds: float = 60.0):
    """A robot that turns while it rolls and pitches, seen by an IMU; analytic angles, rates by exact differences."""
    t = np.arange(int(seconds * RATE_HZ) + 1) / RATE_HZ
    yaw = math.radians(start_deg) + 2 * math.pi * turns * t / seconds
    roll, pitch = 0.15 * np.sin(2 * math.pi * 0.9 * t), 0.12 * np.sin(2 * math.pi * 0.9 * t + math.pi / 2)
    body = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    imu = body * mount
    omega = (imu[:-1].inv() * imu[1:]).as_rotvec() * RATE_HZ
    middle = imu[:-1] * Rotation.from_rotvec(0.5 * omega / RATE_HZ)
    force = middle.inv().apply([0.0, 0.0, 9.81])
    times = ((t[:-1] + 0.5 / RATE_HZ) * 1e9).astype(np.int64)
    return times.tolist(), omega, force, middle.as_quat(), yaw[-1] - yaw[0]


@pytest.mark.parametrize("start_deg", [0.0, 60.0, 180.0, -120.0])
@pytest.mark.parametrize("mount", MOUNTS)
def test_level_orientation_known_turn_is_exact_in_any_mount(mount, start_deg):
    """Coning of 0.15 x 0.12 rad at 0.9 Hz would add pi*0.15*0.12*54 = 3 rad to a plain projection."""
    times, omega, force, orientation, turned = wobbling_drive(MOUNTS[mount], start_deg=start_deg)
    level = ImuLevel(ImuConfig(forward={"y_up": "+x"}.get(mount, "auto")))
    rates = [level.sample(*reading).yaw_rate for reading in zip(times, omega, force, orientation, strict=True)]
    # The mid-point rule errs by the third derivative: (2 pi 0.9 / RATE)^2 / 24 = 1.3e-4 of a swing; ends cancel.
    assert sum(rates) / RATE_HZ == pytest.approx(turned, abs=1e-3)
    assert level.source == "orientation"


@pytest.mark.parametrize("mount", MOUNTS)
def test_level_gravity_alone_finds_the_vertical(mount):
    times, omega, force, _, turned = wobbling_drive(MOUNTS[mount])
    level = ImuLevel()
    rates = [level.sample(*reading).yaw_rate for reading in zip(times, omega, force, strict=True)]
    # Followed with first-order steps, u lags by at most half a step of 0.85 rad/s: 0.005 rad of tilt error, whose
    # product with the rolling of the same frequency integrates to 0.5 * 0.005 * 0.85 rad/s * 60 s = 0.12 rad.
    assert sum(rates) / RATE_HZ == pytest.approx(turned, abs=0.12)
    assert level.source == "gravity"


def test_level_bias_of_the_gyro_does_not_tilt_gravity_for_good():
    """Of 1 deg/s across the vertical, which would hold it 11 deg off: bias times `gravity_time`."""
    times, omega, force, _, _ = wobbling_drive(MOUNTS["upright"])
    level, still = ImuLevel(), ImuLevel()
    for t_ns, rate, pull in zip(times, omega, force, strict=True):
        level.sample(t_ns, rate + np.array([0.014, -0.014, 0.01]), pull)
        still.sample(t_ns, rate, pull)
    assert math.degrees(math.acos(np.dot(level.up, still.up))) < 2.0


def test_level_orientation_in_another_frame_is_not_believed():
    """A driver with z down (NED) contradicts gravity: sign and axis must come from gravity."""
    times, omega, force, orientation, turned = wobbling_drive(MOUNTS["upright"])
    ned = (Rotation.from_euler("x", 180, degrees=True) * Rotation.from_quat(orientation)).as_quat()
    level = ImuLevel()
    rates = [level.sample(*reading).yaw_rate for reading in zip(times, omega, force, ned, strict=True)]
    assert sum(rates) / RATE_HZ == pytest.approx(turned, abs=0.12)
    assert level.source == "gravity"


def test_level_nothing_known_takes_z():
    assert ImuLevel().sample(0, (0.1, 0.2, 0.3)).yaw_rate == pytest.approx(0.3)
    assert ImuLevel().sample(0, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)).yaw_rate == pytest.approx(0.3)


@pytest.mark.parametrize(("axis", "expected"), [("+x", 0.1), ("-x", -0.1), ("+y", 0.2), ("-z", -0.3)])
def test_level_fixed_axis_is_taken_as_given(axis, expected):
    sample = ImuLevel(ImuConfig(up=axis)).sample(5, (0.1, 0.2, 0.3), (0.0, 0.0, 9.81), (0.0, 0.0, 0.0, 1.0))
    assert sample.yaw_rate == pytest.approx(expected)


def test_level_not_finite_rate_is_passed_on_and_does_no_harm():
    level = ImuLevel()
    assert not math.isfinite(level.sample(0, (math.nan, 0.0, 0.0), (0.0, 0.0, 9.81)).yaw_rate)
    level.sample(10, (0.0, 0.0, 0.1), (math.nan, 0.0, 9.81), (math.nan, 0.0, 0.0, 1.0))
    assert level.sample(20, (0.0, 0.0, 0.1), (0.0, 0.0, 9.81)).yaw_rate == pytest.approx(0.1)


def test_level_silence_does_not_spin_the_vertical():
    """After ten silent seconds the last rate says nothing of the turn meanwhile: gravity decides."""
    level = ImuLevel()
    level.sample(0, (2.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    level.sample(10_000_000_000, (2.0, 0.0, 0.0), (0.0, 9.81, 0.0))
    assert level.up == pytest.approx((0.0, 1.0, 0.0))
