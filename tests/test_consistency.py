"""The filter's uncertainty is true: over 100 drives NEES and NIS lie in their chi-square bounds.

The bounds hold for all 29 averages together with 95 % (each with 1 - 0.05 / 29, Bonferroni).
(Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 5.4.)
"""

import math

import numpy as np
import pytest
from scipy.stats import chi2
from sensor_model import SUBSETS, drawn_drive

from compass import YawIncrement
from fusion import FusionConfig, Sensor
from fusion.events import event_of, reference_of
from fusion.filter import YawFilter

DRIVES = 100
STARTS = [math.radians(d) for d in (0.0, 60.0, 180.0, -120.0)] + [math.pi - 1e-6, 1e-6 - math.pi]


def run(drive, config):
    """The final error of (yaw, rate, bias, scale), normalised and squared; each sensor's normalised innovations."""
    events = [event_of(sample) for sample in drive.samples]
    references = {sample.t_ref_ns: reference_of(sample) for sample in drive.samples if isinstance(sample, YawIncrement)}
    filter_ = YawFilter(config)
    state = filter_.start
    nis = {sensor: [] for sensor in Sensor}
    for event in sorted([*events, *references.values()], key=lambda event: event.order):
        before, state = state, filter_.step(state, event)
        for sensor, gate in state.gates.items():
            if gate is not before.gates[sensor]:
                nis[sensor].append(gate.report.nis)
    i = round(state.t_ns * 1e-7)
    error = state.x[:4] - np.array([drive.yaw[i], drive.rate[i], drive.bias[i], drive.scale[i]])
    return float(error @ np.linalg.solve(state.P[:4, :4], error)), nis


def assert_mean_of_chi_square(mean, dimension, count):
    tail = 0.025 / 29
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
        # the gate is opened: a gated innovation is a truncated one
        config = FusionConfig(
            gate_probability=1.0 - 1e-12,
            initial_scale_sigma=0.05,  # of tracks alone, 1 / scale matters; beyond this it is far from linear
            odometry=odometry,
            compass_timing_factor=1.0,  # with variances that are estimated themselves the NIS is no chi-square
            camera_delay_sigma=0.005,  # this robot's turn rate changes a lot in more
            track_timing=0.0,  # the drawn stamps are right
            initial_yaw=STARTS[seed % len(STARTS)],
            recovery_time=0.0,
            watched_rate_walk=FusionConfig().rate_walk,  # the drawn robot moves alike whether a gyro watches or not
        )
        drive = drawn_drive(seed, sensors, 6.0, config, gyro_hz=25, track_hz=10, compass_hz=5)
        value, innovations = run(drive, config)
        nees.append(value)
        for sensor, values in innovations.items():
            nis[sensor] += values
    assert_mean_of_chi_square(np.mean(nees), 4, DRIVES)
    for values in nis.values():
        if values:
            assert_mean_of_chi_square(np.mean(values), 1, len(values))
