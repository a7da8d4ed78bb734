"""What can go wrong with images: what the compass says of them, see `torture.changes`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from robot_drive import RobotDrive

from compass import YawIncrement, wrap_angle
from torture.changes import Change, S, chain, each, silent
from torture.drives import Stream


def increments(change: Callable[[RobotDrive, YawIncrement, float, float, float, float], Any]) -> Change:
    """Change increments from `since` on: of drive, increment, its reference and end, since and until, s."""

    def whole(ride: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        def one(s: YawIncrement, t: float) -> Any:
            return change(ride, s, s.t_ref_ns * 1e-9, t, since, until)

        return each("C", one)(ride, stream, since, until)

    return whole


def turned_by(s: YawIncrement, angle: float) -> YawIncrement:
    return replace(s, yaw=float(wrap_angle(s.yaw + angle)))


def crowd(rate: float) -> Change:
    """People that walk round the robot one way: what is seen between two images turns with them."""
    return increments(lambda ride, s, ref, t, since, until: turned_by(s, rate * (t - max(ref, since))))


def jump(angle: float) -> Change:
    """The place looks the same after a turn by `angle`: against all earlier keyframes it is off by that."""
    return increments(lambda ride, s, ref, t, since, until: turned_by(s, angle) if ref < since else s)


def mirrored() -> Change:
    """From an image on they are mirrored; earlier keyframes are not found again."""
    return increments(lambda ride, s, ref, t, since, until: replace(s, yaw=-s.yaw) if ref >= since else None)


def stabilised() -> Change:
    """The camera takes the turn out; its noise stays."""
    rng = np.random.default_rng(79)

    def still(
        ride: RobotDrive, s: YawIncrement, ref: float, t: float, since: float, until: float
    ) -> YawIncrement | None:
        return replace(s, yaw=float(rng.normal() * math.sqrt(s.variance))) if ref >= since else None

    return increments(still)


def frozen() -> Change:
    """One image again and again: no turn since the fault began, and very sure of it."""
    seen: dict[int, float] = {}

    def still(ride: RobotDrive, s: YawIncrement, ref: float, t: float, since: float, until: float) -> YawIncrement:
        yaw = 0.0 if ref >= since else seen.setdefault(s.t_ref_ns, s.yaw)
        return replace(s, yaw=yaw, variance=1e-10, confidence=1.0)

    return increments(still)


def wrong_matches() -> Change:
    """Each third second one increment is off by anything."""
    rng, due = np.random.default_rng(80), [0.0]

    def one(ride: RobotDrive, s: YawIncrement, ref: float, t: float, *_: float) -> YawIncrement:
        if t < due[0]:
            return s
        due[0] = t + 3.0
        return replace(turned_by(s, float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 3.0))), confidence=0.5)

    return increments(one)


def overconfident(times: float) -> Change:
    return increments(lambda ride, s, ref, t, since, until: replace(s, variance=s.variance / times))


def exposed_earlier(seconds: float) -> Change:
    """Stamps from `since` on are this much later than the exposures."""

    def late(ride: RobotDrive, s: YawIncrement, ref: float, t: float, since: float, until: float) -> YawIncrement:
        def lost(at: float) -> float:
            return float(np.interp(at - seconds, ride.t, ride.yaw) - np.interp(at, ride.t, ride.yaw))

        return turned_by(s, lost(t) - (lost(ref) if ref >= since else 0.0))

    return increments(late)


def anew() -> Change:
    """All keyframes before `until` are lost: increments start from the first image after it."""

    def change(_: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        out: Stream = []
        first: YawIncrement | None = None
        for arrival, s in stream:
            if isinstance(s, YawIncrement) and s.t_ns * 1e-9 >= until and s.t_ref_ns * 1e-9 < until:
                if first is None:
                    first = s
                    continue
                turn = float(wrap_angle(s.yaw - first.yaw))
                s = replace(s, t_ref_ns=first.t_ns, yaw=turn, variance=s.variance + first.variance)
            out.append((arrival, s))
        return out

    return change


def dark() -> Change:
    """No images, and afterwards no keyframe of before is found again."""
    return chain(silent("C"), anew())


def dark_and_found() -> Change:
    """No images; afterwards for two seconds the last view of before is found again, and then held anew."""

    def change(ride: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        before = max(s.t_ns for _, s in stream if isinstance(s, YawIncrement) and s.t_ns * 1e-9 < since)

        def turn(t_ns: int) -> float:
            at = np.interp([before * 1e-9, t_ns * 1e-9], ride.t, ride.yaw)
            return float(wrap_angle(at[1] - at[0]))

        out: Stream = []
        for arrival, s in chain(silent("C"), anew())(ride, stream, since, until):
            if isinstance(s, YawIncrement) and 0.0 <= s.t_ns * 1e-9 - until < 2.0:
                s = replace(s, t_ref_ns=before, yaw=turn(s.t_ns), confidence=0.6, variance=1e-6)
            out.append((arrival, s))
        return out

    return change


def far_increments(angle: float) -> Change:
    """Every three seconds a look back at a view four seconds ago is off by `angle`, and very sure of it."""

    def change(ride: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        images = [s.t_ns for _, s in stream if isinstance(s, YawIncrement)]
        out: Stream = []
        due = since
        for arrival, s in stream:
            out.append((arrival, s))
            if isinstance(s, YawIncrement) and due <= s.t_ns * 1e-9 < until:
                due = s.t_ns * 1e-9 + 3.0
                ref = min(images, key=lambda t_ns: abs(t_ns - s.t_ns + 4 * S))
                at = np.interp([ref * 1e-9, s.t_ns * 1e-9], ride.t, ride.yaw)
                yaw = float(wrap_angle(at[1] - at[0] + angle))
                out.append((arrival, YawIncrement(ref, s.t_ns, yaw, 1e-8, 0.9, long_baseline=True)))
        return out

    return change
