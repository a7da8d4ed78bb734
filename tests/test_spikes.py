"""Samples of gyro and tracks that stand out from their neighbours."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import GyroSample, OdometrySample, Sensor, YawFusion
from fusion.checks.spikes import SpikeWatch

HERTZ = 100


def gyro(rate, noise=0.002, seconds=8.0, seed=1):
    """Samples of a gyro; `rate` rad/s at a time, s."""
    rng = np.random.default_rng(seed)
    times = np.arange(int(seconds * HERTZ)) / HERTZ
    return [GyroSample(round(t * 1e9), float(rate(t) + noise * rng.normal())) for t in times]


def with_spikes(samples, at, size):
    """Some of the samples off by `size` rad/s."""
    return [replace(s, yaw_rate=s.yaw_rate + size) if k in at else s for k, s in enumerate(samples)]


def told(samples, sensor=Sensor.GYRO, **options):
    watch = SpikeWatch(**{"by_poses": True, **options})
    for sample in samples:
        watch.hear(sensor, sample)
    return watch.warnings()


def swaying(t):
    """A robot that turns to and fro as fast as one can."""
    return 2.0 * np.sin(6.0 * t)


@pytest.mark.parametrize("size", [2.0, -20.0])
@pytest.mark.parametrize("at", [(300, 400, 500), (200, 300, 301, 302, 600)])
def test_samples_that_stand_out_are_told(size, at):
    (warning,) = told(with_spikes(gyro(swaying), at, size))
    assert (warning.code, warning.sensor, warning.since_ns) == ("sensor_spikes", "gyro", at[0] * 10_000_000)
    assert f"{len(at)} samples within 10 s stand out by up to {abs(size):g}" in warning.text


@pytest.mark.parametrize(
    "samples",
    [
        gyro(swaying),
        gyro(swaying, noise=0.3),  # no good gyro, but its numbers are what it has
        with_spikes(gyro(swaying), (300, 600), 5.0),  # now and then
        with_spikes(gyro(lambda t: 0.0), range(300, 600), 5.0),  # and it stays there
        gyro(lambda t: 3.0 if t % 1.0 > 0.5 else 0.0),  # starts and stops at once
    ],
    ids=["sway", "noise", "two", "a step", "starts and stops"],
)
def test_what_robots_do_is_no_spike(samples):
    assert not told(samples)


@pytest.mark.parametrize("seed", range(8))
def test_noise_from_the_first_sample_on_is_no_spike(seed):
    """Poses of 10 deg noise: from one to the next that is more than a robot can change by."""
    rng = np.random.default_rng(seed)
    assert not told([OdometrySample(k * 50_000_000, 0.0, 0.0, 0.2 * rng.normal()) for k in range(100)], Sensor.TRACKS)


def test_spikes_of_long_ago_are_forgotten():
    samples = with_spikes(gyro(swaying, seconds=20.0), (300, 400, 500), 5.0)
    assert told(samples[:1200])
    assert not told(samples)


@pytest.mark.parametrize("by_poses", [True, False])
def test_poses_that_stand_out_are_told_where_poses_count(by_poses):
    poses = [OdometrySample(k * 50_000_000, 0.5, 0.0, yaw=0.025 * k) for k in range(100)]
    at = (30, 50, 70)
    turned = [replace(s, yaw=s.yaw + 1.0) if k in at else s for k, s in enumerate(poses)]
    spun = [replace(s, yaw_rate=9.0) if k in at else s for k, s in enumerate(poses)]
    assert not told(poses, Sensor.TRACKS, by_poses=by_poses)
    assert bool(told(turned, Sensor.TRACKS, by_poses=by_poses)) is by_poses
    assert bool(told(spun, Sensor.TRACKS, by_poses=by_poses)) is not by_poses


def test_late_samples_are_no_spikes():
    samples = gyro(swaying)
    mixed = [*samples[:300], *(s for k in range(300, 700, 2) for s in (samples[k + 1], samples[k])), *samples[700:]]
    assert not told(mixed)


def test_fusion_tells_of_them():
    fusion = YawFusion()
    for sample in with_spikes(gyro(swaying), (300, 400, 500), 5.0):
        fusion.add(sample)
    assert "sensor_spikes" in [warning.code for warning in fusion.warnings()]
    fusion.reset()
    assert not fusion.warnings()
