"""The fused yaw of simple, exactly known motions."""

import math
from itertools import pairwise

import numpy as np
import pytest

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion

SENSORS = ("gyro", "tracks", "compass")
SUBSETS = [tuple(s for i, s in enumerate(SENSORS) if mask >> i & 1) for mask in range(1, 8)]
STARTS = [math.radians(d) for d in (0.0, 60.0, 180.0, -120.0)] + [math.pi - 1e-9, -math.pi + 1e-9]


def turning(rate, seconds, sensors=SENSORS, bias=0.0, scale=1.0):
    """Exact samples of a constant turn rate, in the order of their stamps."""
    samples = []
    if "gyro" in sensors:
        samples += [GyroSample(i * 10_000_000, rate + bias) for i in range(round(100 * seconds) + 1)]
    if "tracks" in sensors:
        samples += [OdometrySample(i * 20_000_000, scale * rate, 0.3) for i in range(round(50 * seconds) + 1)]
    if "compass" in sensors:
        step = float(wrap_angle(rate * 0.1))
        stamps = [i * 100_000_000 for i in range(round(10 * seconds) + 1)]
        samples += [YawIncrement(a, b, step, 1e-6, 0.9) for a, b in pairwise(stamps)]
    return sorted(samples, key=lambda sample: sample.t_ns)


def fused(samples, config=None):
    fusion = YawFusion(config)
    for sample in samples:
        fusion.add(sample)
    return fusion.estimate()


@pytest.mark.parametrize("sensors", SUBSETS, ids="+".join)
@pytest.mark.parametrize("start", STARTS)
def test_yaw_of_constant_turn_from_any_start(sensors, start):
    estimate = fused(turning(0.5, 20.0, sensors), FusionConfig(initial_yaw=start))
    # exact samples: what remains is the first sample's doubt whether the rate is rate, bias or scale
    assert abs(estimate.yaw - start - 10.0) < 4.0 * math.sqrt(estimate.yaw_variance)
    if "compass" in sensors:
        assert abs(estimate.yaw - start - 10.0) < 1e-3  # ten increments a second of 1e-3 rad noise each, noise-free
    assert -math.pi <= estimate.heading < math.pi
    assert math.isclose(math.cos(estimate.heading), math.cos(estimate.yaw), abs_tol=1e-9)


def test_estimate_before_first_sample_is_none():
    assert YawFusion().estimate() is None


def test_bias_and_scale_are_learned_with_compass():
    estimate = fused(turning(0.5, 60.0, bias=0.01, scale=0.9))
    assert abs(estimate.gyro_bias - 0.01) < 3.0 * math.sqrt(estimate.gyro_bias_variance) < 0.003
    assert abs(estimate.track_scale - 0.9) < 3.0 * math.sqrt(estimate.track_scale_variance) < 0.1


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (GyroSample(1, math.nan), "gyro: not finite"),
        (GyroSample(1, 0.0, variance=0.0), "gyro: variance not positive"),
        (GyroSample(-1, 0.0), "gyro: negative stamp"),
        (OdometrySample(1, 0.0, math.inf), "tracks: not finite"),
        (YawIncrement(0, 1, 0.1, -1.0, 0.5), "compass: variance not positive"),
        (YawIncrement(1, 1, 0.1, 1.0, 0.5), "compass: reference not before the image"),
    ],
)
def test_unusable_sample_is_refused_and_counted(sample, reason):
    fusion = YawFusion()
    assert not fusion.add(sample)
    assert fusion.counts == {reason: 1}
    assert fusion.estimate() is None


def test_foreign_object_raises_type_error():
    with pytest.raises(TypeError, match="ndarray is not a sample"):
        YawFusion().add(np.zeros(3))
