"""Parameters described where they are defined.

A config is a frozen dataclass whose fields are made by :func:`parameter`. Its description, unit and range
travel with the field, so that the YAML reader, the command line and the ROS nodes take them from here.
"""

from __future__ import annotations

import dataclasses
import difflib
import logging
import math
import numbers
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from compass.errors import ArgumentError, ConfigError

log = logging.getLogger(__name__)

Value = bool | int | float | str
Config = TypeVar("Config", bound="ParameterSet")


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """What is known of one parameter beside its value.

    Attributes
    ----------
    name, description, unit : str
        `unit` is ``""`` for a pure number, a name or a switch.
    default : bool, int, float or str
        Its type is the parameter's type.
    low, high : float or None
        Inclusive limits of a number.
    choices : tuple of str
        The allowed names, empty when any is.
    others : str
        What else is allowed, in words, and checked by the config itself; empty where nothing is.
    live : bool
        Whether a running node may change it.
    formerly : str
        Its name until the last release, which is still read; empty where it has none.
    """

    name: str
    default: Value
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    others: str = ""
    live: bool = False
    formerly: str = ""

    def check(self, value: Any) -> Value:
        """Return `value` in the parameter's type, or raise `ConfigError`."""
        kind = type(self.default)
        if kind is int and isinstance(value, numbers.Integral) and not isinstance(value, bool):
            value = int(value)  # of numpy
        elif kind is str and isinstance(value, os.PathLike):
            value = os.fspath(value)
        elif kind is float and isinstance(value, numbers.Real) and not isinstance(value, bool):
            try:
                value = float(value)
            except OverflowError:
                raise ConfigError(f"{self.name}: {shown(value)} is beyond all numbers, up to 1.8e308") from None
        if type(value) is not kind:
            raise ConfigError(f"{self.name}: {shown(value)} is not of type {kind.__name__} (default {self.default!r})")
        if isinstance(value, (int, float)) and kind is not bool:
            low = -math.inf if self.low is None else self.low
            high = math.inf if self.high is None else self.high
            if not low <= value <= high:  # false for NaN too
                raise ConfigError(f"{self.name}: {shown(value)} is outside {low:g} .. {high:g} {self.unit}".rstrip())
        if self.choices and not self.others and value not in self.choices:
            raise ConfigError(f"{self.name}: {shown(value)} is unknown; one of: {', '.join(self.choices)}")
        checked: Value = value
        return checked


def shown(value: object, longest: int = 60) -> str:
    """A value as the text of an error shows it: cut where it is long, whatever it is."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits; a list within itself
        text = f"a very large {type(value).__name__}"
    return text if len(text) <= longest else f"{text[: longest - 4]} ..."


def config_of(kind: type[Config], given: object) -> Config:
    """A config as an argument: the defaults for None; `ArgumentError` for anything but a config of this kind."""
    if given is None:
        return kind()
    if not isinstance(given, kind):
        name = kind.__name__
        raise ArgumentError(f"config is {shown(given)}; give a {name}, such as {name}({next(kind.specs()).name}=...)")
    return given


def parameter(
    default: Value,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    others: str = "",
    live: bool = False,
    formerly: str = "",
) -> Any:
    """Declare a dataclass field that carries its description, unit and range (see `ParameterSpec`)."""
    facts = {"description": description, "unit": unit, "low": low, "high": high, "choices": choices, "others": others}
    facts |= {"live": live, "formerly": formerly}
    return dataclasses.field(default=default, metadata=facts)


@dataclass(frozen=True)
class ParameterSet:
    """Base of the config dataclasses: checks every field on construction."""

    def __post_init__(self) -> None:
        for spec in self.specs():
            object.__setattr__(self, spec.name, spec.check(getattr(self, spec.name)))

    @classmethod
    def specs(cls) -> Iterator[ParameterSpec]:
        """The parameters in the order of their definition."""
        for field in dataclasses.fields(cls):
            yield ParameterSpec(field.name, field.default, **field.metadata)  # type: ignore[arg-type]

    @classmethod
    def from_dict(cls: type[Config], values: Mapping[str, Any], where: str = "") -> Config:
        """Build from a mapping; an unknown key raises `ConfigError` and suggests the nearest known one."""
        values = cls._renamed(values, where)
        known = [spec.name for spec in cls.specs()]
        for key in values:
            if key not in known:
                near = difflib.get_close_matches(str(key)[:60], known, n=1)
                hint = f"did you mean {where}{near[0]!r}?" if near else f"known: {', '.join(known)}"
                raise ConfigError(f"unknown parameter {where}{shown(key)}; {hint}")
        try:
            return cls(**values)
        except ConfigError as error:
            raise ConfigError(f"{where}{error}") from None

    @classmethod
    def _renamed(cls, values: Mapping[str, Any], where: str) -> dict[str, Any]:
        """The values by their present names; a former name is told once for each reading."""
        renamed = dict(values)
        for spec in cls.specs():
            if spec.formerly and spec.formerly in renamed:
                log.warning(
                    "%s%s is now called %s%s; the old name goes with the next release",
                    where,
                    spec.formerly,
                    where,
                    spec.name,
                )
                renamed.setdefault(spec.name, renamed.pop(spec.formerly))
                renamed.pop(spec.formerly, None)
        return renamed

    def to_dict(self) -> dict[str, Value]:
        """All values by name, ready for YAML."""
        return dataclasses.asdict(self)
