"""Records that are replaced, never changed, and are made by the dozen for every sample.

As mypy sees it a record is frozen; at run time `frozen` would make each of its fields five times as dear.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

T = TypeVar("T")

if TYPE_CHECKING:
    from typing import dataclass_transform

    @dataclass_transform(frozen_default=True, field_specifiers=(field,))
    def record(kind: type[T]) -> type[T]:
        """A dataclass with slots that nobody may change."""
        return kind
else:
    record = dataclass(slots=True)
