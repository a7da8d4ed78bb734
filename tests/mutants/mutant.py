"""A mutant, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path


@dataclass(frozen=True)
class Mutant:
    """A small change of the code that is to be noticed.

    Attributes
    ----------
    name : str
        What is wrong with the code then.
    file : str
        Path from the top of the tree.
    old, new : str
        Text that occurs there once, and what takes its place.
    tests : tuple of str
        What pytest is given: files, or tests in them.
    survives : str
        Why no test notices it; empty where one has to.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    survives: str = ""

    def applied(self, root: Path) -> str | None:
        """The changed text of the file; None where the old text does not occur exactly once."""
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        return text.replace(self.old, self.new) if text.count(self.old) == 1 else None


class Outcome(Enum):
    """What became of a mutant."""

    NOTICED = "noticed"
    SURVIVED = "SURVIVED"
    KNOWN = "survived, as is known"
    MENDED = "noticed, though listed as a survivor: take the reason away"
    STALE = "NO LONGER APPLIES"
    BROKEN = "BREAKS THE TESTS THEMSELVES"

    @property
    def good(self) -> bool:
        """Whether it is as the list says."""
        return self in (Outcome.NOTICED, Outcome.KNOWN, Outcome.MENDED)
