"""Whether a sensor that erred is well again.

A fault that is little more than the noise hides in it now and then, so one window that agrees is not enough. Two
hypotheses are weighed over the windows in which the fault would show, that it errs on by as much as before and that it
does not, and their likelihood ratio starts anew wherever it has come to nothing: a CUSUM test (Page 1954,
doi:10.1093/biomet/41.1-2.100).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

WELL = 2.0 * math.log(1000.0)  # a thousand times likelier to be well than to err on: this is asked twice a second
TINY = 1e-12  # rad^2, so that claims without any error do not divide by zero


@dataclass(frozen=True, slots=True)
class Recovery:
    """What a sensor erred by, and what the windows since say.

    Attributes
    ----------
    squares, windows : float, int
        Sum of the squared rates by which it erred, (rad/s)^2, and in how many windows.
    odds : float
        Twice the logarithm of how much likelier it is, since it last erred, that it is well; at least 0.
    """

    squares: float
    windows: int = 1
    odds: float = 0.0

    @staticmethod
    def begun(rate: float) -> Recovery:
        """After the first window, in which it erred by `rate`, rad/s."""
        return Recovery(rate**2)

    @property
    def well(self) -> bool:
        """Whether it is well again."""
        return self.odds >= WELL

    def erred(self, rate: float) -> Recovery:
        """After one more window in which it erred by `rate`, rad/s."""
        return Recovery(self.squares + rate**2, self.windows + 1)

    def weighed(
        self, off: float, variance: float, seconds: float, share: float = 1.0, most: float = math.inf
    ) -> Recovery:
        """After a window in which it was `off` by so much, rad, of this variance, rad^2.

        `off` is positive to the side to which it erred, if it always erred to one. `share`: of what it erred by before,
        that would show in this window if it erred on; `most`: what can show in it at most, rad/s.
        """
        errs = min(share * math.sqrt(self.squares / self.windows), most) * seconds
        odds = self.odds + errs * (errs - 2.0 * off) / (variance + TINY)
        return Recovery(self.squares, self.windows, odds) if odds > 0.0 else self.erred(off / seconds)
