"""When a driver says that an image was taken: some time after it was exposed, and not always the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StampModel:
    """How a driver stamps images. Drivers differ, so each drive has one of its own.

    Attributes
    ----------
    latest : float
        A drive's images are stamped late by anything up to this, s, every time alike.
    jitter : tuple of float
        Least and greatest standard deviation by which they jitter besides, s: microseconds where hardware triggers,
        milliseconds where a busy computer notes the arrival.
    """

    latest: float = 0.04
    jitter: tuple[float, float] = (1e-5, 3e-3)

    def stamp(self, exposed: Floats, rng: np.random.Generator) -> Floats:
        """Stamps, s, of images exposed at the times `exposed`, s; they jitter by four deviations at most."""
        delay, jitter = rng.uniform(0.0, self.latest), np.exp(rng.uniform(*np.log(self.jitter)))
        return np.asarray(exposed + delay + jitter * np.clip(rng.standard_normal(exposed.size), -4.0, 4.0))
