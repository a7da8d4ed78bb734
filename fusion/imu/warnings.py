"""What is wrong with an IMU at present, in words."""

from __future__ import annotations

from collections.abc import Callable

from fusion.checks.warnings import Warning

# Not derived: `SETTLE_NS`, `REMEMBERED_NS`.
SETTLE_NS = 1_000_000_000  # a state that lasts for less is a start, not a fault
REMEMBERED_NS = 10_000_000_000  # an event is present for so long after it came last
_EVENTS = 5  # single nonsense is refused and counted elsewhere


class Complaints:
    """Warnings of one IMU; each stays as long as what it says, with the words it had when it came up.

    Attributes
    ----------
    present : tuple of Warning
        In the order in which they came up.
    """

    def __init__(self) -> None:
        self.present: tuple[Warning, ...] = ()
        self._since_ns: dict[str, int] = {}
        self._events: dict[str, tuple[int, int, int]] = {}  # first and last stamp, number

    def state(self, code: str, t_ns: int, wrong: bool, words: Callable[[], str]) -> None:
        """Say whether something is wrong at a stamp, ns; once it has been for `SETTLE_NS`, it is a warning."""
        if not wrong:
            if self._since_ns.pop(code, None) is not None:
                self.present = tuple(one for one in self.present if one.code != code)
            return
        since_ns = min(self._since_ns.setdefault(code, t_ns), t_ns)
        if t_ns - since_ns >= SETTLE_NS and not any(one.code == code for one in self.present):
            self._add(code, since_ns, words())

    def event(self, code: str, t_ns: int, happened: bool, words: Callable[[], str]) -> None:
        """Say whether something happened at a stamp, ns; once it has `_EVENTS` times, it is a warning for a while."""
        first, last, number = self._events.get(code, (t_ns, t_ns, 0))
        if happened:
            self._events[code] = first, t_ns, number + 1
            if number + 1 >= _EVENTS and not any(one.code == code for one in self.present):
                self._add(code, first, words())
        elif number and t_ns - last > REMEMBERED_NS:
            del self._events[code]
            self.present = tuple(one for one in self.present if one.code != code)

    def _add(self, code: str, since_ns: int, text: str) -> None:
        self.present = (*self.present, Warning(code, "gyro", since_ns, text))
