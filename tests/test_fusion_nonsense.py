"""Numbers that no robot has, but a driver can send: refused, and without any trace in what follows."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from robot_drive import robot_drive

from compass import YawIncrement
from compass.errors import ArgumentError
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion, YawPipeline
from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.smoother import smooth

STEP_NS = 10_000_000
NONSENSE = {
    "gyro": lambda t_ns: GyroSample(t_ns, 1e300),
    "track rate": lambda t_ns: OdometrySample(t_ns, -1e300, 0.0),
    "track pose": lambda t_ns: OdometrySample(t_ns, 0.1, 0.5, 1e300),
    "gyro variance": lambda t_ns: GyroSample(t_ns, 0.1, 1e300),
    "gyro cross rate": lambda t_ns: GyroSample(t_ns, 0.1, cross_rate=-1e300),
    "increment": lambda t_ns: YawIncrement(t_ns - 10**8, t_ns, 1e300, 1e-6, 0.9),
    "increment variance": lambda t_ns: YawIncrement(t_ns - 10**8, t_ns, 0.01, 1e300, 0.9),
    "increment confidence": lambda t_ns: YawIncrement(t_ns - 10**8, t_ns, 0.01, 1e-6, math.nan),
    "increment factor": lambda t_ns: YawIncrement(t_ns - 10**8, t_ns, 0.01, 1e-6, 0.9, factor_sigma=math.nan),
    "track speed": lambda t_ns: OdometrySample(t_ns, 0.1, 1e300),
}


def fused_yaw(nonsense=None):
    fusion = YawFusion(FusionConfig())
    for k in range(300):
        t_ns = 10**18 + k * STEP_NS
        fusion.add(GyroSample(t_ns, 0.1))
        fusion.add(OdometrySample(t_ns + 1, 0.1, 0.5))
        if nonsense and k == 100:
            assert not fusion.add(nonsense(t_ns + 2))
    return fusion.estimate().yaw


@pytest.mark.parametrize("kind", NONSENSE)
def test_fusion_refuses_nonsense_without_a_trace(kind):
    """A square of 1e300 overflows, and a sample stays in the timeline: one of them would end the fusion for good."""
    assert fused_yaw(NONSENSE[kind]) == fused_yaw()


def test_vertical_is_not_tilted_by_nonsense():
    level = ImuLevel(ImuConfig())
    for k in range(100):
        rate = (1e30, -1e30, 0.0) if k == 50 else (0.0, 0.0, 0.1)
        sample = level.sample(10**18 + k * STEP_NS, rate, (0.0, 0.0, 9.81))
    assert sample.yaw_rate == pytest.approx(0.1, abs=1e-12)


@pytest.mark.parametrize(
    "bad",
    [
        GyroSample(math.nan, 0.1),
        GyroSample(10**9, math.nan),
        GyroSample(10**9, 1e300),
        GyroSample(10**9, 0.1, -1.0),
        OdometrySample(10**9, 0.1, math.inf),
        YawIncrement(10**9, 2 * 10**9, 0.1, math.nan, 0.9),
    ],
)
def test_sensor_that_measures_nothing_is_named_before_there_is_an_estimate(bad):
    pipeline = YawPipeline()
    for k in range(10):
        pipeline.add(replace(bad, t_ns=bad.t_ns + k * 10**8))
    assert pipeline.estimate() is None
    (warning,) = pipeline.warnings()
    assert warning.code == "samples_lost"
    assert warning.text.startswith(f"{warning.sensor}: 10 of 10 samples are no measurement")


def test_single_nonsense_is_no_fault_of_the_sensor():
    fusion = YawFusion()
    for k in range(1000):
        fusion.add(GyroSample(10**9 + k * 10**7, math.nan if k % 200 == 7 else 0.1))
    assert not fusion.estimate().warnings


def in_numpy(sample):
    """The sample with each of its numbers as numpy has it."""
    kinds = {int: np.int64, float: np.float64}
    numbers = {one.name: getattr(sample, one.name) for one in fields(sample)}
    return replace(sample, **{name: kinds[type(x)](x) for name, x in numbers.items() if type(x) in kinds})


def test_numbers_of_numpy_are_judged_as_python_s_are():
    """A gyro whose bias steps has to be excluded; numpy's comparisons are no `True`, so the compass once was."""
    drive = robot_drive(53, seconds=32.0).changed(lambda s: replace(s, yaw_rate=s.yaw_rate - 0.132), GyroSample, 17.5)
    estimates = []
    for samples in (drive.samples, [in_numpy(sample) for sample in drive.samples]):
        fusion = YawFusion()
        for sample in samples:
            fusion.add(sample)
        estimates.append((fusion.estimate(), smooth(samples)))
    assert estimates[0] == estimates[1]
    fused = estimates[0][0]
    assert abs(drive.error(fused)) < 3.0 * math.sqrt(fused.yaw_variance)


@pytest.mark.parametrize(
    ("sample", "named"),
    [
        (GyroSample(10**9, "fast"), "yaw_rate is 'fast'"),
        (OdometrySample(10**9, 0.1, [0.2, 0.3]), "speed is [0.2"),
        (YawIncrement(1, 10**9, 0.1, 1e-8, 0.9, tilt=("a", 0.0)), "tilt is 'a'"),
    ],
)
def test_what_is_no_number_is_an_error_that_names_it(sample, named):
    with pytest.raises(ArgumentError, match=re.escape(named)):
        YawFusion().add(sample)
