"""Whether a gyro's axis is at its end stop, where it repeats its greatest value to the last bit."""

from __future__ import annotations

import math

_SMALLEST = math.radians(20.0)  # rad/s, the smallest full scale on the market
_RANGES = [math.radians(r) for r in (125.0, 250.0, 300.0, 450.0, 500.0, 1000.0, 2000.0)]  # usual full scales
_NEAR = 0.002  # of the full scale: 32767 steps of 1/16.4 deg/s end at 1998 deg/s
_RUN = 3  # equal values in a row; noise of three steps of the converter makes them once in a hundred
_NOISY = 0.2  # most repetitions of a gyro whose noise is seen; one without noise repeats each constant rate
_ENOUGH = 20  # samples to know that


class EndStop:
    """One axis. A gyro that repeats values anyway (a simulated one) is at an end stop only where parts usually have it.

    Attributes
    ----------
    value : float
        Where it stops, rad/s, as far as known; 0 before.
    """

    def __init__(self) -> None:
        self.value = 0.0
        self._last = math.nan
        self._run = self._samples = self._repeats = 0
        self._greatest = 0.0

    def reached(self, rate: float) -> bool:
        """Take in a sample, rad/s; whether the true rate may be anything beyond it."""
        size = abs(rate)
        self._run = self._run + 1 if rate == self._last else 1
        self._last = rate
        if self._run < _RUN:
            self._samples += 1
            self._repeats += self._run > 1
        noisy = self._samples >= _ENOUGH and self._repeats <= _NOISY * self._samples
        usual = any(abs(size / full - 1.0) < _NEAR for full in _RANGES)
        if self._run >= _RUN and size >= max(_SMALLEST, self._greatest) and (noisy or usual):
            self.value = size
        self._greatest = max(self._greatest, size)
        if size > (1.0 + _NEAR) * self.value:  # it goes further: no end stop
            self.value = 0.0
        return self.value > 0.0 and size >= (1.0 - _NEAR) * self.value
