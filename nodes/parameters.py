"""ROS parameters declared from the settings: description, range and type come from the config dataclasses."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node

from compass.errors import ConfigError
from compass.parameters import ParameterSet, ParameterSpec
from fusion.settings import Settings

Config = TypeVar("Config", bound=ParameterSet)

_ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
_INT64 = 2**63 - 1
_TOP = "topics"  # its parameters stand at the top level, the others behind the name of their group


class NodeParameters:
    """The parameters of a node, kept equal to a `Settings`.

    Parameters
    ----------
    node : Node
        Built with ``automatically_declare_parameters_from_overrides=True``, so that every key of the user's YAML
        is known here and a misspelt one can be refused.
    groups : iterable of str
        Fields of `Settings` to declare; the rest of a shared YAML is checked but not declared.

    Raises
    ------
    ConfigError
        A value is out of range or of the wrong type, or a key is unknown.
    """

    def __init__(self, node: Node, groups: Iterable[str]) -> None:
        self._node = node
        given = given_values(node)
        self.settings = Settings.from_dict(given)
        self._specs = settings_specs()
        values = settings_values(self.settings)
        groups = tuple(groups)
        for name, (group, spec) in self._specs.items():
            for one in {name, full_name(group, spec.formerly or spec.name)} & given.keys():
                node.undeclare_parameter(one)
            if group in groups:
                node.declare_parameter(name, values[name], describe(spec), ignore_override=True)

    def on_change(self, apply: Callable[[Settings], None]) -> None:
        """Check every later change as the configs do, and call `apply` with the new settings once it is made."""

        def made(parameters: list[Any]) -> None:
            if any(parameter.name in self._specs for parameter in parameters):
                self.settings = self._changed(parameters)
                apply(self.settings)

        self._node.add_on_set_parameters_callback(self._check)
        self._node.add_post_set_parameters_callback(made)

    def _changed(self, parameters: list[Any]) -> Settings:
        new = {parameter.name: parameter.value for parameter in parameters if parameter.name in self._specs}
        return Settings.from_dict(settings_values(self.settings) | new)

    def _check(self, parameters: list[Any]) -> SetParametersResult:
        try:
            self._changed(parameters)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def given_values(node: Node) -> dict[str, Any]:
    """What the node was given on its command line and in parameter files, by name."""
    given: dict[str, Any] = dict(node.get_parameters_by_prefix(""))
    return {name: parameter.value for name, parameter in given.items()}


def declare_config(node: Node, kind: type[Config]) -> Config:
    """Declare the fields of one config as parameters of a node (see `NodeParameters`); returns the values given."""
    given = given_values(node)
    config = kind.from_dict({name: value for name, value in given.items() if not name.startswith(_ROS_OWN)})
    for spec in kind.specs():
        if spec.name in given:
            node.undeclare_parameter(spec.name)
        node.declare_parameter(spec.name, getattr(config, spec.name), describe(spec), ignore_override=True)
    return config


def settings_specs() -> dict[str, tuple[str, ParameterSpec]]:
    """Group and spec of every parameter by its full name, such as ``compass.method``."""
    empty = Settings()
    return {
        full_name(group.name, spec.name): (group.name, spec)
        for group in dataclasses.fields(Settings)
        for spec in getattr(empty, group.name).specs()
    }


def settings_values(settings: Settings) -> dict[str, Any]:
    """Value of every parameter by its full name."""
    return {name: getattr(getattr(settings, group), spec.name) for name, (group, spec) in settings_specs().items()}


def full_name(group: str, name: str) -> str:
    """Name of a parameter on the node."""
    return name if group == _TOP else f"{group}.{name}"


def describe(spec: ParameterSpec) -> ParameterDescriptor:
    """ROS descriptor of a parameter: what ``ros2 param describe`` shows."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    descriptor = ParameterDescriptor(description=spec.description + unit, read_only=not spec.live)
    if spec.choices:
        names = [*spec.choices, spec.others] if spec.others else spec.choices
        descriptor.additional_constraints = "one of: " + ", ".join(names)
    limited = spec.low is not None or spec.high is not None
    if limited and isinstance(spec.default, float):
        low, high = bounds(spec, sys.float_info.max)
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif limited and isinstance(spec.default, int):
        low, high = bounds(spec, _INT64)
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor


def bounds(spec: ParameterSpec, widest: float) -> tuple[float, float]:
    """Limits of a number, an open side as wide as its type."""
    return (-widest if spec.low is None else spec.low, widest if spec.high is None else spec.high)
