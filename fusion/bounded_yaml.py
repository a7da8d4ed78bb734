"""YAML within bounds: what a person writes is read, what would take all memory or time is refused."""

from __future__ import annotations

import re
from typing import Any

import yaml

DEEPEST = 32  # levels; a ROS parameter file has four, a bag's metadata six
MOST_VALUES = 50_000  # keys and values; read in half a second, and a hundred times as many as a robot has parameters
LONGEST_VALUE = 1024  # characters; above, a number takes long to convert and no path is that long


class YamlError(ValueError):
    """Text that is not YAML, or no such YAML as a person writes, in one line."""


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Numbers as ROS reads them: ``1e-3`` is one, which YAML 1.1 takes for text as it has no point."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def parse_yaml(text: str, longest_value: int = LONGEST_VALUE, *, as_text: bool = False) -> Any:
    """The content of one YAML document, made of plain Python types.

    Parameters
    ----------
    text : str
        The document.
    longest_value : int
        Characters of a key or value at most.
    as_text : bool
        Leave every value the text that it is, instead of finding numbers and dates.

    Raises
    ------
    YamlError
        It is not YAML, nested deeper than `DEEPEST`, has a longer value or more of them than `MOST_VALUES`, or refers
        to itself by an alias: a few lines of aliases stand for billions of values. (ROS parameter files know none.)
        Or, but for `as_text`, a key stands twice in one mapping: the first value would be lost without a word.
    """
    # libyaml is twenty times as fast, where PyYAML was built with it
    plain = getattr(yaml, "CBaseLoader", yaml.BaseLoader) if as_text else _Loader
    try:
        _check(text, longest_value, plain, unique=not as_text)
        return yaml.load(text, plain)
    except yaml.MarkedYAMLError as error:
        place = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise YamlError(_one_line(f"{error.problem or error.context}") + place) from None
    except yaml.YAMLError as error:
        raise YamlError(_one_line(error)) from None
    except YamlError:
        raise
    except (ValueError, TypeError, AttributeError, IndexError, KeyError, OverflowError) as error:
        # a date of the 99th month, `!!int ""` and their like: PyYAML lets the errors of the conversion through
        raise YamlError(f"a value is not of its type ({_one_line(error)})") from None


def _one_line(error: object) -> str:
    return " ".join(str(error)[:200].split())


class _Keys:
    """The keys of a mapping, event by event: of its children every other one is a key."""

    def __init__(self) -> None:
        self._lines: dict[str, int] = {}
        self._is_key = True

    def child(self, event: Any, line: int) -> None:
        """Take the next child; `YamlError` for a key that was there."""
        if self._is_key and isinstance(event, yaml.ScalarEvent):
            if event.value in self._lines:
                lines = f"lines {self._lines[event.value]} and {line}"
                raise YamlError(f"{event.value[:60]!r} stands twice, in {lines}; keep one")
            self._lines[event.value] = line
        self._is_key = not self._is_key


def _check(text: str, longest_value: int, loader: Any, *, unique: bool) -> None:
    """Go once through the events, which takes little memory and no recursion."""
    depth = values = 0
    parents: list[_Keys | None] = [None]  # None: of a list
    for event in yaml.parse(text, loader):
        line = event.start_mark.line + 1 if event.start_mark else 0
        values += isinstance(event, yaml.NodeEvent)
        if values > MOST_VALUES:
            raise YamlError(f"more than {MOST_VALUES} values in {line} lines")
        if isinstance(event, yaml.AliasEvent):
            raise YamlError(f"alias *{event.anchor} in line {line}; write the value out, aliases are not read")
        parent = parents[-1]
        if parent is not None and isinstance(event, yaml.NodeEvent):
            parent.child(event, line)
        if isinstance(event, yaml.CollectionStartEvent):
            parents.append(_Keys() if unique and isinstance(event, yaml.MappingStartEvent) else None)
            depth += 1
            if depth > DEEPEST:
                raise YamlError(f"nested deeper than {DEEPEST} levels in line {line}")
        elif isinstance(event, yaml.CollectionEndEvent):
            parents.pop()
            depth -= 1
        elif isinstance(event, yaml.ScalarEvent) and len(event.value) > longest_value:
            raise YamlError(f"value of {len(event.value)} characters in line {line}, more than {longest_value}")
