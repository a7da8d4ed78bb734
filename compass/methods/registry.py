"""The methods of the compass by name: those that come with it, and a user's own."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from compass.errors import ConfigError

if TYPE_CHECKING:
    from compass.methods.match import Method


@dataclass(frozen=True, slots=True)
class MethodEntry:
    """How a method is listed.

    Attributes
    ----------
    method : str, callable or class
        The function; a class, an object of which every compass makes for itself, to remember what it has seen; or where
        to import either from, ``"module:name"``.
    keyframe_spread : float
        `Match.spread_px` up to which a keyframe stays the reference, if the settings do not say, columns.
    long_baseline : bool
        Whether views some seconds back are compared too, by their corners (`long_baseline_interval`, `find_again`).
    formerly : str
        A name by which it may be found, too.
    """

    method: str | Method | type
    keyframe_spread: float = 3.0
    long_baseline: bool = False
    formerly: str = ""

    def make(self) -> Method:
        """The method for one compass."""
        found = _imported(self.method) if isinstance(self.method, str) else self.method
        made: Method = found() if isinstance(found, type) else found
        return made


OURS = {
    "rows": MethodEntry("compass.methods.row_correlation:match_rows", formerly="row_correlation"),
    "sectors": MethodEntry("compass.methods.sector_median:match_sectors", formerly="sector_median"),
    # tracks of 8 columns are no worse than those of 3, and three keyframes' errors are one
    "corners": MethodEntry("compass.methods.corners:CornerTracker", 8.0, long_baseline=True, formerly="parallax"),
}
_own: dict[str, MethodEntry] = {}


def register_method(name: str, method: Method | type, *, keyframe_spread: float = 3.0) -> None:
    """Let `CompassConfig(method=name)` mean a function of one's own.

    Parameters
    ----------
    name : str
        None of the compass's own; a name of one's own is given a new meaning.
    method : callable or class
        ``(reference: Strip, current: Strip, search: Search) -> Match``. Of a class every compass makes an object for
        itself, which is called in the same way, and may remember what it has seen.
    keyframe_spread : float
        `Match.spread_px` up to which an image stays the reference, columns.

    Raises
    ------
    ConfigError
        `name` is no name, or that of one of the compass's own methods; or `method` cannot be called.
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigError(f"method: {name!r} is no name; give one such as 'my_method'")
    if _proper(name) in OURS:
        raise ConfigError(f"method: {name!r} is the name of one of the compass's own; give another")
    if not callable(method):
        raise ConfigError(f"method {name}: {type(method).__name__} cannot be called; give a function")
    _own[name] = MethodEntry(method, keyframe_spread)


def own_methods() -> dict[str, MethodEntry]:
    """Those that were registered in this process; another one's may be brought in by `adopt_methods`."""
    return dict(_own)


def adopt_methods(entries: dict[str, MethodEntry]) -> None:
    """Take over what `own_methods` gave in another process."""
    _own.update(entries)


def find_method(name: str) -> tuple[str, MethodEntry]:
    """Proper name and entry of a method; ``"module:function"`` is imported, from the working directory at last.

    Raises
    ------
    ConfigError
        There is none of that name.
    """
    name = _proper(name)
    known = OURS | _own
    if name in known:
        return name, known[name]
    if ":" not in name:
        raise ConfigError(f"method: {name[:60]!r} is unknown; one of: {', '.join(known)}, or 'module:function'")
    found = _imported(name)
    if not callable(found):
        raise ConfigError(f"method: {name} is {type(found).__name__}, and cannot be called; name a function")
    return name, MethodEntry(found)


def _proper(name: str) -> str:
    """The name of today of one of the compass's own methods; any other name as it is."""
    return next((ours for ours, entry in OURS.items() if name == entry.formerly), name)


def _imported(name: str) -> Method | type:
    """What ``"module:function"`` means."""
    if not re.fullmatch(r"[^\W\d][\w.]*:[^\W\d]\w*", name):
        raise ConfigError(f"method: {name[:60]!r} is no function; give 'module:function'")
    module, _, function = name.partition(":")
    try:
        if importlib.util.find_spec(module.partition(".")[0]) is None:
            sys.path.append(os.getcwd())  # as `python -m` does; worker processes get the same path
        found: Method | type = getattr(importlib.import_module(module), function)
    except ModuleNotFoundError as error:
        raise ConfigError(f"method: {name}: {error}; put it on PYTHONPATH or into the working directory") from error
    except Exception as error:  # whatever the module does when it is imported
        raise ConfigError(f"method: {name}: {type(error).__name__}: {error}; mend the module or the name") from error
    return found
