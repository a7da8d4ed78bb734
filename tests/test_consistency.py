"""The filter's uncertainty is true: over 100 drives NEES and NIS lie in their chi-square bounds.

The bounds of each average hold with 1 - 0.05 / 33, of all 39 together with 94 % (Bonferroni).
(Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 5.4.)
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensor_model import SUBSETS, drawn_drive, far_increments

from compass import YawIncrement
from fusion import FusionConfig, Sensor, YawFusion
from fusion.buffer.events import event_of, reference_of
from fusion.filter import YawFilter
from fusion.state.ekf import State
from fusion.state.learnt_noise import JITTERS, LearntNoise

DRIVES = 100
DRAWN = [State.YAW, State.RATE, State.BIAS, State.SCALE]
STARTS = [math.radians(d) for d in (0.0, 60.0, 180.0, -120.0)] + [math.pi - 1e-6, 1e-6 - math.pi]


def modelled(seed, *, rate_walk_factor=1.0, bias_walk_factor=1.0, slip_factor=1.0, **fields):
    """Of a filter that a drawn drive obeys, and whose gate is open: a gated innovation is a truncated one."""
    return FusionConfig(
        gate_probability=1.0 - 1e-12,
        recovery_time=0.0,
        initial_scale_sigma=0.05,  # of tracks alone, 1 / scale matters; beyond this it is far from linear
        camera_delay_sigma=0.005,  # this robot's turn rate changes a lot in more
        track_timing=0.0,  # the drawn stamps are right
        initial_yaw=STARTS[seed % len(STARTS)],
        watched_rate_walk=FusionConfig().rate_walk,  # the drawn robot moves alike whether a gyro watches or not
        rate_walk_factor=rate_walk_factor,
        bias_walk_factor=bias_walk_factor,
        slip_factor=slip_factor,
        gyro_sigma_factor=1.0,
        gyro_scale_sigma=0.0,  # without a compass its part is in the estimate's variance, not in the state's
        **fields,
    )


def run(drive, config):
    """The final error of (yaw, rate, bias, scale), normalised and squared; each sensor's normalised innovations."""
    events = [event_of(sample) for sample in drive.samples]
    references = {reference_of(sample) for sample in drive.samples if isinstance(sample, YawIncrement)}
    filter_ = YawFilter(config)
    state = filter_.start
    nis = {sensor: [] for sensor in Sensor}
    for event in sorted([*events, *references], key=lambda event: event.order):
        before, state = state, filter_.step(state, event)
        for sensor, gate in state.gates.items():
            if gate is not before.gates[sensor]:
                nis[sensor].append(gate.report.nis)
    i = round(state.t_ns * 1e-7)
    error = state.x[DRAWN] - np.array([drive.yaw[i], drive.rate[i], drive.bias[i], drive.scale[i]])
    return float(error @ np.linalg.solve(state.P[np.ix_(DRAWN, DRAWN)], error)), nis


def assert_mean_of_chi_square(mean, dimension, count):
    tail = 0.025 / 33
    low, high = chi2.ppf([tail, 1.0 - tail], dimension * count) / count
    print(f"{low:.4f} < {mean:.4f} < {high:.4f}  ({count})")
    assert low < mean < high


@pytest.mark.parametrize(
    ("sensors", "odometry"),
    [(s, o) for s in SUBSETS for o in ("twist", "pose") if o == "twist" or "tracks" in s],
    ids=lambda p: p if isinstance(p, str) else "+".join(p),
)
def test_nees_and_nis_over_drives_lie_in_their_bounds(sensors, odometry):
    nees, nis = [], {sensor: [] for sensor in Sensor}
    for seed in range(DRIVES):
        config = modelled(seed, odometry=odometry, compass_timing_factor=1.0)  # estimated, the NIS is no chi-square
        drive = drawn_drive(seed, sensors, 6.0, config, gyro_hz=25, track_hz=10, compass_hz=5)
        value, innovations = run(drive, config)
        nees.append(value)
        for sensor, values in innovations.items():
            nis[sensor] += values
    assert_mean_of_chi_square(np.mean(nees), 4, DRIVES)
    for values in nis.values():
        if values:
            assert_mean_of_chi_square(np.mean(values), 1, len(values))


@pytest.mark.parametrize("sensors", [s for s in SUBSETS if "compass" in s], ids="+".join)
def test_nees_lies_in_its_bounds_while_it_is_learnt_how_far_stamps_stray(sensors):
    """They stray by another amount in each drive, drawn from what is expected beforehand."""
    default = FusionConfig()
    prior = np.exp(LearntNoise.jitter(default.compass_timing, default.compass_timing_factor).prior)
    nees = []
    for seed in range(DRIVES):
        stray = float(np.random.default_rng(DRIVES + seed).choice(JITTERS, p=prior / prior.sum()))
        drawn = modelled(seed, compass_timing=stray)
        drive = drawn_drive(seed, sensors, 6.0, drawn, gyro_hz=25, track_hz=10, compass_hz=5)
        nees.append(run(drive, modelled(seed))[0])
    assert_mean_of_chi_square(np.mean(nees), 4, DRIVES)


@pytest.mark.parametrize("sensors", [s for s in SUBSETS if "compass" in s], ids="+".join)
def test_nees_lies_in_its_bounds_with_views_from_some_seconds_ago(sensors):
    """Most of their references are older than `reference_window`: the filter must have kept them."""
    nees, sigmas = [], {True: [], False: []}
    for seed in range(DRIVES):
        config = replace(modelled(seed), camera_delay_sigma=0.0, compass_timing=0.0, compass_timing_factor=1.0)
        drive = drawn_drive(seed, sensors, 8.0, config, gyro_hz=25, track_hz=10, compass_hz=5, hold=0.6)
        with_far = replace(drive, samples=[*drive.samples, *far_increments(drive, seed, config)])
        nees.append(run(with_far, config)[0])
        if seed < 5:
            for far, samples in ((True, with_far.samples), (False, drive.samples)):
                fusion = YawFusion(config)
                for sample in sorted(samples, key=lambda sample: sample.t_ns):
                    fusion.add(sample)
                assert fusion.state.references_lost == 0
                sigmas[far].append(math.sqrt(fusion.state.P[0, 0]))  # the published one holds more
    assert_mean_of_chi_square(np.mean(nees), 4, DRIVES)
    assert np.mean(sigmas[True]) < 0.6 * np.mean(sigmas[False])
