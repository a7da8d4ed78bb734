"""Two faults at once: the camera sees nothing for some seconds, and meanwhile the gyro's bias steps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, Eyes, sensed

from compass import YawIncrement
from fusion import GyroSample, YawPipeline

SECONDS, DARK_S, STEPPED_S, LIGHT_S = 22, 9.0, 10.0, 15.0
HELD_S, RENEWED_S = 100.0, 2.0  # for which a keyframe is held: a robot that turns on the spot has the same all the time


def drive(seed, hold, step):
    """Turns on the spot; no images from `DARK_S` to `LIGHT_S`, a bias that steps by `step` rad/s at `STEPPED_S`."""
    rng = np.random.default_rng(seed)
    legs = np.repeat(rng.uniform(0.3, 0.8, SECONDS // 2) * rng.choice([-1.0, 1.0], SECONDS // 2), 2 * HZ)
    rate = np.convolve(legs, np.hanning(HZ) / np.hanning(HZ).sum(), "same")
    eyes = Eyes(hold=hold, noise=3e-4, lasts=8e-5, time=6.0, claims_all=False)
    whole = sensed(rng, rate, 0.0 * rate, hertz=(50, 20, 10), eyes=eyes)
    whole = whole.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + step), GyroSample, STEPPED_S)
    return whole.changed(lambda _: None, YawIncrement, DARK_S, LIGHT_S)


def fused(ride):
    """Times, s, errors and sigmas, rad, and who was named."""
    pipeline, seen, named = YawPipeline(), [], set()
    for sample in ride.samples:
        pipeline.add(sample)
        estimate = pipeline.estimate()
        seen.append((estimate.t_ns * 1e-9, ride.error(estimate), math.sqrt(estimate.yaw_variance)))
        named |= {name for warning in estimate.warnings for name in warning.sensors}
    return *np.array(seen).T, named


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("hold", "step"), [(HELD_S, 0.05), (HELD_S, -0.2), (RENEWED_S, 0.05)])
def test_yaw_after_the_dark_is_right_or_not_claimed(hold, step, seed):
    t, error, sigma, named = fused(drive(seed, hold, step))
    assert np.abs(error).max() > math.radians(6.0)  # while nobody could see it
    assert (np.abs(error) / np.maximum(sigma, math.radians(0.02)))[t > LIGHT_S + 1.0].max() < 4.0
    assert "gyro" in named
    if hold == HELD_S:  # the images know the way back to before the dark
        assert abs(error[-1]) < math.radians(1.0)


@pytest.mark.parametrize("hold", [HELD_S, RENEWED_S])
def test_dark_alone_is_bridged_by_the_gyro(hold):
    _, error, sigma, named = fused(drive(1, hold, 0.0))
    assert abs(error[-1]) < 3.0 * sigma[-1] < math.radians(2.0)
    assert named == {"compass"}
