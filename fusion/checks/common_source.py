"""Whether the odometry takes its turns from the gyro: then the two are one sensor, and their agreement proves nothing.

Many drivers publish an odometry that is fused with the IMU already. Whatever a gyro errs by, such an odometry errs by
as well, and outvotes a sound camera. Two sensors of their own differ by the noise of the gyro at least, which adds up
over time, and tracks by slip and encoder ticks besides: an odometry that follows the gyro more closely has it inside.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from compass import wrap_angle
from fusion.checks.silence import RATE_SILENT_NS
from fusion.checks.warnings import Warning
from fusion.record import record, replace
from fusion.samples import OdometrySample

SPACING_NS = 250_000_000  # between two points that are compared; not derived
# Points: enough to doubt that the two are others, to be sure, and as many as a gyro's scale factor stays the same over.
DOUBTED, FEWEST, MOST = 7, 16, 60
ALIKE = 0.05  # by which the two differ as a factor; tracks of their own differ by their scale; not derived
# What a scale, a bias and a delay leave of the difference, over what the gyro's noise would: below `ONE` they are one,
# below `DOUBT` they seem so, beyond `TWO` they are not any more. The gyro's integral: mostly below 0.1; wheels
# that slip by 0.1 %, with ticks of 1.25 mrad: from 1.2; wheels without any error: 0.5 to 1.2.
ONE, DOUBT, TWO = 0.3, 0.5, 3.0
DETRENDED = 15.0  # a random walk less its straight line has a fifteenth of its last variance on average
THIRD = 20.0  # times the variance of white noise has its third difference, in which a turn cancels
LOUDEST = 4.0  # times the known variance; a third difference beyond is no noise, but a start
# rad/s; IMUs of robots scatter by more. A quieter gyro is a simulated one, and odometry without any error is as near.
QUIETEST = 5e-4


class Point(NamedTuple):
    """Time (s) and what the two have turned by since they were first compared, rad; the gyro's rate and noise then.

    `quiet`: what that noise would be of the quietest gyro, rad^2.
    """

    t: float
    gyro: float
    tracks: float
    rate: float
    noise: float
    quiet: float


@record
class CommonSource:
    """What gyro and odometry claim side by side, as they come.

    Attributes
    ----------
    points : tuple of Point
        The last ones, `SPACING_NS` apart.
    gyro_ns : int or None
        Stamp of the newest gyro sample.
    rates : tuple of float
        Of the gyro's last samples, rad/s, the newest last.
    angle, noise, quiet : float
        Integral of its rate, rad, and the variance that its noise gives to that, as its samples scatter, rad^2; and
        what that would be of the quietest gyro.
    odometry : OdometrySample or None
        The newest.
    turned : float
        By the odometry, rad.
    waiting : (int, float) or None
        Stamp and turn of an odometry sample for which the gyro's next one is needed.
    doubted : bool
        Whether the two seem to be one.
    since_ns : int or None
        Since when they are known to be one; None: they are not.
    """

    points: tuple[Point, ...] = ()
    gyro_ns: int | None = None
    rates: tuple[float, ...] = ()
    angle: float = 0.0
    noise: float = 0.0
    quiet: float = 0.0
    odometry: OdometrySample | None = None
    turned: float = 0.0
    waiting: tuple[int, float] | None = None
    doubted: bool = False
    since_ns: int | None = None

    def with_gyro(self, t_ns: int, rate: float, sigma: float) -> CommonSource:
        """After a gyro sample (rad/s) and the standard deviation that its noise has at most."""
        if self.gyro_ns is None or t_ns - self.gyro_ns > RATE_SILENT_NS:
            return replace(self, points=(), gyro_ns=t_ns, rates=(rate,), waiting=None)
        known, seconds, rates, scatter = self, (t_ns - self.gyro_ns) * 1e-9, self.rates, 0.0
        if self.waiting is not None and t_ns >= self.waiting[0]:
            known = self._compared(*self.waiting, rate, seconds)
        if len(rates) == 3:
            third = rate - 3.0 * (rates[2] - rates[1]) - rates[0]
            scatter, rates = min(third * third / THIRD, LOUDEST * sigma * sigma), rates[1:]
        return CommonSource(
            known.points,
            t_ns,
            (*rates, rate),
            self.angle + 0.5 * (self.rates[-1] + rate) * seconds,
            self.noise + scatter * seconds * seconds,
            self.quiet + (QUIETEST * seconds) ** 2,
            self.odometry,
            self.turned,
            known.waiting,
            known.doubted,
            known.since_ns,
        )

    def _compared(self, t_ns: int, turned: float, rate: float, seconds: float) -> CommonSource:
        """With an odometry sample between the last gyro sample and the next one, of this rate so much later."""
        within, before = (t_ns - (self.gyro_ns or t_ns)) * 1e-9, self.rates[-1]
        at = before + (rate - before) * within / seconds if seconds > 0.0 else rate
        point = Point(t_ns * 1e-9, self.angle + 0.5 * (before + at) * within, turned, at, self.noise, self.quiet)
        points, since_ns, doubted = (*self.points, point)[-MOST:], self.since_ns, self.doubted
        if len(points) >= DOUBTED:
            factor, ratio = compared(points)
            doubted = ratio < DOUBT and abs(factor - 1.0) < ALIKE
            if doubted and ratio < ONE and since_ns is None and len(points) >= FEWEST:
                since_ns = t_ns
            elif ratio > TWO:
                since_ns = None
        return replace(self, points=points, waiting=None, doubted=doubted, since_ns=since_ns)

    def with_tracks(self, sample: OdometrySample) -> CommonSource:
        """After an odometry sample; by its poses where it has any."""
        last, points, turned, waiting = self.odometry, self.points, self.turned, self.waiting
        if last is None or sample.t_ns - last.t_ns > RATE_SILENT_NS:
            points, waiting = (), None
        elif sample.yaw is not None and last.yaw is not None:
            turned += float(wrap_angle(sample.yaw - last.yaw))
        else:
            turned += 0.5 * (last.yaw_rate + sample.yaw_rate) * (sample.t_ns - last.t_ns) * 1e-9
        # tracks that stand say nothing of where they have their turns from
        due = not points or (sample.t_ns - round(points[-1].t * 1e9) >= SPACING_NS and turned != points[-1].tracks)
        if due and waiting is None and self.gyro_ns is not None and sample.t_ns >= self.gyro_ns:
            waiting = sample.t_ns, turned
        return CommonSource(
            points,
            self.gyro_ns,
            self.rates,
            self.angle,
            self.noise,
            self.quiet,
            sample,
            turned,
            waiting,
            self.doubted,
            self.since_ns,
        )

    @property
    def one(self) -> bool | None:
        """Whether the two are one; None where it only seems so."""
        return True if self.since_ns is not None else None if self.doubted else False

    @property
    def seconds(self) -> float:
        """How long they have been compared."""
        return self.points[-1].t - self.points[0].t if self.points else 0.0

    def warnings(self) -> tuple[Warning, ...]:
        """That the odometry is no sensor of its own."""
        if self.since_ns is None:
            return ()
        text = (
            "the odometry follows the gyro more closely than the gyro's own noise allows: it is fused with the IMU"
            " already, and is left out, as it errs as the gyro does; give the odometry of the wheels or tracks alone"
        )
        return (Warning("odometry_not_independent", "tracks", self.since_ns, text),)


def compared(points: tuple[Point, ...]) -> tuple[float, float]:
    """Factor between the turns of the two, and what is left by it, a bias and a delay, in units of the gyro's noise."""
    t, gyro, tracks, rate, noise, quiet = (np.array(column) for column in zip(*points, strict=True))
    A = np.stack([gyro - gyro[0], t - t[0], np.ones_like(t), rate], axis=1)
    fitted, *_ = np.linalg.lstsq(A, tracks - tracks[0], rcond=None)
    left = tracks - tracks[0] - A @ fitted
    expected = float(noise[-1] - noise[0]) / DETRENDED
    if noise[-1] - noise[0] <= quiet[-1] - quiet[0]:
        return float(fitted[0]), math.inf
    return float(fitted[0]), math.sqrt(float(left @ left) / (len(points) - 4) / expected)
