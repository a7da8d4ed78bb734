"""Gyro and compass that turn by different factors: the yaw's sigma holds the difference, and a warning names both."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, Eyes, sensed

from compass import YawIncrement
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion, YawPipeline
from fusion.checks.scale_conflict import WRONG, compass_errs


@pytest.mark.parametrize(("gyro", "compass"), [(1.0, 1.0), (1.0, 1.05), (1.0, 0.95), (1.05, 1.0)])
def test_yaw_owns_up_to_a_conflict_of_scales(gyro, compass):
    rate = np.convolve(np.repeat([0.2, -0.15, 0.25, 0.1], 8 * HZ), np.hanning(HZ) / np.hanning(HZ).sum(), "same")
    eyes = Eyes(hold=5.0, noise=2e-4, lasts=8e-5, time=6.0, claims_all=False)
    drive = sensed(np.random.default_rng(3), rate, np.full(rate.size, 0.8), hertz=(50, 20, 5), eyes=eyes)
    pipeline, over, widest = YawPipeline(), [], 0.0
    for sample in drive.samples:
        if isinstance(sample, GyroSample):
            sample = replace(sample, yaw_rate=gyro * sample.yaw_rate)
        elif isinstance(sample, YawIncrement):
            sample = replace(sample, yaw=compass * sample.yaw)
        pipeline.add(sample)
        estimate = pipeline.estimate()
        if estimate is not None and estimate.t_ns > 1_000_000_000:
            error = estimate.yaw - float(np.interp(estimate.t_ns * 1e-9, drive.t, drive.yaw))
            sigma = math.sqrt(estimate.yaw_variance)
            if estimate.warnings:  # it takes some turns to learn the difference
                over.append(abs(error) / max(sigma, math.radians(0.02)) > 4.0)
            widest = max(widest, sigma)
    named = {warning.sensor for warning in pipeline.warnings() if warning.code == "sensors_disagree_scale"}
    assert not any(over)
    if gyro == compass:
        assert not named
        assert widest < math.radians(1.0)
    else:
        assert named == {"compass+gyro"}


@pytest.mark.parametrize("compass", [0.98, 1.02])
@pytest.mark.parametrize("who", [(YawIncrement, GyroSample), (YawIncrement, GyroSample, OdometrySample)])
def test_factor_that_may_be_the_gyros_may_be_the_images_as_well(who, compass):
    rate = np.convolve(np.repeat([0.0, 0.2, -0.15, 0.25, 0.1], 6 * HZ), np.hanning(HZ) / np.hanning(HZ).sum(), "same")
    eyes = Eyes(hold=5.0, noise=2e-4, lasts=8e-5, time=6.0, claims_all=False)
    drive = sensed(np.random.default_rng(3), rate, 0.8 * (rate != 0.0), hertz=(50, 20, 5), eyes=eyes)
    drive = drive.changed(lambda s: replace(s, yaw=compass * s.yaw), YawIncrement)
    fusion = YawFusion()
    for sample in drive.samples:
        if isinstance(sample, who):
            fusion.add(sample)
    estimate = fusion.estimate()
    # 4.4 sigma by Bayes' rule, 5.7 where 1.85 % of it is learnt; without it dozens
    assert abs(drive.error(estimate)) < 6.0 * math.sqrt(estimate.yaw_variance)
    assert not fusion.warnings()


def test_probability_that_the_images_err_grows_with_the_difference():
    sigma = FusionConfig.gyro_scale_sigma
    found = [compass_errs(scale * sigma, sigma) for scale in (0.0, 1.0, 2.0, 3.0)]
    assert found[0] < WRONG < found[-1]
    assert found == sorted(found)
    assert compass_errs(-sigma, sigma) == found[1]
    assert compass_errs(0.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("who", "part"), [((YawIncrement,), 0.5), ((YawIncrement, GyroSample), FusionConfig.gyro_scale_sigma)]
)
def test_images_that_are_no_full_circle_leave_the_yaw_unknown_by_a_factor_or_as_the_gyro_knows_it(who, part):
    rate = np.convolve(np.repeat([0.2, 0.15, 0.25, 0.1], 4 * HZ), np.hanning(HZ) / np.hanning(HZ).sum(), "same")
    eyes = Eyes(hold=5.0, noise=2e-4, lasts=8e-5, time=6.0, claims_all=False)
    drive = sensed(np.random.default_rng(3), rate, np.full(rate.size, 0.8), hertz=(50, 20, 5), eyes=eyes)
    pipeline = YawPipeline()
    for sample in drive.samples:
        if isinstance(sample, who):
            says_so = isinstance(sample, YawIncrement) and sample.t_ns > 2_000_000_000
            pipeline.add(replace(sample, factor_sigma=0.5) if says_so else sample)
    estimate = pipeline.estimate()
    assert math.sqrt(estimate.yaw_variance) == pytest.approx(part * estimate.yaw, rel=0.05)
