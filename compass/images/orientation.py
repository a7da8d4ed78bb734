"""How an image is brought upright: turned by quarters, then flipped where a mirror was in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compass.config import CompassConfig
from compass.images.decode import Image


@dataclass(frozen=True, slots=True)
class Orientation:
    """Quarter turns clockwise that bring the image upright, whether it is mirrored, and has rows of chroma below."""

    quarters: int
    mirrored: bool
    chroma_below: bool

    @staticmethod
    def of(config: CompassConfig) -> Orientation:
        """As the settings say."""
        return Orientation(config.image_rotation_deg // 90, config.mirrored, config.chroma_below)

    @property
    def is_upright(self) -> bool:
        """Whether nothing is to be done."""
        return not (self.quarters or self.mirrored or self.chroma_below)

    def upright(self, image: Image) -> Image:
        """View of an image, (H, W) or (H, W, channels), that stands upright; (W, H) after an odd quarter turn."""
        if self.chroma_below and image.ndim == 2:
            image = image[: max(2 * len(image) // 3, 1)]
        return self.turned(image)

    def turned(self, image: Image) -> Image:
        """The same of an image, or part of one, without rows of chroma."""
        turned = np.rot90(image, -self.quarters)
        return turned[:, ::-1] if self.mirrored else turned

    def as_taken(self, upright: Image) -> Image:
        """The inverse of `turned`."""
        return np.rot90(upright[:, ::-1] if self.mirrored else upright, self.quarters)


def rows_used(config: CompassConfig) -> float:
    """Share of an image's height, from the top, below which nothing matters to the strip."""
    plain = config.is_full_panorama and Orientation.of(config).is_upright
    return config.roi_bottom if plain else 1.0
