"""Compass and fusion as one object, on images."""

import math

import numpy as np
import pytest

from compass import CompassStatus, YawIncrement
from fusion import FusionConfig, GyroSample, OdometrySample, Sensor, YawFusion, YawPipeline

FRAME_NS = 100_000_000


def panorama(yaw, width=512, height=128):
    """A smooth random scene, seen by a robot turned left by `yaw` rad: the scene has moved right."""
    rng = np.random.default_rng(7)
    waves = rng.normal(size=(height // 8, 60)) + 1j * rng.normal(size=(height // 8, 60))
    k = np.arange(1, 61)
    azimuth = 2.0 * np.pi * np.arange(width) / width
    rows = (waves[:, :, None] * np.exp(1j * k[:, None] * (azimuth - yaw))).sum(axis=1).real
    rows = 128.0 + 40.0 * rows / rows.std()
    return np.repeat(np.clip(rows, 0, 255).astype(np.uint8), 8, axis=0)


@pytest.mark.parametrize("degrees", [0.0, 60.0, 180.0, -120.0])
def test_images_alone_give_the_turn(degrees):
    pipeline = YawPipeline()
    for i in range(31):
        pipeline.add_image(i * FRAME_NS, panorama(math.radians(degrees + 4.0 * i)))
    estimate = pipeline.estimate()
    assert estimate.t_ns == 30 * FRAME_NS
    assert math.degrees(estimate.yaw) == pytest.approx(120.0, abs=0.1)  # counted from the start, pixels are 0.7 deg


def test_increments_are_returned_and_fused_with_the_rest():
    # at a constant rate a scale that is off would pass for a bias
    pipeline = YawPipeline(fusion_config=FusionConfig(gyro_scale_sigma=0.001, initial_bias_sigma=0.01))
    assert pipeline.add_image(0, panorama(0.0)) is None
    assert pipeline.compass.status is CompassStatus.FIRST_FRAME
    for i in range(1, 21):
        for j in range(10):
            pipeline.add(GyroSample((i - 1) * FRAME_NS + j * FRAME_NS // 10, 0.5 + 0.01))
        pipeline.add(OdometrySample((i - 1) * FRAME_NS, 0.6, 0.0, 0.06 * i))
        assert pipeline.add_image(i * FRAME_NS, panorama(0.05 * i)) is not None
    estimate = pipeline.estimate()
    assert estimate.yaw == pytest.approx(1.0, abs=0.003)
    assert estimate.gyro_bias == pytest.approx(0.01, abs=0.003)
    assert {sensor for sensor, report in pipeline.fusion.reports().items() if report} == set(Sensor)


def test_reset_starts_compass_and_fusion_anew():
    pipeline = YawPipeline()
    for i in range(5):
        pipeline.add_image(i * FRAME_NS, panorama(0.1 * i))
    pipeline.reset()
    assert pipeline.estimate() is None
    assert pipeline.compass.status is CompassStatus.NOT_STARTED
    pipeline.add_image(0, panorama(0.0))
    pipeline.add_image(FRAME_NS, panorama(0.1))
    assert pipeline.estimate().yaw == pytest.approx(0.1, abs=0.002)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_compass_asks_how_the_robot_leant_at_the_exposure_as_far_as_the_delay_is_given(delay, monkeypatch):
    pipeline, asked = YawPipeline(fusion_config=FusionConfig(camera_delay=delay)), []
    monkeypatch.setattr(pipeline.tilts, "at", asked.append)
    pipeline.add_image(10 * FRAME_NS, panorama(0.0))
    assert asked == [10 * FRAME_NS - round(1e9 * delay)]


def turning_gyro(fusion, seconds, rate=0.5):
    """A gyro at 100 Hz from t = 1 s on; returns the stamp of the last sample, ns."""
    stamps = range(1_000_000_000, 1_000_000_000 + round(seconds * 1e9) + 1, 10_000_000)
    for t_ns in stamps:
        fusion.add(GyroSample(t_ns, rate))
    return stamps[-1]


def test_estimate_predicted_goes_on_turning_and_knows_less_with_time():
    fusion = YawFusion()
    last_ns = turning_gyro(fusion, 2.0)
    now, times = fusion.estimate(), (0.005, 0.05, 0.3, 1.0, 3.0, 10.0, 1000.0)
    predicted = [fusion.estimate(last_ns + round(1e9 * s)) for s in times]
    assert [one.t_ns for one in predicted] == [last_ns + round(1e9 * s) for s in times]
    assert predicted[1].yaw == pytest.approx(now.yaw + 0.05 * now.yaw_rate, abs=1e-6)
    variances = [one.yaw_variance for one in (now, *predicted)]
    assert variances == sorted(set(variances))
    # a robot nobody watches may stop, or turn at initial_rate_sigma: after 3 s neither is a surprise
    assert abs(predicted[4].yaw - now.yaw) < 3.0 * math.sqrt(predicted[4].yaw_variance)
    assert math.sqrt(predicted[4].yaw_variance) > 1.0  # rad, a third of the 3 s at 1 rad/s
    assert fusion.estimate() == now  # a look ahead, not a step


def test_estimate_predicted_to_the_past_is_the_newest_one():
    fusion = YawFusion()
    assert fusion.estimate(5) is None
    last_ns = turning_gyro(fusion, 1.0)
    assert fusion.estimate(last_ns - 1) == fusion.estimate(last_ns) == fusion.estimate()


def test_estimate_predicted_does_not_trust_a_standstill_that_nobody_sees():
    fusion = YawFusion()
    for t_ns in range(1_000_000_000, 4_000_000_000, 10_000_000):
        fusion.add(GyroSample(t_ns, 0.003))
        if t_ns % 50_000_000 == 0:
            fusion.add(OdometrySample(t_ns, 0.0, 0.0, 0.0))
            fusion.add(YawIncrement(1_000_000_000 - 1, t_ns, 0.0, 1e-8, 0.9))
    assert fusion.estimate().standstill
    soon, late = (fusion.estimate(fusion.estimate().t_ns + round(1e9 * s)) for s in (0.1, 2.0))
    assert soon.standstill
    # a start of up to `rate_walk`, 1 rad/s after 1 s: sqrt(0.1^3 / 3) rad, less what the ramp of 0.02 s takes off
    assert 0.01 < math.sqrt(soon.yaw_variance) < 0.018
    assert not late.standstill
    assert math.sqrt(late.yaw_variance) > 0.5  # rad: 2 s at up to 1 rad/s that began at some time
