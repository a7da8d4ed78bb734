"""Compass and fusion as one object, on images."""

import math

import numpy as np
import pytest

from compass import CompassStatus
from fusion import FusionConfig, GyroSample, OdometrySample, Sensor, YawPipeline

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
    pipeline = YawPipeline()
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
    monkeypatch.setattr(pipeline.leans, "at", asked.append)
    pipeline.add_image(10 * FRAME_NS, panorama(0.0))
    assert asked == [10 * FRAME_NS - round(1e9 * delay)]
