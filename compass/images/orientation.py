"""How an image is brought upright: turned by quarters, then flipped where a mirror was in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compass.config import CompassConfig
from compass.images.decode import Image


@dataclass(frozen=True, slots=True)
class Orientation:
    """Quarter turns clockwise that bring the image upright, and whether it is mirrored."""

    quarters: int
    mirrored: bool

    @staticmethod
    def of(config: CompassConfig) -> Orientation:
        """As the settings say."""
        return Orientation(config.image_rotation_deg // 90, config.mirrored)

    @property
    def is_upright(self) -> bool:
        """Whether nothing is to be done."""
        return not (self.quarters or self.mirrored)

    def upright(self, image: Image) -> Image:
        """View of an image, (H, W) or (H, W, channels), that stands upright; (W, H) after an odd quarter turn."""
        turned = np.rot90(image, -self.quarters)
        return turned[:, ::-1] if self.mirrored else turned

    def as_taken(self, upright: Image) -> Image:
        """The inverse of `upright`."""
        return np.rot90(upright[:, ::-1] if self.mirrored else upright, self.quarters)
