"""The one place where angles are wrapped."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Angle = TypeVar("Angle", float, npt.NDArray[np.float64])


def wrap_angle(angle: Angle) -> Angle:
    """Bring an angle, or an array of angles, in rad into [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
