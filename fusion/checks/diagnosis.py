"""What kind of fault explains a contradiction, in words: sign, units, scale, bias, time, or a sensor that is stuck."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion.buffer.events import Sensor
from fusion.checks.alternative import Alternative
from fusion.checks.gyro_faults import RADIANS, TURNED
from fusion.checks.isolation import Isolation
from fusion.checks.isolation_rules import STUCK
from fusion.checks.time_offset import TimeOffset
from fusion.checks.warnings import Warning
from fusion.checks.windows import Window

# Not derived: `SIGN`, `EXPLAINED`, `SEVERAL`.
SIGN = 0.4  # ratios this near to -1 are a sign
EXPLAINED = 0.6  # of the squared contradictions, by one number
SEVERAL = 3  # windows that distinguish a bias or a time offset from a scale
NAMES = {Sensor.GYRO: "the gyro", Sensor.TRACKS: "the odometry", Sensor.COMPASS: "the compass"}
FAULTS = {"images_mirrored", "images_do_not_turn", "gyro_stuck", "gyro_units"}  # what there is one cause of
OTHERS = {Sensor.GYRO: (Sensor.COMPASS, Sensor.TRACKS), Sensor.COMPASS: (Sensor.GYRO, Sensor.TRACKS)}


@dataclass(frozen=True, slots=True)
class Kind:
    """What explains a contradiction best: a code of `warnings.CODES`, in words, and what to do."""

    code: str
    what: str
    remedy: str


def warnings_of(iso: Isolation) -> tuple[Warning, ...]:
    """What contradicts at present."""
    found = []
    for sensor in Sensor:
        alternative, excluded = (
            iso.alternative(sensor),
            next((one for one in iso.exclusions if one.sensor is sensor), None),
        )
        if excluded or alternative:
            since_ns = min(one.since_ns for one in (excluded, alternative) if one)
            found += _warnings(iso, sensor, since_ns, alternative)
    if iso.offset is None:
        return tuple(found)
    named = _late(iso.offset)  # one cause of all that those contradict by
    return (named, *(one for one in found if not set(one.sensors) & set(named.sensors)))


def _late(offset: TimeOffset) -> Warning:
    """A sensor whose clock is off."""
    sensor, other, way = offset.sensor, offset.other, "late" if offset.seconds > 0.0 else "early"
    others = "the others'" if offset.sure else f"those of {NAMES[other]}"
    who = sensor.value if offset.sure else f"{sensor.value}+{other.value}"
    end = "" if offset.sure else "; nobody can tell whose clock is off"
    text = (
        f"the turns of {NAMES[sensor]} come {abs(offset.seconds):.1f} s too {way} against {others}{end}: stamp all "
        "sensors by one clock, at the moment of measuring"
    )
    return Warning("sensors_disagree_time", who, offset.since_ns, text)


def adds_up(sensor: Sensor, since_ns: int, beyond: float) -> Warning:
    """What a sensor and the tracks contradict by, rad, though in no window by much."""
    return Warning(
        "sensors_disagree",
        f"{Sensor.TRACKS.value}+{sensor.value}",
        since_ns,
        f"{NAMES[sensor]} has turned by {math.degrees(beyond):+.1f} deg more than the odometry since they last agreed; "
        f"nobody can tell who is right: sigma covers both; {_RECHECK[sensor]}",
    )


def _warnings(iso: Isolation, sensor: Sensor, since_ns: int, alternative: Alternative | None) -> list[Warning]:
    """What is wrong with a sensor; where it may as well be the other one that errs, what is wrong with that."""
    windows = [window for window in iso.evidence if window.claim(sensor)] or list(iso.evidence)
    other = _other(sensor, windows)
    if other is None and alternative is not None and sensor is not Sensor.TRACKS:
        other = alternative.against  # the gate found it, sample by sample
    kinds = [kind_of(sensor, other, windows)]
    if alternative is not None and other is not None:
        kinds += [kind for kind in (kind_of(other, sensor, windows),) if kind.code in FAULTS and kind != kinds[0]]
    seconds = sum(window.seconds for window in windows)
    turned = ", ".join(
        f"{NAMES[one]} {math.degrees(sum(claim.turn for window in windows if (claim := window.claim(one)))):+.1f}"
        for one in Sensor
        if any(window.claim(one) for window in windows)
    )
    who = sensor.value if alternative is None or other is None else f"{sensor.value}+{other.value}"
    end = f"{NAMES[sensor]} is left out" if alternative is None else "nobody can tell who is right: sigma covers both"
    turns = f": in {seconds:.1f} s that contradict, turned {turned} deg" if windows else ""
    return [
        Warning(
            kind.code,
            who,
            since_ns,
            f"{kind.what}{turns}; {end}; {kind.remedy}",
        )
        for kind in kinds
    ]


def _other(sensor: Sensor, windows: Sequence[Window]) -> Sensor | None:
    """Against whom a sensor is compared."""
    others = OTHERS.get(sensor, (Sensor.COMPASS, Sensor.GYRO))
    return next((one for one in others if any(window.claim(one) for window in windows)), None)


def kind_of(sensor: Sensor, other: Sensor | None, windows: Sequence[Window]) -> Kind:
    """The fault of a sensor that explains best what it and another one say of some windows."""
    both = [
        (window, a, b) for window in windows if other and (a := window.claim(sensor)) and (b := window.claim(other))
    ]
    if not both:
        against = f"contradicts {NAMES[other]}" if other else "contradicts the others"
        return Kind("sensors_disagree", f"{NAMES[sensor]} {against}", "check its mount and its topic")
    seconds = np.array([window.seconds for window, _, _ in both])
    y, x = np.array([a.turn for _, a, _ in both]), np.array([b.turn for _, _, b in both])
    change = np.array([window.rate_change for window, _, _ in both])
    if sensor is Sensor.GYRO and 2 * sum(window.gyro_repeats for window, _, _ in both) >= len(both):
        return Kind(
            "gyro_stuck", f"the gyro repeats {math.degrees(y[-1] / seconds[-1]):.3g} deg/s", "restart its driver"
        )
    if sensor is Sensor.TRACKS and not any(window.tracks_spoke for window, _, _ in both):
        return Kind("odometry_silent", "the odometry never says anything but zero", "check odometry_topic")
    explained = {"scale": _explained(y - x, x), "bias": _explained(y - x, seconds), "time": _explained(y - x, change)}
    best = max(explained, key=explained.__getitem__) if len(both) >= SEVERAL else "scale"
    if best == "scale" and sensor is Sensor.GYRO and explained["bias"] > EXPLAINED:
        best = "bias"  # at a constant rate they are alike, and biases step, scales do not
    ratio = float(x @ y / (x @ x)) if x @ x > 0.0 else math.inf
    turned = np.abs(x) > TURNED
    turning = bool(turned.any())
    times = float(np.median(y[turned] / x[turned])) if turning else 0.0
    if sensor is Sensor.GYRO and RADIANS[0] < abs(times) < RADIANS[1]:
        return Kind("gyro_units", f"the gyro turns {times:.0f} times as far", "its driver gives deg/s; make it rad/s")
    if turning and explained["scale"] > EXPLAINED and (best == "scale" or ratio < STUCK):
        return _by_ratio(sensor, ratio)
    if best == "bias" and explained["bias"] > EXPLAINED:
        off = math.degrees(float((y - x) @ seconds / (seconds @ seconds)))
        return Kind("sensors_disagree_bias", f"{NAMES[sensor]} turns by {off:+.2f} deg/s too much", _RECHECK[sensor])
    if best == "time" and explained["time"] > EXPLAINED:
        late = -float((y - x) @ change / (change @ change))
        return Kind("sensors_disagree_time", f"{NAMES[sensor]} is late by about {late:.2f} s", "check its clock")
    return Kind("sensors_disagree", f"{NAMES[sensor]} contradicts the others", _RECHECK[sensor])


_RECHECK = {
    Sensor.GYRO: "let the robot stand for some seconds, check the IMU",
    Sensor.TRACKS: "tracks slip, or the odometry's geometry is wrong",
    Sensor.COMPASS: "look for people walking one way, reflections, a repeating scene",
}


def _explained(off: np.ndarray, by: np.ndarray) -> float:
    """Share of squared contradictions that a multiple of something explains."""
    total, size = float(off @ off), float(by @ by)
    return float(off @ by) ** 2 / (size * total) if size > 0.0 and total > 0.0 else 0.0


def _by_ratio(sensor: Sensor, ratio: float) -> Kind:
    """A factor between its turns and the others'."""
    name = NAMES[sensor]
    if abs(ratio + 1.0) < SIGN:
        if sensor is Sensor.COMPASS:
            return Kind(
                "images_mirrored", "the images turn the other way", "they are mirrored or upside down: unflip them"
            )
        cure = "its z axis points down: set imu.up" if sensor is Sensor.GYRO else "negate its yaw"
        return Kind("sensors_disagree_sign", f"{name} turns the other way", f"{cure}, or the others' sign is wrong")
    if abs(ratio) < STUCK:
        if sensor is Sensor.COMPASS:
            return Kind("images_do_not_turn", "the images do not turn with the robot", "switch stabilisation off")
        code = "gyro_stuck" if sensor is Sensor.GYRO else "odometry_stuck"
        return Kind(code, f"{name} does not turn with the robot", "check its topic and driver")
    degrees = sensor is Sensor.TRACKS and ratio > RADIANS[0]  # times a scale factor of their own
    cure = "does its driver give degrees? make them radians" if degrees else _RECHECK[sensor]
    return Kind("sensors_disagree_scale", f"{name} turns {ratio:.2f} times as far as the others", cure)
