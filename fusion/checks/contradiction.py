"""Whether what two sensors say of a window can both be right."""

from __future__ import annotations

import math

from fusion.checks.windows import Claim

# Not derived: `GROSS`, `CONTRADICTION_SIGMAS`, `CONTRADICTION_SCALE_SIGMAS`.
GROSS = 0.02  # rad/s; smaller contradictions are for the filter's gates to settle
CONTRADICTION_SIGMAS = 5.0  # standard deviations of a contradiction
AGREEMENT_SIGMAS = 3.0  # within which two that agree are, but for one window in 370
CONTRADICTION_SCALE_SIGMAS = 2.5  # of scale factors: theirs are no normal distributions, none is negative


def limit(one: Claim, other: Claim, seconds: float) -> float:
    """By how much two claims may differ before they contradict, rad; no scale factor makes a turn of none."""
    noise = math.hypot(max(one.noise, one.at_worst), max(other.noise, other.at_worst))
    scale = math.hypot(one.scale, other.scale) * min(abs(one.turn), abs(other.turn))
    return max(GROSS * seconds, CONTRADICTION_SIGMAS * noise + CONTRADICTION_SCALE_SIGMAS * scale)


def contradict(one: Claim | None, other: Claim | None, seconds: float) -> bool:
    """Whether two sensors cannot both be right."""
    return bool(one and other and abs(one.turn - other.turn) > limit(one, other, seconds))
