"""Records that are replaced, never changed, and are made by the dozen for every sample.

As mypy sees it a record is frozen; at run time `frozen` would make each of its fields five times as dear.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

T = TypeVar("T")

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import replace as replace
    from typing import dataclass_transform

    @dataclass_transform(frozen_default=True, field_specifiers=(field,))
    def record(kind: type[T]) -> type[T]:
        """A dataclass with slots that nobody may change."""
        return kind
else:
    record = dataclass(slots=True)

    def replace(one: T, /, **changes: Any) -> T:
        """What `dataclasses.replace` does, in a quarter of the time."""
        return _replacer(type(one))(one, **changes)


@cache
def _replacer(kind: type[Any]) -> Callable[..., Any]:
    """A function that makes another one of a dataclass, written as one would by hand for its fields."""
    known = [f for f in fields(kind) if f.init]
    parameters = ", ".join(f"{f.name}=same" for f in known)
    values = ", ".join(
        f"{f.name + '=' if f.kw_only else ''}one.{f.name} if {f.name} is same else {f.name}" for f in known
    )
    names: dict[str, Any] = {"kind": kind, "same": object()}
    exec(f"def replacer(one, /, *, {parameters}):\n    return kind({values})", names)
    return cast("Callable[..., Any]", names["replacer"])
