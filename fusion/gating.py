"""Which samples to believe: a chi-square gate per sensor with timed recovery."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from scipy.special import chdtri

from fusion.config import FusionConfig


class Verdict(Enum):
    """What became of a sample at the gate."""

    ACCEPTED = "accepted"
    REJECTED = "innovation outside the gate"
    RECOVERED = "outside the gate for so long that it is believed again, with widened noise"


@dataclass(frozen=True, slots=True)
class SensorReport:
    """How the last sample of one sensor fared.

    Attributes
    ----------
    t_ns : int
        Its stamp.
    innovation, innovation_sigma : float
        Measured minus expected, and the standard deviation it should have, in the sensor's unit (rad/s or rad).
    nis : float
        Normalised innovation squared; averages 1 in a healthy filter.
    verdict : Verdict
        Whether it was used.
    accepted, rejected, recovered : int
        How many samples so far had each verdict.
    """

    t_ns: int
    innovation: float
    innovation_sigma: float
    nis: float
    verdict: Verdict
    accepted: int
    rejected: int
    recovered: int


@dataclass(frozen=True, slots=True)
class Gate:
    """State of one sensor's gate; `judge` gives the next state."""

    rejected_since_ns: int | None = None
    report: SensorReport | None = None

    def judge(
        self, t_ns: int, innovation: float, S: float, R: float, config: FusionConfig
    ) -> tuple[Gate, float | None]:
        """Judge an innovation of variance `S` and noise `R`; return the next gate and the noise to use (None: skip)."""
        limit = float(chdtri(1, 1.0 - config.gate_probability))
        nis = innovation**2 / S
        since = self.rejected_since_ns
        if nis <= limit:
            verdict, noise, since = Verdict.ACCEPTED, R, None
        else:
            since = t_ns if since is None else since
            if (t_ns - since) * 1e-9 >= config.recovery_time:
                # widened so that the innovation lies exactly on the gate
                verdict, noise = Verdict.RECOVERED, R + innovation**2 / limit - S
            else:
                verdict, noise = Verdict.REJECTED, None
        old = self.report
        counts = (old.accepted, old.rejected, old.recovered) if old else (0, 0, 0)
        a, r, c = (n + (verdict is v) for n, v in zip(counts, Verdict, strict=True))
        return Gate(since, SensorReport(t_ns, innovation, S**0.5, nis, verdict, a, r, c)), noise
