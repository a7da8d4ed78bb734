"""Print how honest gyro and tracks are on robots that never stand until the end.

PYTHONPATH=tests python -m tools.fleet_table [--seeds N]
"""

import argparse
import math

import numpy as np
from robot_drive import HZ, TICK, RobotDrive, _gauss_markov

from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion

SECONDS = 150.0
FLEETS = {  # bias, rad/s, and veer, rad/m
    "as in data sheets": lambda rng: (0.0035 * rng.normal(), 0.015 * rng.normal()),
    "anywhere between": lambda rng: (
        0.01 * 10 ** rng.uniform(-1.7, 0.0) * rng.normal(),
        0.015 * 10 ** rng.uniform(-1.7, 0.0) * rng.normal(),
    ),
    "gyros twice as bad": lambda rng: (0.01 * rng.normal(), 0.005 * rng.normal()),
}
CONFIGS = {
    "defaults": FusionConfig(),
    "normal priors of 0.01": FusionConfig(
        initial_bias_sigma=0.01, veer_sigma=0.01, least_bias_sigma=0.01, least_veer_sigma=0.01
    ),
}


def drive(seed, errors):
    """Legs of 2 to 15 s, turning at up to 0.6 rad/s or not; the last fifth stands. Grip and vibration are drawn."""
    rng = np.random.default_rng(seed + 1000)
    n = round(HZ * SECONDS)
    rate, speed, stop, i = np.zeros(n), np.zeros(n), round(0.8 * n), 0
    fastest = rng.uniform(0.4, 1.5)
    while i < stop:
        end = min(i + int(rng.uniform(2.0, 15.0) * HZ), stop)
        rate[i:end] = rng.choice([0.0, 0.0, rng.uniform(-0.6, 0.6)])
        speed[i:end] = fastest * (rng.uniform(0.5, 1.0) if rng.integers(3) == 0 else 1.0)
        i = end
    smooth = np.hanning(600) / np.hanning(600).sum()
    rate, speed = np.convolve(rate, smooth, "same"), np.convolve(speed, smooth, "same")
    bias, veer = errors(rng)
    grip, shaken, noise = 10 ** rng.uniform(-2.7, -1.3), 10 ** rng.uniform(-3.0, -1.7), 10 ** rng.uniform(-3.0, -2.5)
    scale = 1.0 + rng.uniform(-0.1, 0.4)
    yaw = np.concatenate([[0.0], np.cumsum(rate[:-1]) / HZ])
    samples = [
        GyroSample(j * 10**6, float(rate[j] + bias + noise * rng.normal() + (speed[j] > 0.01) * shaken * rng.normal()))
        for j in range(0, n, 10)
    ]
    slip = grip * _gauss_markov(rng, n, 0.5)
    claims = scale * rate * (1.0 + slip) + speed * (slip / 0.4 + veer)
    claimed = np.concatenate([[0.0], np.cumsum(claims)[:-1] / HZ])
    claimed = np.round(claimed[::25] / TICK) * TICK
    for k, turn in enumerate(np.diff(claimed, prepend=0.0)):
        samples.append(
            OdometrySample((k * 25 + 1) * 10**6, 40.0 * float(turn), float(speed[k * 25]), float(claimed[k]))
        )
    return RobotDrive(np.arange(n) / HZ, yaw, sorted(samples, key=lambda sample: sample.t_ns))


def fused(ride, config):
    """Mean error^2/variance, worst error over sigma and RMS error, deg, while it drives."""
    fusion, errors, variances = YawFusion(config), [], []
    for number, sample in enumerate(ride.samples):
        fusion.add(sample)
        if number % 400 == 399 and sample.t_ns * 1e-9 < 0.78 * SECONDS:
            estimate = fusion.estimate()
            errors.append(ride.error(estimate))
            variances.append(estimate.yaw_variance)
    normalised = np.square(errors) / variances
    return normalised.mean(), math.sqrt(normalised.max()), math.degrees(np.sqrt(np.mean(np.square(errors))))


def main():
    parser = argparse.ArgumentParser("fleet_table", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    for fleet, errors in FLEETS.items():
        rides = [drive(seed, errors) for seed in range(seeds)]
        for name, config in CONFIGS.items():
            honest, worst, rms = np.array([fused(ride, config) for ride in rides]).T
            print(
                f"{fleet}, {name}: error^2/variance {honest.mean():.1f} (median {np.median(honest):.1f}), "
                f"worst in sigmas {worst.mean():.1f}, RMS {np.sqrt(np.mean(rms**2)):.0f} deg",
                flush=True,
            )


if __name__ == "__main__":
    main()
