"""What can go wrong with a sensor, a clock or a link: each makes another stream of a stream.

A `Change` takes a `RobotDrive`, its stream and the times (s) between which the fault holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from robot_drive import RobotDrive

from compass import YawIncrement
from fusion import OdometrySample
from fusion.buffer.events import Sample
from torture.drives import Stream, sensor_letter

S = 10**9
Change = Callable[[RobotDrive, Stream, float, float], Stream]
One = Callable[[Sample, float], Any]  # of a sample and its time, s: another one, several, or None


def _hit(sample: Sample, letter: str, since: float, until: float) -> bool:
    return sensor_letter(sample) == letter and since <= sample.t_ns * 1e-9 < until


def each(letter: str, one: One) -> Change:
    """Change, leave out or multiply single samples of a sensor."""

    def change(_: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        out: Stream = []
        for arrival, sample in stream:
            made = one(sample, sample.t_ns * 1e-9) if _hit(sample, letter, since, until) else sample
            out += [(arrival, s) for s in (made if isinstance(made, list) else [made]) if s is not None]
        return out

    return change


def chain(*changes: Change) -> Change:
    """Several faults at once."""

    def change(ride: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        for one in changes:
            stream = one(ride, stream, since, until)
        return stream

    return change


def between(since: float, until: float, inner: Change) -> Change:
    """A fault that holds at times of its own, s after the row's `since`."""
    return lambda ride, stream, at, _: inner(ride, stream, at + since, at + until)


# ---------------------------------------------------------------- links and clocks


def silent(letter: str) -> Change:
    return each(letter, lambda s, t: None)


def drop_outs(letter: str, gap: float = 0.3, every: float = 2.0) -> Change:
    return each(letter, lambda s, t: None if t % every < gap else s)


def doubled(letter: str) -> Change:
    return each(letter, lambda s, t: [s, s])


def stamped(letter: str, stamp: Callable[[float], float]) -> Change:
    """Stamps (and an increment's reference in the fault) changed, s; samples arrive as before."""

    def change(_: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        def shifted(t_ns: int) -> int:
            return t_ns + round((stamp(t_ns * 1e-9) - t_ns * 1e-9) * S) if since <= t_ns * 1e-9 < until else t_ns

        out: Stream = []
        for arrival, sample in stream:
            if sensor_letter(sample) != letter:
                out.append((arrival, sample))
            elif isinstance(sample, YawIncrement):
                out.append((arrival, replace(sample, t_ns=shifted(sample.t_ns), t_ref_ns=shifted(sample.t_ref_ns))))
            else:
                out.append((arrival, replace(sample, t_ns=shifted(sample.t_ns))))
        return out

    return change


def backwards(letter: str) -> Change:
    """Stamps that run back from the beginning of the fault on."""
    return lambda ride, stream, since, until: stamped(letter, lambda t: 2.0 * since - t)(ride, stream, since, until)


def delivered(letter: str, arrive: Callable[[float, float], float]) -> Change:
    """Right stamps, another time of arrival: `arrive` of the stamp and of the fault's beginning, s."""

    def change(_: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        out = [
            (round(arrive(s.t_ns * 1e-9, since) * S), s) if _hit(s, letter, since, until) else (arrival, s)
            for arrival, s in stream
        ]
        return sorted(out, key=lambda one: one[0])

    return change


def delayed(letter: str, seconds: float) -> Change:
    return delivered(letter, lambda t, since: t + seconds)


def hangs(letter: str, seconds: float = 1.2, every: float = 8.0) -> Change:
    """Now and then the link holds all back for some seconds and delivers it at once."""
    return delivered(
        letter, lambda t, since: max(t, t - (t - since) % every + seconds if (t - since) % every < seconds else t)
    )


# ---------------------------------------------------------------- gyro


def gyro(rate: Callable[[float, float], float]) -> Change:
    """Another turn rate, of the right one and the time."""
    return each("G", lambda s, t: replace(s, yaw_rate=rate(s.yaw_rate, t)))


def gyro_noise_only() -> Change:
    rng = np.random.default_rng(77)
    return gyro(lambda w, t: 0.003 * float(rng.normal()))


def gyro_other_axis() -> Change:
    """Axes swapped: small rates that have nothing to do with the yaw."""
    rng = np.random.default_rng(78)
    return gyro(lambda w, t: 0.03 * math.sin(1.7 * t) + 0.02 * math.sin(5.3 * t) + 0.005 * float(rng.normal()))


def gyro_spikes() -> Change:
    """One sample a second is off by 5 rad/s."""
    due = [0.0]

    def spiked(w: float, t: float) -> float:
        if t < due[0]:
            return w
        due[0] = t + 1.0
        return w + 5.0

    return gyro(spiked)


def held(letter: str) -> Change:
    """The last value again and again; the odometry's pose and rate."""

    def change(ride: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        last = [s for _, s in stream if sensor_letter(s) == letter and s.t_ns * 1e-9 < since][-1:]
        return each(letter, lambda s, t: replace(last[0], t_ns=s.t_ns) if last else s)(ride, stream, since, until)

    return change


# ---------------------------------------------------------------- tracks


def tracks(rate: Callable[[float], float]) -> Change:
    """Another turn rate, of the right one; the pose goes on accordingly, and keeps what it gained."""

    def change(_: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        out: Stream = []
        extra, before = 0.0, None
        for arrival, sample in stream:
            if isinstance(sample, OdometrySample):
                if before is not None and _hit(sample, "T", since, until):
                    seconds = (sample.t_ns - before.t_ns) * 1e-9
                    extra += (rate(sample.yaw_rate) - sample.yaw_rate) * seconds
                before = sample
                turned = rate(sample.yaw_rate) if _hit(sample, "T", since, until) else sample.yaw_rate
                sample = replace(sample, yaw_rate=turned, yaw=(sample.yaw or 0.0) + extra)
            out.append((arrival, sample))
        return out

    return change


def tracks_stuck() -> Change:
    """Pose and rate stay; the speed does, too."""

    def change(ride: RobotDrive, stream: Stream, since: float, until: float) -> Stream:
        poses = [s.yaw for _, s in stream if isinstance(s, OdometrySample) and s.t_ns * 1e-9 <= since]
        pose = poses[-1] if poses else 0.0
        return each("T", lambda s, t: replace(s, yaw_rate=0.0, yaw=pose))(ride, stream, since, until)

    return change
