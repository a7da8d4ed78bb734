"""Whether a gyro's axis is at its end stop, where it repeats its greatest value to the last bit."""

from __future__ import annotations

import math

_SMALLEST = math.radians(20.0)  # rad/s, the smallest full scale on the market
_RANGES = [math.radians(r) for r in (125.0, 250.0, 300.0, 450.0, 500.0, 1000.0, 2000.0)]  # usual full scales
_NEAR = 0.002  # of the full scale: 32767 steps of 1/16.4 deg/s end at 1998 deg/s
# Not derived: `_RUN`, `_ENOUGH`.
_RUN = 3  # equal values in a row
_REPEATS = 0.2  # of the samples, at most, are equal to the one before: noise of 1.5 steps of the converter and more
# Of the samples, at least, whose acceleration changes to and fro: 0.7 of white noise however the robot turns, few of
# smooth motion. Less than `_ROUNDING`, rad/s, is that of floats.
_NOISY, _ROUNDING = 0.25, 1e-9
_ENOUGH = 50  # samples to know that


class EndStop:
    """One axis. A gyro without noise repeats every constant rate: its end stop can only be at a usual full scale.

    Attributes
    ----------
    value : float
        Where it stops, rad/s, as far as known; 0 before.
    """

    def __init__(self) -> None:
        self.value = 0.0
        self._last = self._step = self._bend = math.nan
        self._run = self._samples = self._repeats = self._reversals = 0
        self._greatest = 0.0

    def reached(self, rate: float) -> bool:
        """Take in a sample, rad/s; whether the true rate may be anything beyond it."""
        size, step = abs(rate), rate - self._last
        bend = step - self._step
        self._run = self._run + 1 if step == 0.0 else 1
        if self._run == 1 or size < self._greatest:  # not where it may be at the stop
            self._samples += 1
            self._repeats += step == 0.0
            self._reversals += bend * self._bend < 0.0 and abs(bend) > _ROUNDING
        self._last, self._step, self._bend = rate, step, bend
        self._greatest = max(self._greatest, size)
        if self._run >= _RUN and size >= max(_SMALLEST, self._greatest):
            self.value = size
        if size > (1.0 + _NEAR) * self.value or not (self._noisy or _usual(self.value)):
            self.value = 0.0  # it goes further, or repeats itself anyway: no end stop
        return self.value > 0.0 and size >= (1.0 - _NEAR) * self.value

    @property
    def _noisy(self) -> bool:
        """Whether the gyro's noise is seen, and is not lost in the steps of its converter."""
        enough, few = self._reversals >= _NOISY * self._samples, self._repeats <= _REPEATS * self._samples
        return self._samples >= _ENOUGH and enough and few


def _usual(size: float) -> bool:
    """Whether parts have such a full scale, rad/s."""
    return any(abs(size / full - 1.0) < _NEAR for full in _RANGES)
