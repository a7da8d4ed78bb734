"""Pictures that other cameras would have taken of a panorama, rendered by forward models of their own.

Nothing here uses `compass.images`: each pixel's ray is written out the other way round, from pixel to direction, and
looked up in the panorama, whose columns run clockwise seen from above, its middle ahead.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np


def look_up(panorama, rays, *arguments):
    """Grey values of a panorama along `rays(*arguments)`, vectors: x ahead, y left, z up; NaN is black."""
    column, row, unseen = places(panorama.shape, rays, *arguments)
    around = cv2.copyMakeBorder(panorama, 0, 0, 4, 4, cv2.BORDER_WRAP)
    seen = cv2.remap(around, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    seen[unseen] = 0
    return seen


@lru_cache(maxsize=16)
def places(shape, rays, *arguments):
    """Where rays meet a panorama that is wrapped by four columns on either side, and which do not."""
    height, width = shape
    x, y, z = rays(*arguments)
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    column = (0.5 - azimuth / math.tau) * width - 0.5
    row = (0.5 - elevation / math.pi) * height - 0.5
    unseen = ~np.isfinite(column + row)
    column, row = (np.where(unseen, 0, one).astype(np.float32) for one in (column % width + 4, row))
    return column, row, unseen


def pixels(height, width):
    row, column = np.mgrid[:height, :width].astype(float)
    return column, row


def optical_to_robot(looks, right, down, along):
    """From a camera's x right, y down, z along its axis to x ahead, y left, z up."""
    if looks == "up":  # its upper edge is ahead
        return -down, right, along
    if looks == "down":
        return -down, -right, -along
    if looks == "ahead":
        return along, -right, -down
    return -along, right, -down


def fisheye_rays(size, centre, focal, k, field_of_view, roll, looks):
    """Rays of the pixels of OpenCV's fisheye camera; NaN outside of its field of view (rad)."""
    column, row = pixels(size, size)
    x, y = (column - centre[0]) / focal, (row - centre[1]) / focal
    # the picture lies turned counter-clockwise by roll: turn it back
    x, y = x * math.cos(roll) - y * math.sin(roll), x * math.sin(roll) + y * math.cos(roll)
    distorted = np.hypot(x, y)
    angle = distorted.copy()
    for _ in range(20):  # Newton on OpenCV's polynomial; its own undistortPoints ends at 90 deg
        square = angle**2
        value = angle * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
        slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3])))
        angle = angle - (value - distorted) / slope
    angle[angle > field_of_view / 2] = np.nan
    scale = np.sin(angle) / np.maximum(distorted, 1e-9)
    return optical_to_robot(looks, x * scale, y * scale, np.cos(angle))


def fisheye(panorama, size, centre, focal, field_of_view, looks="up", k=(0.0, 0.0, 0.0, 0.0), roll=0.0):
    return look_up(panorama, fisheye_rays, size, centre, focal, k, field_of_view, roll, looks)


def dual_fisheye(panorama, size, field_of_view, rolls=(0.0, 0.0), stacked=False, fill=0.95, gain=1.0):
    """Two circles of 0.5 * fill * size radius, side by side or one above the other."""
    focal = fill * size / field_of_view
    circles = [
        fisheye(panorama, size, ((size - 1) / 2,) * 2, focal, field_of_view, looks, roll=roll)
        for looks, roll in zip(("ahead", "astern"), rolls, strict=True)
    ]
    circles[1] = np.clip(circles[1] * gain, 0, 255).astype(np.uint8)
    return np.concatenate(circles, axis=0 if stacked else 1)


def ring(panorama, size, inner, outer, elevations, looks="up"):
    """Radii are pixels, elevations rad at the inner and outer one."""
    return look_up(panorama, ring_rays, size, inner, outer, elevations, looks)


def ring_rays(size, inner, outer, elevations, looks):
    column, row = pixels(size, size)
    x, y = column - (size - 1) / 2, row - (size - 1) / 2
    radius = np.hypot(x, y)
    part = (radius - inner) / (outer - inner)
    part[(part < 0) | (part > 1)] = np.nan
    elevation = elevations[0] + part * (elevations[1] - elevations[0])
    level = np.cos(elevation) / np.maximum(radius, 1e-9)
    ahead, left, _ = optical_to_robot(looks, x * level, y * level, 0.0 * x)
    return ahead, left, np.sin(elevation)


def cylinder(panorama, width, height, field_of_view, tangent=True):
    return look_up(panorama, cylinder_rays, width, height, field_of_view, tangent)


def cylinder_rays(width, height, field_of_view, tangent):
    column, row = pixels(height, width)
    per_px = field_of_view / width
    azimuth = -(column - (width - 1) / 2) * per_px
    steep = -(row - (height - 1) / 2) * per_px
    rise = steep if tangent else np.tan(steep)
    return np.cos(azimuth), np.sin(azimuth), rise
