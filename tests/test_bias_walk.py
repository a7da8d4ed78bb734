"""A gyro whose bias drifts far faster than configured, too slowly for any window to show a contradiction."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import fuse, robot_drive

from fusion import FusionConfig, GyroSample
from fusion.checks.windows import Claim, Start, Window
from fusion.state.bias_walk import BiasWalk

S = 10**9


def test_a_bias_that_runs_away_is_followed():
    drive = robot_drive(2, seconds=45.0, gyro_hz=50, track_hz=20).changed(
        lambda s: replace(s, yaw_rate=s.yaw_rate + 0.0004 * (s.t_ns * 1e-9 - 10.0)), GyroSample, since=10.0
    )
    known, errors = fuse(drive, FusionConfig(bias_walk_factor=1.0))
    learnt, better = fuse(drive)
    assert np.std(better) < 0.7 * np.std(errors)
    assert abs(better[-1]) < 3.0 * math.sqrt(learnt.estimate().yaw_variance)
    assert learnt.state.bias_walk.scale > 3.0 > known.state.bias_walk.scale == 1.0


@pytest.mark.parametrize(("walk", "least", "most"), [(2e-5, 0.0, 20.0), (1e-3, 300.0, 40000.0)])
def test_the_walk_is_learnt(walk, least, most):
    rng, bias, learnt = np.random.default_rng(0), 0.004, BiasWalk.about(2e-5, 2.5)
    errors = 1e-4 * rng.normal(size=121)  # of a keyframe's increments: they do not add up
    for k in range(120):
        bias += walk * math.sqrt(0.5) * rng.normal()
        gyro = Claim(0.1 + 0.5 * bias + 2e-4 * rng.normal(), 2e-4)
        window = Window(k * S // 2, (k + 1) * S // 2, gyro, None, Claim(0.1 + errors[k + 1] - errors[k], 1.5e-4), 0.1)
        learnt = learnt.after(window, Start(bias_sigma=0.005))
    assert least < learnt.scale < most
    assert learnt.drifts[3].bias == pytest.approx(bias, abs=2e-3)


def test_a_walk_of_none_stays_none():
    window = Window(0, S // 2, Claim(0.1, 1e-4), None, Claim(0.2, 1e-4), 0.1)
    for known in (BiasWalk.about(0.0, 2.5), BiasWalk.about(2e-5, 1.0)):
        assert known.after(window, Start()) == known
        assert known.scale == 1.0
