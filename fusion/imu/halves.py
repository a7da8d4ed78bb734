"""Messages that bring only the gyro or only the accelerometer, zeros standing for the other."""

from __future__ import annotations

_LONGEST_RUN = 10  # messages between two with a gyro; drivers send one to four accelerations for each
_CERTAIN = 6  # changes from one half to the other; a robot that pulls up once makes one or two


class Halves:
    """Distinguishes a gyro that measures exactly zero from a message that carries none.

    A simulated gyro at rest, or a stuck one, says zero beside an accelerometer that says gravity; but then that
    accelerometer does not fall silent, to the last bit, whenever the gyro speaks. One message that brings both ends it.

    Attributes
    ----------
    changes : int
        How often the halves have taken turns.
    """

    def __init__(self) -> None:
        self.changes = 0
        self._since_gyro = _LONGEST_RUN  # messages
        self._last_gyro: bool | None = None

    @property
    def certain(self) -> bool:
        """Whether the messages come in halves."""
        return self.changes >= _CERTAIN

    def carries_gyro(self, rate: bool, force: bool) -> bool:
        """Whether a message carries a gyro's sample; `rate`, `force`: whether these are other than exactly zero."""
        if rate and force:
            self.changes, self._since_gyro, self._last_gyro = 0, _LONGEST_RUN, None
            return True
        if rate != force:
            self.changes += self._last_gyro is not None and self._last_gyro != rate
            self._last_gyro = rate
        self._since_gyro = 0 if rate else self._since_gyro + 1
        if rate:
            return True
        return self._since_gyro > _LONGEST_RUN or not (force or self.certain)
