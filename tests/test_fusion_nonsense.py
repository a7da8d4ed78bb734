"""Numbers that no robot has, but a driver can send: refused, and without any trace in what follows."""

from __future__ import annotations

import pytest

from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion
from fusion.vertical import ImuConfig, ImuLevel

STEP_NS = 10_000_000
NONSENSE = {
    "gyro": lambda t_ns: GyroSample(t_ns, 1e300),
    "track rate": lambda t_ns: OdometrySample(t_ns, -1e300, 0.0),
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
