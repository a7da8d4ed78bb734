"""An odometry that is fused with the gyro is no third sensor: it errs as the gyro does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import ratios_at_images, robot_drive

from compass import wrap_angle
from fusion import GyroSample, OdometrySample, YawFusion

NAMED = ("odometry_not_independent", "tracks")


def fused_with_gyro(drive, weight=1.0):
    """The drive with an odometry whose turns are the gyro's, the share of 1 - `weight` of its own."""
    samples, yaw, gyro, own = [], 0.0, None, None
    for sample in drive.samples:
        if isinstance(sample, OdometrySample) and gyro is not None:
            turn = 0.0 if own is None else sample.yaw - own
            yaw += gyro.yaw_rate * (sample.t_ns - gyro.t_ns) * 1e-9 + (1.0 - weight) * turn
            gyro, own = replace(gyro, t_ns=sample.t_ns), sample.yaw
            sample = replace(sample, yaw_rate=gyro.yaw_rate, yaw=float(wrap_angle(yaw)))
        elif isinstance(sample, GyroSample):
            rate = sample.yaw_rate if gyro is None else 0.5 * (gyro.yaw_rate + sample.yaw_rate)
            yaw += weight * rate * ((sample.t_ns - gyro.t_ns) * 1e-9 if gyro else 0.0)
            gyro = sample
        samples.append(sample)
    return replace(drive, samples=samples)


def wheels(seed, slip):
    """Wheels of the right scale that slip by so much of what they turn in a second, and tick by 1.25 mrad."""
    rng, yaw, own = np.random.default_rng(seed), 0.0, 0.0
    drive = robot_drive(seed, seconds=30.0, bias=0.003)

    def exact(sample):
        nonlocal yaw, own
        at = float(np.interp(sample.t_ns * 1e-9, drive.t, drive.yaw))
        yaw, own = at, own + (at - yaw) * (1.0 + slip * math.sqrt(20.0) * rng.normal())
        return replace(sample, yaw=round(own / 1.25e-3) * 1.25e-3)

    return drive.changed(exact, OdometrySample)


def error_over_sigma(fusion, drive):
    estimate = fusion.estimate()
    return abs(drive.error(estimate)) / math.sqrt(estimate.yaw_variance)


@pytest.mark.parametrize("step", [0.02, 0.1, -0.3])
def test_fused_odometry_does_not_outvote_the_images_when_the_gyro_steps(step):
    drive = robot_drive(3, seconds=30.0)
    stepped = drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + step), GyroSample, 14.0)
    fusion = YawFusion()
    ratios, told = ratios_at_images(fusion, fused_with_gyro(stepped))
    assert ratios.max() < 4.0
    assert NAMED in told
    assert error_over_sigma(fusion, drive) < 3.0


@pytest.mark.parametrize("rate", [lambda w: -w, lambda w: 0.0, lambda w: 1.1 * w], ids=["sign", "zero", "scale"])
def test_fused_odometry_does_not_confirm_a_gyro_that_is_wrong_from_the_start(rate):
    more = []
    for seed in (4, 7):
        drive = robot_drive(seed, seconds=20.0)
        wrong = drive.changed(lambda s: replace(s, yaw_rate=rate(s.yaw_rate)), GyroSample)
        alone, _ = ratios_at_images(YawFusion(), wrong.changed(lambda s: None, OdometrySample))
        fusion = YawFusion()
        ratios, _ = ratios_at_images(fusion, fused_with_gyro(wrong))
        more.append((ratios > 4.0).mean() - (alone > 4.0).mean())
        assert error_over_sigma(fusion, drive) < 3.0
    assert sum(more) / len(more) < 0.02  # as without it, but for the first images that show it


@pytest.mark.parametrize("weight", [1.0, 0.99])
def test_bias_of_a_gyro_beside_its_own_odometry_is_not_believed_to_be_none(weight):
    drive = robot_drive(5, seconds=30.0, bias=0.006)
    both = fused_with_gyro(drive, weight)
    fusion = YawFusion()
    for sample in both.samples:
        if isinstance(sample, GyroSample | OdometrySample):
            fusion.add(sample)
    assert NAMED in {(one.code, one.sensor) for one in fusion.warnings()}
    assert error_over_sigma(fusion, drive) < 3.0


@pytest.mark.parametrize("slip", [0.003, 0.01])
@pytest.mark.parametrize("seed", range(3))
def test_good_wheels_of_the_right_scale_are_a_sensor_of_their_own(seed, slip):
    _, told = ratios_at_images(YawFusion(), wheels(seed, slip))
    assert told == set()


def test_robot_that_stands_is_told_nothing():
    drive = robot_drive(1, seconds=2.0)
    still = [replace(s, t_ns=s.t_ns + k * 2 * 10**9) for k in range(8) for s in drive.samples]
    still = [s for s in still if isinstance(s, GyroSample | OdometrySample)]
    fusion = YawFusion()
    for sample in still:
        fusion.add(sample)
    assert fusion.warnings() == []


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("bias", [0.0, 0.01])
def test_simulation_without_noise_is_told_nothing(noise, bias):
    """Exact odometry is as near to an exact gyro as one that has it inside; its turn rate steps, or swings."""
    rng, rates = np.random.default_rng(0), (0.0, 0.5, -0.3, 0.8)
    for rate in (lambda t: 0.5 * math.sin(t), lambda t: rates[int(t // 3) % 4]):
        fusion, yaw, told = YawFusion(), 0.0, set()
        for k in range(1500):
            t = k * 0.01
            fusion.add(GyroSample(1 + k * 10**7, rate(t) + bias + noise * rng.normal()))
            if k % 5 == 0:
                fusion.add(OdometrySample(1 + k * 10**7, rate(t), 0.3, float(wrap_angle(yaw))))
                told |= {one.code for one in fusion.warnings()}
            yaw += 0.5 * (rate(t) + rate(t + 0.01)) * 0.01
        assert "odometry_not_independent" not in told
