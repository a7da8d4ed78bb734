"""Sound robots of all kinds: nothing is wrong with them, but no two have the same sensors, nor drive alike."""

import math
from dataclasses import dataclass, replace

import numpy as np
from robot_drive import HZ, Eyes, RobotDrive, sensed

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion

BEFORE = 1  # s; that it has driven before the first sample, where it is switched on in motion
LEAST_SIGMA = math.radians(0.05)  # below which a ratio says nothing
KINDS = {"G": GyroSample, "T": OdometrySample, "C": YawIncrement}


@dataclass(frozen=True)
class SoundRobot:
    """Rates in Hz, times in s, angles in rad; what is not said is as in `sensed` and `Eyes`."""

    hertz: tuple[int, int, int]
    gyro_noise: float
    bias: float
    bias_walk: float
    gyro_scale: float
    track_scale: float
    slip: float
    veer: float
    tick: float
    camera_delay: float
    stray: float
    noise: float
    hold: float
    fastest: float
    style: str
    stands: float


def sound_robot(seed):
    """One of them. Biases and scale factors are drawn about as the default settings expect them."""
    rng = np.random.default_rng(seed)
    return SoundRobot(
        hertz=tuple(
            int(rng.choice(rates))
            for rates in ([10, 25, 50, 100, 200, 500], [2, 5, 10, 20, 50, 100], [1, 2, 5, 10, 20, 25])
        ),
        gyro_noise=10.0 ** rng.uniform(-3.5, -1.7),
        bias=rng.normal() * rng.choice([0.003, 0.005, 0.008]),
        bias_walk=rng.choice([0.0, 0.0, 1e-4, 5e-4]),
        gyro_scale=1.0 + 0.01 * rng.normal(),
        track_scale=rng.choice([1.0, 1.0, 1.2, 1.5, 1.9]),
        slip=10.0 ** rng.uniform(-2.5, -0.7),
        veer=0.01 * rng.normal(),
        tick=10.0 ** rng.uniform(-5.0, -2.5),
        camera_delay=round(max(0.0, 0.03 + 0.04 * rng.normal()), 3),
        stray=rng.choice([0.0, 0.0, 0.002, 0.005]),
        noise=10.0 ** rng.uniform(-4.0, -2.5),
        hold=rng.choice([0.3, 1.0, 2.0, 5.0]),
        fastest=rng.choice([0.2, 0.6, 1.2, 2.5]),
        style=str(rng.choice(["stops", "straight", "weaves", "turns"])),
        stands=rng.choice([0.0, 2.0, 2.0, 5.0]),
    )


def drive(robot, seed, seconds=40):
    """What its sensors say in so many seconds."""
    rng = np.random.default_rng([seed, 1])
    rate, speed = _driven(rng, robot, HZ * (BEFORE + seconds))
    bias = robot.bias + robot.bias_walk * np.cumsum(rng.normal(size=rate.size)) / math.sqrt(HZ)
    error = robot.noise * math.sqrt(0.5)
    whole = sensed(
        rng, rate, speed, bias=bias, scale=robot.track_scale, hertz=robot.hertz, camera_delay=robot.camera_delay,
        eyes=Eyes(hold=robot.hold, noise=error, lasts=error), gyro_noise=robot.gyro_noise, gyro_scale=robot.gyro_scale,
        slip=robot.slip, veer=robot.veer, tick=robot.tick,
    )  # fmt: skip
    strayed = {}
    for one in whole.samples:
        if isinstance(one, YawIncrement):
            for t_ns in (one.t_ref_ns, one.t_ns):
                strayed.setdefault(t_ns, t_ns + round(1e9 * abs(robot.stray * rng.normal())))
    samples = [
        replace(one, t_ref_ns=strayed[one.t_ref_ns], t_ns=strayed[one.t_ns]) if isinstance(one, YawIncrement) else one
        for one in whole.samples
        if getattr(one, "t_ref_ns", one.t_ns) >= BEFORE * 10**9
    ]
    return RobotDrive(whole.t, whole.yaw - whole.yaw[BEFORE * HZ], samples, robot.camera_delay)


def _driven(rng, robot, n):
    """Turn rate and speed, rad/s and m/s each 1 ms; it shakes by up to 10 mrad/s where it drives."""
    rate, speed = np.zeros(n), np.zeros(n)
    i = round(HZ * (BEFORE + robot.stands)) if robot.stands else 0
    while i < n:
        leg = slice(i, i + int(rng.uniform(0.5, 5.0) * HZ))
        turning, ahead = rng.uniform(-1.0, 1.0) * robot.fastest, 0.5
        if robot.style == "stops" and rng.integers(3) == 0:
            turning = ahead = 0.0
        elif robot.style == "straight" and rng.integers(4):
            turning = 0.0
        elif robot.style == "weaves":
            turning = 0.5 * robot.fastest * np.sin(math.tau * rng.uniform(0.2, 1.0) * np.arange(len(rate[leg])) / HZ)
        rate[leg], speed[leg] = turning, ahead
        i = leg.stop
    smooth = np.hanning(300) / np.hanning(300).sum()
    rate, speed = (np.convolve(one, smooth, "same") for one in (rate, speed))
    return rate + 0.01 * rng.random() * rng.normal(size=n) * (speed > 0.05), speed


@dataclass
class Fused:
    """How a drive ended, rad; how long it was beyond three and four deviations, s; who was named, and for how long."""

    error: float = 0.0
    sigma: float = 0.0
    worst: float = 0.0
    ratio: float = 0.0
    over3: float = 0.0
    over4: float = 0.0
    named: dict[str, float] | None = None


def fused(ride, who="GTC"):
    """Of the sensors in `who`, estimates after each sample."""
    fusion, result, last = YawFusion(), Fused(named={}), BEFORE
    for sample in ride.samples:
        if not isinstance(sample, tuple(KINDS[one] for one in who)):
            continue
        fusion.add(sample)
        estimate = fusion.estimate()
        error, sigma, now = abs(ride.error(estimate)), math.sqrt(estimate.yaw_variance), estimate.t_ns * 1e-9
        ratio, step, last = error / max(sigma, LEAST_SIGMA), max(now - last, 0.0), max(now, last)
        result.error, result.sigma, result.worst = error, sigma, max(result.worst, error)
        result.ratio = max(result.ratio, ratio)
        result.over3 += step * (ratio > 3.0)
        result.over4 += step * (ratio > 4.0)
        for one in estimate.warnings:
            name = f"{one.code}:{one.sensor}"
            result.named[name] = result.named.get(name, 0.0) + step
    return result
