"""A stop-and-go drive of a tracked robot and what its sensors say, with faults to order."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from compass import YawIncrement, wrap_angle
from fusion import GyroSample, OdometrySample, YawFusion

HZ = 1000
TICK = 5e-4 / 0.4  # rad of claimed turn per encoder count: 0.5 mm of track, 0.4 m between the tracks


@dataclass(frozen=True)
class RobotDrive:
    """Truth at 1 kHz (s, rad), the samples by stamp, and by how much the truth may err itself, rad."""

    t: np.ndarray
    yaw: np.ndarray
    samples: list
    camera_delay: float = 0.0
    truth_sigma: float | np.ndarray = 0.0

    def changed(self, change, kind=object, since=0.0, until=math.inf):
        """The drive with `change` (None: left out) made to the samples of a kind between two times, s."""

        def one(sample):
            hit = isinstance(sample, kind) and since <= sample.t_ns * 1e-9 < until
            return change(sample) if hit else sample

        return replace(self, samples=[s for s in map(one, self.samples) if s is not None])

    def error(self, estimate):
        """Yaw error of an estimate, rad."""
        return estimate.yaw - float(np.interp(estimate.t_ns * 1e-9, self.t, self.yaw))


def robot_drive(
    seed=0, seconds=60.0, bias=0.003, scale=1.35, gyro_hz=50, track_hz=20, compass_hz=10, camera_delay=0.0, eyes=None
):
    """Legs of 1 to 4 s, standing or turning at up to 1 rad/s while driving at 0.5 m/s.

    Gyro: white noise of 0.003 rad/s. Tracks: scale of 1.35, grip that strays by 2 % over half a second, encoder ticks.
    Compass: references held for 2 s, error of 5e-4 rad, half of its variance lasting for a second; images stamped
    `camera_delay` seconds after their exposure.
    """
    rng = np.random.default_rng(seed)
    rate, speed = legs(rng, round(HZ * seconds))
    hertz = gyro_hz, track_hz, compass_hz
    return sensed(rng, rate, speed, bias=bias, scale=scale, hertz=hertz, camera_delay=camera_delay, eyes=eyes)


@dataclass(frozen=True)
class Eyes:
    """A compass: how long it holds a reference, s, and its errors, rad.

    `noise` is white and known to it. What `lasts` is Gauss-Markov over `time` s; it is claimed in the variance as well
    where `claims_all`, or else left to the fusion's config.
    """

    hold: float = 2.0
    noise: float = 5e-4 * math.sqrt(0.5)
    lasts: float = 5e-4 * math.sqrt(0.5)
    time: float = 1.0
    claims_all: bool = True


def sensed(
    rng, rate, speed, *, bias=0.003, scale=1.35, hertz=(100, 40, 10), camera_delay=0.0, eyes=None, unseen=0.0,
    gyro_noise=0.003, gyro_scale=1.0, slip=0.02, veer=0.003, tick=TICK,
):  # fmt: skip
    """The drive at this turn rate and speed, each 1 ms (rad/s, m/s), as gyro, tracks and compass see it.

    `bias` of the gyro, rad/s, may be one for each 1 ms; of the tracks, `slip` is a share of what they turn and drive,
    `veer` the turn that they claim for each metre, rad, and `tick` that of an encoder count.
    `unseen` is a turn rate, rad/s each 1 ms, that the tracks do not see: of a robot that is lifted.
    """
    gyro_hz, track_hz, compass_hz = hertz
    n, true = rate.size, rate + unseen
    yaw, drift = np.concatenate([[0.0], np.cumsum(true[:-1]) / HZ]), np.broadcast_to(bias, n)
    samples = [
        GyroSample(int(j) * 10**6, float(gyro_scale * true[j] + drift[j] + gyro_noise * rng.normal()))
        for j in range(0, n, HZ // gyro_hz)
    ]
    grip = _gauss_markov(rng, n, 0.5) * slip
    claimed = np.concatenate([[0.0], np.cumsum(scale * rate * (1 + grip) + speed * (grip + veer))[:-1] / HZ])
    claimed = np.round(claimed[:: HZ // track_hz] / tick) * tick
    for k, turn in enumerate(np.diff(claimed, prepend=0.0)):
        j = k * (HZ // track_hz)
        samples.append(OdometrySample((j + 1) * 10**6, float(turn * track_hz), float(speed[j]), float(claimed[k])))
    samples += _increments(rng, yaw, HZ // compass_hz, round(camera_delay * HZ), eyes or Eyes())
    return RobotDrive(np.arange(n) / HZ, yaw, sorted(samples, key=lambda sample: sample.t_ns), camera_delay)


def legs(rng, n):
    rate, speed, i = np.zeros(n), np.zeros(n), 2 * HZ
    while i < n - 2 * HZ:
        leg = int(rng.uniform(1.0, 4.0) * HZ)
        if rng.integers(3):
            rate[i : i + leg], speed[i : i + leg] = rng.uniform(-1.0, 1.0), 0.5
        i += leg
    smooth = np.hanning(400) / np.hanning(400).sum()
    return np.convolve(rate, smooth, "same"), np.convolve(speed, smooth, "same")


def _gauss_markov(rng, n, time):
    keep = math.exp(-1.0 / (HZ * time))
    return lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(size=n))


def _increments(rng, yaw, step, late, eyes):
    out, reference = [], 17
    variance = eyes.noise**2 + (eyes.lasts**2 if eyes.claims_all else 0.0)
    lasting = _gauss_markov(rng, yaw.size, eyes.time)
    seen = np.concatenate([np.full(late, yaw[0]), yaw[: yaw.size - late]])
    for j in range(17 + step, yaw.size, step):
        error = eyes.lasts * lasting[j] + eyes.noise * rng.normal()
        turn = float(wrap_angle(seen[j] - seen[reference] + error))
        out.append(YawIncrement(reference * 10**6, j * 10**6, turn, variance, 0.9))
        if j - reference >= eyes.hold * HZ:
            reference = j
    return out


def fuse(drive, config=None):
    """The fusion after the drive, and its yaw errors (rad) every tenth of a second."""
    fusion, errors, due_ns = YawFusion(config), [], 0
    for sample in drive.samples:
        fusion.add(sample)
        if sample.t_ns >= due_ns:
            due_ns = sample.t_ns + 100_000_000
            errors.append(drive.error(fusion.estimate()))
    return fusion, np.array(errors)


def ratios_at_images(fusion, drive):
    """Error over sigma (0.02 deg at least) at each image, and the (code, sensor) of all warnings."""
    ratios, told = [], set()
    for sample in drive.samples:
        fusion.add(sample)
        if isinstance(sample, YawIncrement):
            estimate = fusion.estimate()
            sigma = max(math.sqrt(estimate.yaw_variance), math.radians(0.02))
            ratios.append(abs(drive.error(estimate)) / sigma)
            told |= {(one.code, one.sensor) for one in estimate.warnings}
    return np.array(ratios), told
