"""Which samples to believe: a chi-square gate per sensor with timed recovery."""

from __future__ import annotations

from enum import Enum

from fusion.record import record


class Verdict(Enum):
    """What became of a sample at the gate."""

    ACCEPTED = "accepted"
    REJECTED = "innovation outside the gate"
    RECOVERED = "outside the gate for so long that the filter gives way"


@record
class SensorReport:
    """How the last sample of one sensor fared.

    Attributes
    ----------
    t_ns : int
        Its stamp.
    innovation, innovation_sigma : float
        Measured minus expected, and the standard deviation it should have, in the sensor's unit (rad/s or rad).
    verdict : Verdict
        Whether it was used.
    accepted, rejected, recovered : int
        How many samples so far had each verdict.
    """

    t_ns: int
    innovation: float
    innovation_sigma: float
    verdict: Verdict
    accepted: int
    rejected: int
    recovered: int

    @property
    def nis(self) -> float:
        """Normalised innovation squared; averages 1 in a healthy filter."""
        return (self.innovation / self.innovation_sigma) ** 2


@record
class Gate:
    """State of one sensor's gate.

    Attributes
    ----------
    rejecting_since_ns : int or None
        Stamp of the first of the samples rejected in a row, None after an accepted one.
    accepted_ns : int or None
        Stamp of the last accepted sample.
    report : SensorReport or None
        On the last sample.
    """

    rejecting_since_ns: int | None = None
    accepted_ns: int | None = None
    report: SensorReport | None = None

    def refused_like(self, innovation: float) -> bool:
        """Whether the last sample was refused, and on the same side as one of this innovation would be."""
        return (
            self.rejecting_since_ns is not None
            and self.report is not None
            and self.report.innovation * innovation > 0.0
        )

    def judge(self, t_ns: int, innovation: float, S: float, limit: float, recovery_ns: int) -> Gate:
        """Next state of the gate after an innovation of variance `S`; its verdict is in the report."""
        since, accepted_ns = self.rejecting_since_ns, self.accepted_ns
        if innovation**2 <= limit * S:
            verdict, since, accepted_ns = Verdict.ACCEPTED, None, t_ns
        elif since is None or t_ns - since < recovery_ns:
            verdict, since = Verdict.REJECTED, t_ns if since is None else since
        else:
            verdict, since = Verdict.RECOVERED, None
        old = self.report
        accepted, rejected, recovered = (old.accepted, old.rejected, old.recovered) if old else (0, 0, 0)
        accepted += verdict is Verdict.ACCEPTED
        rejected += verdict is Verdict.REJECTED
        recovered += verdict is Verdict.RECOVERED
        return Gate(since, accepted_ns, SensorReport(t_ns, innovation, S**0.5, verdict, accepted, rejected, recovered))
