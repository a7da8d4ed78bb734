"""A seeded drive and what the three sensors say of it, drawn from the very statistics that a `FusionConfig` claims."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample
from fusion.state.ekf import DELAY_WALK

GRID_HZ = 100
SENSORS = ("gyro", "tracks", "compass")
SUBSETS = [tuple(s for i, s in enumerate(SENSORS) if mask >> i & 1) for mask in range(1, 8)]


@dataclass(frozen=True)
class Drive:
    """Truth on a grid of 10 ms (rad, rad/s, 1) and the samples in the order of their stamps."""

    t_ns: np.ndarray
    yaw: np.ndarray
    rate: np.ndarray
    bias: np.ndarray
    scale: np.ndarray
    samples: list


def drawn_drive(seed, sensors=SENSORS, seconds=10.0, config=None, gyro_hz=50, track_hz=20, compass_hz=10, hold=1.0):
    """Draw a drive whose motion, bias, scale, slip and noises all follow `config`.

    Rate and acceleration start from a draw of their priors; the compass keeps a reference for `hold` seconds.
    """
    config = config or FusionConfig()
    rng = np.random.default_rng(seed)
    n = round(GRID_HZ * seconds) + 1
    yaw, rate = _motion(rng, n, config)
    bias = _walk(rng, n, config.initial_bias_sigma, config.bias_walk)
    scale = config.initial_scale + _walk(rng, n, config.initial_scale_sigma, config.scale_walk)
    slip = _gauss_markov(rng, n, config.slip_time)
    speed = 0.5 * np.sin(np.arange(n) / GRID_HZ) ** 2
    veer = config.veer_sigma * rng.normal()
    gyro_scale = config.gyro_scale_sigma * rng.normal()
    t_ns = np.arange(n) * (10**9 // GRID_HZ)
    samples = []
    if "gyro" in sensors:
        at = np.arange(0, n, GRID_HZ // gyro_hz)
        z = (1.0 + gyro_scale) * rate[at] + bias[at] + config.gyro_sigma * rng.normal(size=at.size)
        samples += [GyroSample(int(t), float(w)) for t, w in zip(t_ns[at], z, strict=True)]
    if "tracks" in sensors:
        at = np.arange(0, n, GRID_HZ // track_hz)
        samples += _tracks(rng, at, t_ns, (yaw, rate, speed), (scale, veer, slip), config)
    if "compass" in sensors:
        at, timed = np.arange(0, n, GRID_HZ // compass_hz), "gyro" in sensors  # else the camera's clock is the time
        samples += _compass(rng, at, t_ns, yaw, rate, hold, config, timed=timed)
    return Drive(t_ns, yaw, rate, bias, scale, sorted(samples, key=lambda sample: sample.t_ns))


def far_increments(drive, seed, config=None, every=5, held=3):
    """Increments from some seconds ago: at each so-manieth image, from a view that is kept for a few of them.

    Of a camera whose stamps are exact.
    """
    rng = np.random.default_rng([seed, 1])
    images = [sample for sample in drive.samples if isinstance(sample, YawIncrement)]
    config = config or FusionConfig()
    lasting, share = _gauss_markov(rng, drive.yaw.size, config.compass_error_time), config.compass_error_share
    out, reference = [], images[0].t_ref_ns
    for count, image in enumerate(images[every - 1 :: every], 1):
        since, until = (round(t_ns * 1e-9 * GRID_HZ) for t_ns in (reference, image.t_ns))
        variance = float(rng.uniform(0.1e-3, 0.4e-3)) ** 2
        error = math.sqrt(share) * lasting[until] + math.sqrt(1.0 - share) * rng.normal()
        turn = float(wrap_angle(drive.yaw[until] - drive.yaw[since] + math.sqrt(variance) * error))
        out.append(YawIncrement(reference, image.t_ns, turn, variance, 0.9, long_baseline=True))
        if count % held == 0:
            reference = image.t_ns
    return out


def turning_noise(config, dt):
    """Transition and noise of (yaw, rate, acceleration) over `dt` s, by the doubled matrix (Van Loan 1978).

    That grows by exp(dt / ramp) and loses as much of its precision: hence in steps not longer than the ramp.
    """
    steps = math.ceil(dt / config.rate_ramp)
    A = np.zeros((6, 6))
    A[:3, :3] = -np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / config.rate_ramp]])
    A[2, 5] = (config.rate_walk / config.rate_ramp) ** 2
    A[3:, 3:] = -A[:3, :3].T
    both = expm(A * dt / steps)
    step = both[3:, 3:].T
    noise = step @ both[:3, 3:]
    F, Q = np.eye(3), np.zeros((3, 3))
    for _ in range(steps):
        F, Q = step @ F, step @ Q @ step.T + noise
    return F, Q


def _motion(rng, n, config):
    """Exact draw of an acceleration that is Gauss-Markov, and of its integrals, rate and yaw."""
    F, Q = turning_noise(config, 1.0 / GRID_HZ)
    steps = np.empty((n, 3))
    steps[1:] = rng.normal(size=(n - 1, 3)) @ np.linalg.cholesky(Q).T
    spread = config.initial_yaw_sigma, config.initial_rate_sigma, config.rate_walk / math.sqrt(2.0 * config.rate_ramp)
    steps[0] = np.array([config.initial_yaw, 0.0, 0.0]) + np.array(spread) * rng.normal(size=3)
    # x = F x + step, line by line from below: F is upper triangular, its first two diagonal elements are one
    acceleration = lfilter([1.0], [1.0, -F[2, 2]], steps[:, 2])
    steps[1:, 1] += F[1, 2] * acceleration[:-1]
    rate = np.cumsum(steps[:, 1])
    steps[1:, 0] += F[0, 1] * rate[:-1] + F[0, 2] * acceleration[:-1]
    return np.cumsum(steps[:, 0]), rate


def _walk(rng, n, sigma, step):
    return sigma * rng.normal() + np.concatenate([[0.0], np.cumsum(step / math.sqrt(GRID_HZ) * rng.normal(size=n - 1))])


def _gauss_markov(rng, n, time):
    keep = math.exp(-1.0 / (GRID_HZ * time))
    steps = rng.normal(size=n)
    steps[1:] *= math.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], steps)


def _tracks(rng, at, t_ns, motion, errors, config):
    """What the tracks claim from sample to sample; how far they stray follows from the claim before."""
    yaw, _, speed = motion
    scale, veer, slip = errors
    turn, stray = [0.0], 0.0
    for a, b in pairwise(at):
        dt = (t_ns[b] - t_ns[a]) * 1e-9
        slipped = stray * np.mean(slip[a : b + 1]) * dt
        turn.append(scale[b] * (yaw[b] - yaw[a]) + veer * speed[a] * dt + slipped)
        turn[-1] += config.track_noise * math.sqrt(dt) * rng.normal()
        stray = math.hypot(config.track_slip_turn * turn[-1] / dt, config.track_slip_speed * speed[b])
    pose = wrap_angle(0.3 + np.cumsum(turn))
    rows = zip(t_ns[at], np.array(turn) / dt, speed[at], pose, strict=True)
    return [OdometrySample(int(t), float(w), float(v), float(p)) for t, w, v, p in rows]


def _compass(rng, at, t_ns, yaw, rate, hold, config, *, timed):
    out, reference = [], at[0]
    lasting = _gauss_markov(rng, yaw.size, config.compass_error_time)
    delay = config.camera_delay
    if timed:
        delay = delay + _walk(rng, yaw.size, config.camera_delay_sigma, DELAY_WALK * config.compass_timing)
    yaw = yaw - (delay + config.compass_timing * rng.normal(size=yaw.size)) * rate  # at the exposure, not at the stamp
    for i in at[1:]:
        variance = float(rng.uniform(0.5e-3, 2e-3)) ** 2
        lasts = config.compass_error_share * variance
        error = math.sqrt(lasts) * lasting[i] + math.sqrt(variance - lasts) * rng.normal()
        turn = float(wrap_angle(yaw[i] - yaw[reference] + error))
        out.append(YawIncrement(int(t_ns[reference]), int(t_ns[i]), turn, variance, 0.9))
        if (t_ns[i] - t_ns[reference]) * 1e-9 >= hold - 1e-9:
            reference = i
    return out
