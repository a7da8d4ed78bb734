"""Bags, videos and folders of images in, results out: `fuse` for programs, and the command line."""

from typing import TYPE_CHECKING

from compass.lazy import lazy_names

if TYPE_CHECKING:
    from fusion.offline.library import Run, fuse

__all__ = ["Run", "fuse"]

__getattr__, __dir__ = lazy_names(__name__, {"fuse": "library", "Run": "library"})
