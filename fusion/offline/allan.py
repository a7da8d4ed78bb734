"""Noise of a gyro that stands still: Allan deviation, and the noise density, bias instability and random walk in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from compass.errors import VisualCompassError
from fusion.offline.streams import Floats, Times

SHORTEST_S = 60.0  # of a recording; the noise density is good to some per cent by then
MOST_OF_IT = 10.0  # the recording lasts at least so many of the longest averaging time, which is then good to a quarter
LONGEST_GAP = 3.0  # sample intervals; a longer one ends a stretch
FLICKER = math.sqrt(
    2.0 * math.log(2.0) / math.pi
)  # Allan deviation of flicker noise of instability 1 (IEEE Std 952, C.1)
NOISIEST = 0.01  # rad/s between means over neighbouring seconds; the worst gyros of phones have a twentieth of it
MOVED = 8.0  # standard deviations between neighbouring seconds; of a million normal ones, none is beyond 5


class AllanError(VisualCompassError):
    """A recording that does not tell the noise of a standing sensor."""


@dataclass(frozen=True, slots=True)
class AllanCurve:
    """Noise of one axis.

    Attributes
    ----------
    tau : (N,) array
        Averaging times, s.
    deviation : (N,) array
        Overlapping Allan deviation at these, in the unit of the samples.
    density : float
        Of the white noise, unit/sqrt(Hz): the deviation of means over 1 s.
    instability : float or None
        Of the bias: the lowest deviation over `FLICKER`; None where the curve still falls at its end, so the recording
        is too short to see it.
    random_walk : float or None
        Of the bias, unit/s/sqrt(Hz): its standard deviation after one second; None where none shows.
    """

    tau: Floats
    deviation: Floats
    density: float
    instability: float | None
    random_walk: float | None

    @property
    def walk_bound(self) -> float:
        """The largest random walk for which the curve has room, unit/s/sqrt(Hz): it alone, at some averaging time."""
        return float(np.min(self.deviation * np.sqrt(3.0 / self.tau)))


def longest_stretch(t_ns: Times) -> tuple[slice, float]:
    """The longest part of sorted stamps without a gap, and its rate, Hz.

    Raises
    ------
    AllanError
        It is shorter than `SHORTEST_S`.
    """
    steps = np.diff(t_ns)
    typical = float(np.median(steps)) if steps.size else 0.0
    ends = np.concatenate([[-1], np.flatnonzero(steps > LONGEST_GAP * max(typical, 1.0)), [t_ns.size - 1]])
    longest = int(np.argmax(np.diff(ends)))
    part = slice(int(ends[longest]) + 1, int(ends[longest + 1]) + 1)
    count = part.stop - part.start
    seconds = float(t_ns[part.stop - 1] - t_ns[part.start]) * 1e-9 if count > 1 else 0.0
    if seconds < SHORTEST_S:
        raise AllanError(
            f"{seconds:.0f} s without a gap; record {SHORTEST_S:.0f} s and more of the standing robot, an hour to see "
            "the bias wander"
        )
    return part, (count - 1) / seconds


def check_standing(rates: Floats, rate_hz: float) -> None:
    """Raise `AllanError` where turn rates (N, K), rad/s, are not those of a sensor that stands.

    Means over neighbouring seconds differ by noise alone then, and alike all the time. A turn at one and the same rate
    from the first to the last sample is not noticed: that is what a bias looks like.
    """
    per_second = max(1, round(rate_hz))
    means = rates[: len(rates) // per_second * per_second].reshape(-1, per_second, rates.shape[1]).mean(axis=1)
    changes = np.abs(np.diff(means, axis=0))
    usual = 1.4826 * np.median(changes, axis=0)  # of normal ones, from the median of their magnitudes
    if (usual > NOISIEST).any():
        raise AllanError(
            f"it turns all the time, by {math.degrees(float(usual.max())):.2g} deg/s from second to second"
        )
    beyond = changes > np.maximum(MOVED * usual, 1e-9)
    if beyond.any():
        second = int(np.flatnonzero(beyond.any(axis=1))[0]) + 1
        raise AllanError(f"it moved {second} s from the start; cut that off, or record the robot standing still")


def allan_curve(samples: Floats, rate_hz: float) -> AllanCurve:
    """Allan deviation of samples (N,) at `rate_hz`, and the noises in it.

    The variance is fitted as ``N^2 / tau + F + K^2 tau / 3``, `F` of flicker (IEEE Std 952-1997, annex C), none of them
    negative, each point by its relative error, which falls with the number of intervals that fit into the recording.

    Raises
    ------
    AllanError
        allantools is not installed, or the samples never change.
    """
    try:
        import allantools
    except ImportError:
        raise AllanError("allantools is not installed: pip install 'visual-compass[tuning]'") from None
    if np.ptp(samples) == 0.0:
        raise AllanError("it says one and the same number all the time: simulated, switched off, or filtered")
    seconds = samples.size / rate_hz
    wanted = np.geomspace(2.0 / rate_hz, seconds / MOST_OF_IT, 40)
    tau, deviation, _, _ = allantools.oadev(samples - samples.mean(), rate=rate_hz, data_type="freq", taus=wanted)
    variance = deviation**2
    weight = np.sqrt(seconds / tau) / variance
    terms = np.stack([1.0 / tau, np.ones(tau.size), tau / 3.0], axis=1)
    fitted, _ = optimize.nnls(  # type: ignore[attr-defined, unused-ignore]
        terms * weight[:, None], variance * weight
    )
    lowest = int(np.argmin(deviation))
    # a walk shows where it makes up half of the variance somewhere within the curve
    shows = bool((fitted[2] * terms[:, 2] > 0.5 * terms @ fitted).any())
    return AllanCurve(
        tau,
        deviation,
        math.sqrt(fitted[0]),
        float(deviation[lowest]) / FLICKER if lowest < tau.size - 1 else None,
        math.sqrt(fitted[2]) if shows else None,
    )
