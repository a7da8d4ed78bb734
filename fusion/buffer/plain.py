"""Samples in Python's own numbers.

numpy's look the same and are not: what compares them is no `True`, their division by zero no error, and a stamp of 64
bits overflows. A sample is converted once, where it comes in.
"""

from __future__ import annotations

import operator
from dataclasses import fields, replace
from operator import attrgetter
from typing import Any

from compass import YawIncrement
from compass.errors import ArgumentError
from fusion.buffer.events import Sample, Sensor, sensor_of
from fusion.samples import GyroSample, OdometrySample

KINDS = {Sensor.GYRO: GyroSample, Sensor.TRACKS: OdometrySample, Sensor.COMPASS: YawIncrement}
STAMPS = ("t_ns", "t_ref_ns")
VECTORS = {Sensor.GYRO: "up", Sensor.COMPASS: "tilt"}
NAMES = {sensor: tuple(one.name for one in fields(kind)) for sensor, kind in KINDS.items()}
VALUES = {sensor: attrgetter(*names) for sensor, names in NAMES.items()}
PLAIN = frozenset((int, float, bool, tuple, type(None)))  # a vector's numbers are looked at apart


def plain(sample: Sample) -> Sample:
    """The sample itself, or one in Python's numbers where it has others; a stamp that is a float stays one.

    Raises
    ------
    ArgumentError
        A value is no number.
    """
    sensor = sensor_of(sample)
    values = VALUES[sensor](sample)
    vector = getattr(sample, VECTORS[sensor]) if sensor in VECTORS else None
    if PLAIN.issuperset(map(type, values)) and (vector is None or PLAIN.issuperset(map(type, vector))):
        return sample
    changed: dict[str, Any] = {}
    for name, value in zip(NAMES[sensor], values, strict=True):
        if type(value) not in PLAIN or value is vector is not None:
            try:
                changed[name] = _number(name, value)
            except (TypeError, ValueError):
                kind = KINDS[sensor].__name__
                raise ArgumentError(f"{kind}.{name} is {value!r}, a {type(value).__name__}; give a number") from None
    return replace(sample, **changed)


def _number(name: str, value: Any) -> object:
    if name in VECTORS.values():
        return tuple(float(one) for one in value)
    if name in STAMPS and hasattr(value, "__index__"):
        return operator.index(value)
    return bool(value) if name == "long_baseline" else float(value)
