"""The filter's uncertainty is true: over 100 drives NEES and NIS lie in their 95 % chi-square bounds.

(Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 5.4.)
"""

import math

import numpy as np
import pytest
from scipy.stats import chi2
from sensor_model import SUBSETS, drawn_drive

from fusion import FusionConfig, Sensor, YawFusion

DRIVES = 100
STARTS = [math.radians(d) for d in (0.0, 60.0, 180.0, -120.0)] + [math.pi - 1e-6, 1e-6 - math.pi]


def run(drive, config):
    """The final error of (yaw, rate, bias, scale), normalised and squared; each sensor's normalised innovations."""
    fusion = YawFusion(config)
    nis = {sensor: [] for sensor in Sensor}
    last = {}
    for sample in drive.samples:
        fusion.add(sample)
        for sensor, report in fusion.reports().items():
            if report is not None and report is not last.get(sensor):
                last[sensor] = report
                nis[sensor].append(report.nis)
    state = fusion.state
    i = round(state.t_ns * 1e-7)
    error = state.x[:4] - np.array([drive.yaw[i], drive.rate[i], drive.bias[i], drive.scale[i]])
    return float(error @ np.linalg.solve(state.P[:4, :4], error)), nis


def assert_mean_of_chi_square(mean, dimension, count):
    low, high = chi2.ppf([0.025, 0.975], dimension * count) / count
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
            initial_yaw=STARTS[seed % len(STARTS)],
            recovery_time=0.0,
        )
        value, innovations = run(drawn_drive(seed, sensors, seconds=6.0, config=config), config)
        nees.append(value)
        for sensor, values in innovations.items():
            nis[sensor] += values
    assert_mean_of_chi_square(np.mean(nees), 4, DRIVES)
    for values in nis.values():
        if values:
            assert_mean_of_chi_square(np.mean(values), 1, len(values))
