"""One fault on one drive: what the estimate was, how far off, what was said, and whether that passes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from robot_drive import RobotDrive

from fusion import YawPipeline
from torture.drives import DRIVES, SECONDS, WHO, Stream, drive, stream_of
from torture.rows import MAY, NAMED, NONE, Row

FLOOR = math.radians(0.02)  # rad; sigma below it is beyond what anybody needs
LEFT, FAR, FAR_FOR = 4.0, 3.0, 2.0  # sigmas never left, and left for at most so many seconds
ASKED = 0.1  # s between two looks at the warnings
AFTER = 3.0  # s after a fault's end in which a warning may still come
ELSEWHERE = 1.5  # s; an estimate for so other a time is compared with the truth of the present
ENDING = 1.0  # s
SHORTEST_NAMED = 2.0  # s; faults that last shorter need no warning


@dataclass
class Result:
    """Angles in deg, ratios of |error| over max(sigma, 0.02 deg), times in s.

    Attributes
    ----------
    error, sigma : float
        At the end: where sigma is least in the last second; between two images of a slow camera it grows.
    worst, ratio : float
        Largest |error| and ratio over all estimates.
    over3, over4 : float
        For how long the ratio was beyond.
    warnings : dict
        Seconds for which each ``code:sensor`` held.
    named_after : float or None
        From the beginning of the fault to the first warning that names a faulty sensor.
    faults : list of str
        Why it does not pass.
    notes : list of str
        What is odd, but passes.
    """

    row: Row
    drive: str
    seed: int
    error: float = math.nan
    sigma: float = math.nan
    worst: float = math.nan
    ratio: float = math.nan
    over3: float = 0.0
    over4: float = 0.0
    worst_at: float = 0.0
    warnings: dict[str, float] = field(default_factory=dict)
    named_after: float | None = None
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def try_row(row: Row, name: str, seed: int) -> Result:
    """Run a fault on a drive."""
    return try_on(row, drive(name, seed, row.since + 0.1 if row.lifted else None), name, seed)


def try_on(row: Row, ride: RobotDrive, name: str, seed: int) -> Result:
    """Run a fault on this drive."""
    stream = row.make()(ride, stream_of(ride, row.who), row.since, row.until)
    result = Result(row, name, seed)
    try:
        seen = _run(stream, result)
    except Exception as error:
        result.faults.append(f"raised {type(error).__name__}: {error}")
        return result
    _measure(result, np.array(seen), ride)
    _judge(result)
    return result


def _run(stream: Stream, result: Result) -> list[tuple[float, float, float, float]]:
    """Time of arrival and of the estimate, yaw and sigma after each sample; notes the warnings."""
    pipeline, seen, ask_ns = YawPipeline(), [], 0
    row, names = result.row, {WHO[letter].value for letter in result.row.faulty}
    for arrival, sample in stream:
        pipeline.add(sample)
        estimate = pipeline.estimate()
        if estimate is None:
            continue
        seen.append((arrival * 1e-9, estimate.t_ns * 1e-9, estimate.yaw, math.sqrt(max(estimate.yaw_variance, 0.0))))
        if arrival >= ask_ns:
            ask_ns = arrival + round(ASKED * 1e9)
            for warning in pipeline.warnings():
                key = f"{warning.code}:{warning.sensor}"
                result.warnings[key] = result.warnings.get(key, 0.0) + ASKED
                t = arrival * 1e-9
                if names & set(warning.sensors) and result.named_after is None and row.since <= t <= row.until + AFTER:
                    result.named_after = t - row.since
    return seen


def _measure(result: Result, seen: np.ndarray, ride: RobotDrive) -> None:
    now, t, yaw, sigma = seen.T
    at = np.where(np.abs(t - now) > ELSEWHERE, now, t)
    error = yaw - np.interp(at, ride.t, ride.yaw)
    if not np.isfinite(seen).all():
        result.faults.append("estimate not finite")
        return
    truth_sigma = np.interp(at, ride.t, np.broadcast_to(ride.truth_sigma, ride.t.shape))
    ratio = np.abs(error) / np.maximum(np.hypot(sigma, truth_sigma), FLOOR)
    ratio[(now >= result.row.since) & (now < result.row.since + result.row.blind)] = 0.0
    lasting = np.diff(now, append=now[-1])
    last = np.flatnonzero(now >= now[-1] - ENDING)
    end = last[sigma[last].argmin()]
    result.error, result.sigma = math.degrees(error[end]), math.degrees(sigma[end])
    result.worst, result.ratio = math.degrees(np.abs(error).max()), float(ratio.max())
    result.over3, result.over4 = (float(lasting[ratio > limit].sum()) for limit in (FAR, LEFT))
    result.worst_at = float(now[ratio.argmax()])


def _judge(result: Result) -> None:
    row, faults = result.row, result.faults
    if result.ratio > LEFT:
        faults.append(f"{result.ratio:.1f} sigma")
    elif result.over3 > FAR_FOR:
        faults.append(f"> 3 sigma for {result.over3:.1f} s")
    if result.sigma > row.most_sigma:
        faults.append(f"sigma {result.sigma:.1f} deg")
    if row.words == NONE and result.warnings:
        faults.append("false alarm")
    lasts = min(row.until, SECONDS) - row.since
    if row.words == NAMED and lasts >= SHORTEST_NAMED and result.named_after is None:
        faults.append("not named")
    named = {name for key in result.warnings for name in key.split(":")[1].split("+")}
    codes = {key.split(":")[0] for key in result.warnings}
    if row.codes and result.named_after is not None and not codes & set(row.codes):
        result.notes.append("other code")
    healthy = {WHO[letter].value for letter in row.who if letter not in row.faulty}
    alone = {key.split(":")[1] for key, seconds in result.warnings.items() if seconds >= SHORTEST_NAMED} & healthy
    if row.faulty and alone:
        result.notes.append(f"blames {', '.join(sorted(alone))}")
    elif row.words != MAY and named and not row.faulty:
        result.notes.append("says " + ", ".join(sorted(codes)))


__all__ = ["DRIVES", "Result", "try_on", "try_row"]
