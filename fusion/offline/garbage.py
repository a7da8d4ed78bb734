"""How often Python looks for garbage that refers to itself, where there is hardly any."""

from __future__ import annotations

import gc

# Samples, states, rows and results by the hundred thousand refer to each other in no circle: a collector that walks
# through them after every 700 new objects, as is the default, finds nothing, and takes 8 % of the compass's time.
_OBJECTS = 50_000


def collect_seldom() -> None:
    """Let the collector of this process walk after so many new objects only."""
    gc.set_threshold(_OBJECTS)
