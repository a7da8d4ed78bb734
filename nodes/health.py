"""How a sensor's stream fares: rate, silence, share of messages that could be used. No ROS in here."""

from __future__ import annotations

import math
from enum import IntEnum

_UNUSABLE_SHARE = 0.1  # of a period's messages; more than this is worth a warning


class Level(IntEnum):
    """Severity, numbered as in ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class StreamHealth:
    """Counts what came and what of it was used, and judges it period by period.

    Attributes
    ----------
    received, used, refused : int
        Messages so far, how many of them became part of a result, and how many the filter's gate refused.
    stamp_ns : int or None
        Stamp of the newest used message, ns.
    """

    def __init__(self) -> None:
        self.received = 0
        self.used = 0
        self.refused = 0
        self.stamp_ns: int | None = None
        self._received_at = -math.inf
        self._used_at = -math.inf
        self._refused_at = -math.inf
        self._period: tuple[float, int, int, int] | None = None  # time, received, used and refused at its start

    def receive(self, now: float) -> None:
        """Note a message that arrived at `now`, monotonic seconds."""
        self.received += 1
        self._received_at = now

    def use(self, now: float, stamp_ns: int) -> None:
        """Note that a message was used."""
        self.used += 1
        self._used_at = now
        self.stamp_ns = stamp_ns

    def refuse(self, now: float) -> None:
        """Note that the filter's gate refused a message."""
        self.refused += 1
        self._refused_at = now

    def alive(self, now: float, timeout: float) -> bool:
        """Whether a message was used within the last `timeout` seconds."""
        return now - self._used_at <= timeout

    def judge(self, now: float, timeout: float) -> tuple[Level, str, dict[str, str]]:
        """Level, reason and figures of the period since the last call; silent for `timeout` seconds means stale."""
        since, received, used, refused = self._period or (now, 0, 0, 0)
        self._period = (now, self.received, self.used, self.refused)
        came, served = self.received - received, self.used - used
        rate = came / (now - since) if now > since else math.nan
        level, reason = self._level(now, timeout, came, served, self.refused - refused)
        silence = now - self._received_at
        return level, reason, {
            "rate [Hz]": f"{rate:.1f}",
            "silent for [s]": f"{silence:.2f}" if math.isfinite(silence) else "ever",
            "received": str(self.received),
            "used": str(self.used),
            "refused at the gate": str(self.refused),
        }  # fmt: skip

    def _level(self, now: float, timeout: float, came: int, served: int, refused: int) -> tuple[Level, str]:
        if not self.received:
            return Level.STALE, "nothing received yet"
        if now - self._received_at > timeout:
            return Level.STALE, f"silent for {now - self._received_at:.1f} s"
        if not self.alive(now, timeout):
            if now - self._refused_at <= timeout:
                return Level.WARN, "messages come, the filter's gate refuses them all"
            return Level.ERROR, "messages come, none can be used"
        if came - served > _UNUSABLE_SHARE * came + 1.0:  # one may be under way
            gate = f", {refused} refused at the filter's gate" if refused else ""
            return (
                Level.WARN,
                f"{came - served} of {came} messages ({100.0 * (came - served) / came:.0f} %) not used{gate}",
            )
        return Level.OK, "OK"


class SequenceGaps:
    """Counts the gaps in the sequence numbers of messages, where they are known to be one publisher's.

    Attributes
    ----------
    skipped : int
        Messages of one publisher that were never taken out of the queue: lost, or overtaken in it.
    """

    _LONGEST = 1000  # a longer gap is another publisher

    def __init__(self) -> None:
        self.skipped = 0
        self._unsettled = 0
        self._steps_back = 0
        self._last: int | None = None

    def see(self, number: int | None) -> None:
        """Note the sequence number of a message that arrived; None where the middleware gives none."""
        if number is not None and self._last is not None:
            step = number - self._last
            self._steps_back += step < 0
            if 0 < step <= self._LONGEST:
                self._unsettled += step - 1
        self._last = number

    def settle(self, single: bool) -> None:
        """Count the gaps since the last call, if there was a `single` publisher in all that time."""
        if single and not self._steps_back:
            self.skipped += self._unsettled
        self._unsettled = 0

    def take_steps_back(self) -> int:
        """How often the numbers went back since the last call: once for a restart, many times for two publishers."""
        steps, self._steps_back = self._steps_back, 0
        return steps
