"""Samples as they are given, made of Python's own numbers.

What comes from an array may overflow or round later, and what compares numpy's numbers is no `True`.
"""

from __future__ import annotations

from typing import Any, SupportsFloat, cast

from compass.errors import ArgumentError
from compass.increment import YawIncrement
from compass.parameters import shown
from compass.stamps import whole_ns
from fusion.buffer.events import Sample
from fusion.record import replace
from fusion.samples import GyroSample, OdometrySample

_STAMPS = ("t_ns", "t_ref_ns")
_FLOAT = frozenset((float,))
_VECTORS: dict[type[Any], str] = {GyroSample: "up", YawIncrement: "tilt"}
# fields of each kind, and of these the ones that may be None
_FIELDS: dict[type[Any], tuple[tuple[str, ...], tuple[str, ...]]] = {
    GyroSample: (("t_ns", "yaw_rate", "factor_sigma"), ("variance", "cross_rate")),
    OdometrySample: (("t_ns", "yaw_rate", "speed"), ("yaw",)),
    YawIncrement: (("t_ref_ns", "t_ns", "yaw", "variance", "confidence", "factor_sigma"), ("turn",)),
}


def plain(sample: Sample) -> Sample:
    """The sample itself where its fields are ints and floats, else one whose are.

    Raises
    ------
    ArgumentError
        A stamp is no whole number, as seconds are, or a field is no number.
    """
    of_kind: type[Any] = type(sample)
    if of_kind not in _FIELDS:
        of_kind = next(kind for kind in _FIELDS if isinstance(sample, kind))
    wanted, optional = _FIELDS[of_kind]
    changes: dict[str, Any] = {}
    for name in wanted:
        value = getattr(sample, name)
        kind = type(value)
        if name in _STAMPS:
            if kind is not int and value == value:  # NaN is refused as a negative stamp is
                changes[name] = whole_ns(value, name)
        elif kind is not float:
            changes[name] = _number(value, name)
    for name in optional:
        value = getattr(sample, name)
        if value is not None and type(value) is not float:
            changes[name] = _number(value, name)
    if of_kind in _VECTORS:
        name = _VECTORS[of_kind]
        vector = getattr(sample, name)
        if vector is not None and not _FLOAT.issuperset(map(type, vector)):
            changes[name] = tuple(_number(one, name) for one in vector)
    return replace(sample, **changes) if changes else sample


def _number(value: object, name: str) -> float:
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        return float(cast("SupportsFloat", value))
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(f"{name} is {shown(value)}, a {type(value).__name__}; give one number") from None
