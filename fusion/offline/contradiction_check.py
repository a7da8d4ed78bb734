"""Whether the compass's turns are those of the gyro and the tracks: no settings come out of a contradiction."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fusion.offline.run import FusedRun
from fusion.offline.scores import GYRO, TRACKS, YawTrack, gyro_alone, tracks_alone, yaw_at

_SEGMENT_NS = 1_000_000_000  # long beside a camera's delay, short beside a gyro's drift
_TURNING = math.radians(3.0)  # in a segment; a gyro's bias of 0.01 rad/s makes 0.6 deg
LEAST = math.radians(120.0)  # of turning, all segments together
# What the compass may turn over what the others claim. A robot in its view, for which calibration is there, draws it
# down (a body in 40 % of the region: 0.88); panoramas of three quarters of the circle are 1.33. Tracks claim from half
# the true turn to three times as much.
_BOUNDS = {GYRO: (0.5, 1.15), TRACKS: (0.25, 2.0)}
_ALIKE = 0.9  # least correlation with the compass's turns; tracks that slip keep to 0.95


# Warnings of a run that leave nothing to calibrate from.
_FATAL = ("clock_mismatch", "sensors_disagree_sign", "images_mirrored", "images_do_not_turn", "not_full_circle")


@dataclass(frozen=True, slots=True)
class Claim:
    """Turns of the compass beside those of another sensor, in the seconds in which either turned.

    Attributes
    ----------
    compass, other : float
        Sums of the magnitudes, rad.
    ratio : float
        The compass's turns over the other's, least squares.
    correlation : float
        Of the two, -1..1.
    """

    compass: float
    other: float
    ratio: float
    correlation: float


def contradiction(run: FusedRun) -> str | None:
    """Say in one line how the compass contradicts the gyro or the tracks, None where it does not."""
    warnings = [warned.warning for warned in run.warnings]
    fatal = next((warning.text for warning in warnings if warning.code in _FATAL), None)
    return fatal or _compared(run)


def _compared(run: FusedRun) -> str | None:
    others = {}
    if run.gyro.t_ns.size:
        rate = np.where(np.isfinite(run.gyro.yaw_rate), run.gyro.yaw_rate, 0.0)
        others[GYRO] = gyro_alone(replace(run.gyro, yaw_rate=rate))
    if run.odometry.t_ns.size:
        others[TRACKS] = tracks_alone(run.odometry)
    if not others:
        return "neither gyro nor tracks in it; the compass needs another witness to be calibrated"
    segments = list(_segments(run))
    if not segments:
        images = sum(row.compass is not None for row in run.rows)
        return f"the compass measured no second on end in {images} images; `visual-compass fuse` counts why"
    for name, track in others.items():
        word = name.removesuffix(" alone")
        if not _common(segments, track):
            return f"the compass's turns and the {word}'s stamps have no second in common; calibration needs both"
    claims = {name: _claim(_common(segments, track), track) for name, track in others.items()}
    turning = max(max(claim.compass, claim.other) for claim in claims.values())
    if turning < LEAST:
        seen = f"{math.degrees(turning):.0f} deg of turning seen by the compass beside another sensor"
        return f"{seen}; calibration needs {math.degrees(LEAST):.0f} and more, best a full turn"
    for name, claim in claims.items():
        low, high = _BOUNDS[name]
        if not (low <= claim.ratio <= high and claim.correlation >= _ALIKE):
            return _words(claims, name)
    return None


def _segments(run: FusedRun) -> Iterator[tuple[int, int, float]]:
    """Stretches of a second and more in which the compass measured at every image: start and end, ns; its turn, rad."""
    start = None
    for row in run.rows:
        if row.compass is None:
            continue
        if not math.isfinite(row.compass.yaw):
            start = None
        elif start is None:
            start = row.t_ns, row.compass.yaw
        elif row.t_ns - start[0] >= _SEGMENT_NS:
            yield start[0], row.t_ns, row.compass.yaw - start[1]
            start = row.t_ns, row.compass.yaw


def _common(segments: list[tuple[int, int, float]], track: YawTrack) -> list[tuple[int, int, float]]:
    """Those within the time of another sensor."""
    first, last = int(track.t_ns[0]), int(track.t_ns[-1])
    return [segment for segment in segments if first <= segment[0] and segment[1] <= last]


def _claim(segments: list[tuple[int, int, float]], track: YawTrack) -> Claim:
    """What the compass and another sensor say of the same seconds."""
    start, end, compass = (np.array(values) for values in zip(*segments, strict=True))
    other = yaw_at(track, end) - yaw_at(track, start)
    turning = np.maximum(np.abs(compass), np.abs(other)) > _TURNING
    compass, other = compass[turning], other[turning]
    both, power, own = float(compass @ other), float(other @ other), float(compass @ compass)
    return Claim(
        float(np.abs(compass).sum()),
        float(np.abs(other).sum()),
        both / power if power else math.inf,
        both / math.sqrt(power * own) if power and own else 0.0,
    )


def _words(claims: Mapping[str, Claim], wrong: str) -> str:
    """What each claims, and what may be the matter."""
    claim, word = claims[wrong], {GYRO: "gyro", TRACKS: "track odometry"}[wrong]
    factors = ", ".join(
        f"{math.degrees(one.compass):.0f} deg by the compass and {math.degrees(one.other):.0f} deg by the"
        f" {name.removesuffix(' alone')} (ratio {one.ratio:.2g}, correlation {one.correlation:.2g})"
        for name, one in claims.items()
    )
    if claim.compass < 0.2 * claim.other:
        guess = f"panoramas that do not turn with the robot, or a {word} in deg/s?"
    elif claim.correlation < -0.5:
        guess = "mirrored or upside-down panoramas, or a sensor of the wrong sign?"
    elif claim.other < 0.2 * claim.compass:
        guess = f"a {word} that does not measure turns?"
    else:
        guess = "panoramas of less than the full circle, or a sensor in other units or of another clock?"
    return f"turns contradict each other: {factors}; {guess} `visual-compass fuse` says more; nothing was calibrated"
