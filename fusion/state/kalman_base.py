"""`filterpy`'s extended Kalman filter, imported without `scipy.stats`, by far the largest part of its import.

`filterpy.kalman` takes one function of `filterpy.stats`, `logpdf`, for likelihoods that nobody here asks for; but
`filterpy.stats` imports `scipy.stats`. So a stand-in has its place while `filterpy` is imported. Whoever uses that
function, or `filterpy.stats`, gets the real one, imported then. Nothing of `scipy` is touched.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_NAME = "filterpy.stats"


def _logpdf(*arguments: Any, **named: Any) -> Any:
    """`filterpy.stats.logpdf`."""
    return import_module(_NAME).logpdf(*arguments, **named)


class _StandIn(ModuleType):
    """The place of `filterpy.stats` until somebody wants more of it than `logpdf`."""

    logpdf = staticmethod(_logpdf)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # asked for by whatever imports it
            raise AttributeError(name)
        _make_way(self)
        return getattr(import_module(_NAME), name)


def _make_way(stand_in: _StandIn) -> None:
    if sys.modules.get(_NAME) is stand_in:
        del sys.modules[_NAME]


_stand_in = _StandIn(_NAME)
if "filterpy" not in sys.modules:
    sys.modules[_NAME] = _stand_in
try:
    from filterpy.kalman import ExtendedKalmanFilter
finally:
    _make_way(_stand_in)

__all__ = ["ExtendedKalmanFilter"]
