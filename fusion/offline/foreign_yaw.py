"""Somebody else's yaw, as a TUM file, to be scored beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from compass.errors import VisualCompassError
from compass.files import read_bounded
from fusion.offline.scores import YawTrack
from fusion.offline.streams import unwrap

LARGEST = 1 << 28  # bytes: four hours at 200 Hz have a third of that
_FORM = "lines of 't x y z qx qy qz qw', seconds and a unit quaternion"


def read_yaws(paths: Sequence[Path]) -> dict[str, YawTrack]:
    """Yaws by the names of their files; `VisualCompassError` where one cannot be read."""
    return {path.name: read_tum(path) for path in paths}


def read_tum(path: Path) -> YawTrack:
    """Accumulated yaw about z of a trajectory in TUM form.

    Parameters
    ----------
    path : Path
        Text, a pose a line: ``t x y z qx qy qz qw``; t in s, rising, on the bag's clock. What follows a ``#`` is left
        out.

    Raises
    ------
    VisualCompassError
        The file is missing, or not of that form.
    """
    text = read_bounded(path, LARGEST, f"give a text file with {_FORM}").decode("utf-8", errors="replace")
    t_ns, yaws = [], []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        try:
            t_ns.append(np.int64(round(Decimal(fields[0]) * 10**9)))  # a float64 knows such seconds to 0.2 us
            x, y, z, w = map(float, fields[4:8])
            if not 0.9 < x * x + y * y + z * z + w * w < 1.1:
                raise ValueError
        except (ValueError, OverflowError, InvalidOperation):
            raise VisualCompassError(f"{path}: line {number}: {line[:60]!r} is no pose; give {_FORM}") from None
        yaws.append(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
    stamps, yaw = np.array(t_ns, np.int64), np.array(yaws, np.float64)
    if stamps.size < 2 or np.any(np.diff(stamps) <= 0):
        raise VisualCompassError(f"{path}: {stamps.size} poses whose times do not rise; give {_FORM}, two and more")
    return YawTrack(stamps, unwrap(yaw))
