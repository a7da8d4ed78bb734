"""Faults of random size, onset and length on random drives: a rule that only knows the table's rows fails here.

Of a drive are drawn the sensors, their rates and noises, and how fast and how long the robot turns and stands; of a
fault its kind, size, beginning and end. Only the sigma is judged: how large a fault has to be to be named depends on
all of these.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from robot_drive import HZ, Eyes, RobotDrive, sensed

from torture import changes as do
from torture import image_changes as see
from torture.changes import Change
from torture.drives import SECONDS, STANDS, smooth
from torture.rows import ANY, LASTS, MAY, Row

FROM_THE_START, FOR_A_WHILE = 0.3, 0.35  # of all faults
LAST_BEGIN = 25.0  # s
Drawn = tuple[Row, RobotDrive]


def drawn(seed: int) -> Drawn:
    """A row and the drive that it is tried on."""
    rng = np.random.default_rng([seed, 77])
    ride = _drive(rng)
    letter, name, change = _fault(rng)
    since = 0.0 if rng.random() < FROM_THE_START else float(rng.uniform(6.0, LAST_BEGIN))
    if name in ("holds its last number", "holds its last pose"):
        since = max(since, 2.0 * STANDS)  # there has to be one
    seconds = float(rng.uniform(3.0, 12.0)) if rng.random() < FOR_A_WHILE else LASTS
    who = "GTC" if rng.random() < 0.55 else str(rng.choice([two for two in ("GC", "GT", "TC") if letter in two]))
    span = f"from {since:.1f} s" + ("" if seconds == LASTS else f" for {seconds:.1f} s")
    fault = {"since": since, "seconds": seconds, "words": MAY, "most_sigma": ANY}
    return Row(f"{name}, {span}", letter, lambda: change, who=who, **fault), ride  # type: ignore[arg-type]


def _drive(rng: np.random.Generator) -> RobotDrive:
    """Legs, each straight or turning, some of them stops."""
    n = round(HZ * SECONDS)
    rate, speed, end = np.zeros(n), np.zeros(n), n - round(STANDS * HZ)
    shortest, longest = ((1.0, 4.0), (2.0, 6.0), (5.0, 10.0))[rng.integers(3)]
    fastest, pace, stops = rng.uniform(0.25, 1.4), rng.uniform(0.2, 1.5), rng.choice([0.0, 0.2, 0.35])
    i = round(STANDS * HZ)
    while i < end:
        stop = min(i + int(rng.uniform(shortest, longest) * HZ), end)
        if rng.random() > stops:
            speed[i:stop] = pace
            if rng.random() < 0.6:
                rate[i:stop] = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0) * fastest
        i = stop
    hertz = (
        int(rng.choice([25, 50, 100, 200])),
        int(rng.choice([10, 20, 50])),
        int(rng.choice([2, 4, 5, 8, 10, 20, 25])),
    )
    hold, noise = float(rng.uniform(0.7, 8.0)), float(rng.uniform(2e-4, 1.2e-3))
    eyes = Eyes(hold=hold, noise=noise, lasts=8e-5, time=6.0, claims_all=False)
    return sensed(
        rng, smooth(rate), smooth(speed), bias=float(0.006 * rng.normal()), scale=float(rng.uniform(0.9, 1.6)),
        hertz=hertz, eyes=eyes, gyro_noise=float(rng.uniform(0.0008, 0.005)),
        camera_delay=max(float(rng.uniform(-0.1, 0.1)), 0.0),
    )  # fmt: skip


def _fault(rng: np.random.Generator) -> tuple[str, str, Change]:
    """Letter of the sensor, name, and what is done to it."""
    side = float(rng.choice([-1.0, 1.0]))
    bias = side * math.exp(rng.uniform(math.log(0.003), math.log(1.0)))
    factor, top = float(rng.choice([0.5, 0.7, 0.85, 1.15, 1.4, 2.0])), float(rng.uniform(0.2, 0.9))
    off, late, gap = side * float(rng.uniform(0.15, 2.0)), float(rng.uniform(0.3, 1.5)), float(rng.uniform(0.1, 0.9))
    angle, every = side * float(rng.uniform(0.3, 3.1)), float(rng.uniform(4.0, 9.0))
    kinds: list[tuple[str, str, Callable[[], Change]]] = [
        ("G", f"bias steps by {bias:.3f} rad/s", lambda: do.gyro(lambda w, t: w + bias)),
        ("G", f"bias drifts by {bias / 20.0:.4f} rad/s a second", lambda: do.gyro(lambda w, t: w + bias / 20.0 * t)),
        ("G", f"scale {factor}", lambda: do.gyro(lambda w, t: factor * w)),
        ("G", "sign reversed", lambda: do.gyro(lambda w, t: -w)),
        ("G", "deg/s", lambda: do.gyro(lambda w, t: math.degrees(w))),
        ("G", "stuck at zero", lambda: do.gyro(lambda w, t: 0.0)),
        ("G", "holds its last number", lambda: do.held("G")),
        ("G", "noise only", do.gyro_noise_only),
        ("G", "axes swapped", do.gyro_other_axis),
        ("G", f"clipped at {top:.2f} rad/s", lambda: do.gyro(lambda w, t: max(-top, min(w, top)))),
        ("G", "single spikes of 5 rad/s", do.gyro_spikes),
        ("G", f"stamped {off:+.2f} s", lambda: do.stamped("G", lambda t: t + off)),
        ("T", f"slip of {bias:.3f} rad/s", lambda: do.tracks(lambda w: w + bias)),
        ("T", f"scale {factor}", lambda: do.tracks(lambda w: factor * w)),
        ("T", "sign reversed", lambda: do.tracks(lambda w: -w)),
        ("T", "degrees", lambda: do.tracks(math.degrees)),
        ("T", "stuck", do.tracks_stuck),
        ("T", "holds its last pose", lambda: do.held("T")),
        ("T", f"stamped {off:+.2f} s", lambda: do.stamped("T", lambda t: t + off)),
        ("C", "mirrored", see.mirrored),
        ("C", "stabilised", see.stabilised),
        ("C", "frozen", see.frozen),
        ("C", f"crowd walks one way, {bias / 5.0:.3f} rad/s", lambda: see.crowd(bias / 5.0)),
        ("C", "single wrong matches", see.wrong_matches),
        ("C", f"jump by {math.degrees(angle):.0f} deg", lambda: see.jump(angle)),
        ("C", f"look back off by {angle / 6.0:.2f} rad", lambda: see.far_increments(angle / 6.0)),
        (
            "C",
            f"exposed {abs(off) / 8.0:.2f} s before the stamps of before",
            lambda: see.exposed_earlier(abs(off) / 8.0),
        ),
        ("C", "dark, nothing found again", see.dark),
    ]
    for letter in "GTC":
        kinds += [
            (letter, "silent", lambda a=letter: do.silent(a)),  # type: ignore[misc]
            (letter, f"arrives {late:.1f} s late", lambda a=letter: do.delayed(a, late)),  # type: ignore[misc]
            (letter, f"hangs for {late:.1f} s", lambda a=letter: do.hangs(a, late, every)),  # type: ignore[misc]
            (letter, f"drop-outs of {gap:.1f} s", lambda a=letter: do.drop_outs(a, gap, every / 3.0)),  # type: ignore[misc]
        ]
    letter, name, make = kinds[rng.integers(len(kinds))]
    return letter, name, make()
