"""Stamps as the core takes them: whole nanoseconds, never seconds."""

from __future__ import annotations

import operator
from typing import SupportsIndex

from compass.errors import ArgumentError


def whole_ns(t_ns: SupportsIndex, name: str = "t_ns") -> int:
    """The stamp as an int; `ArgumentError` for a float or anything else that is no whole number.

    A float is refused even where it has no fraction: seconds since 1970 in a float are as whole now and then, and at
    nanoseconds a float has too few digits.
    """
    try:
        return operator.index(t_ns)
    except TypeError:
        kind = type(t_ns).__name__
        raise ArgumentError(
            f"{name} is {t_ns!r}, a {kind}; give whole nanoseconds as an int: round(1e9 * seconds)"
        ) from None
