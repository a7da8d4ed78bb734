"""A panoramic camera that sees a `World`: equirectangular, anti-aliased.

Column ``c`` of ``width`` looks along azimuth ``pi - 2 pi (c + 0.5) / width`` from the robot's +x (clockwise, the
centre looks ahead), row ``r`` of ``height`` along elevation ``pi/2 - pi (r + 0.5) / height``. The world is painted on
a finer raster, where edges get their exact coverage and textures their footprint, then low-passed and shrunk.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from fusion.simulation.painter import CameraPose, paint
from fusion.simulation.raster import Raster
from fusion.simulation.surfaces import Array
from fusion.simulation.world import World


@dataclass(frozen=True)
class PanoramaCamera:
    """A camera that sees all around.

    Attributes
    ----------
    width, height : int
        Size of the panorama, px.
    band : tuple of float
        Rows rendered finely, as fractions of height; outside of it details are left out.
    """

    width: int = 1024
    height: int = 512
    band: tuple[float, float] = (0.2, 0.64)

    @cached_property
    def _raster(self) -> Raster:
        return Raster(self.width, self.height, self.band)

    def render(self, world: World, pose: CameraPose, t: float = 0.0) -> Array:
        """The panorama at time `t` s: float32 (height, width), grey 0..255."""
        painted = paint(world, pose, t, self._raster)
        if pose.roll or pose.pitch:
            painted = self._raster.tilted(painted, pose.pitch, pose.roll)
        return self._raster.finish(painted)
