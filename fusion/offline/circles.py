"""The round pictures of fisheye lenses and mirrors, found in a recording: centres, radii, field of view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from compass import CompassConfig
from compass.images.decode import Image, to_grey
from compass.images.orientation import Orientation
from compass.images.projection import DualFisheye, Fisheye, projection_of
from fusion.offline.streams import Floats, Frame

EVERY, MOST = 10, 24  # frames from one that is looked at to the next, and how many are
EDGE = 0.15  # of the grey values from the dark surround to the picture is its edge
ROUND = 0.01  # of the radius by which points of the edge may lie off a circle
SEEN_EDGE = 0.4  # of the circle at least; the rest may be cut off by the image
TURNS = 0.3  # of how much a pixel of a ring changes that one inside of it, which shows the camera, does
WIDEST, NARROWEST, STEP = 240.0, 183.0, 0.5  # deg, fields of view of a lens that are tried
BAND, LOWEST = math.radians(4.0), math.radians(35.0)  # about the seam, and up and down along it, that is compared
ALIKE = 0.5  # correlation across the seam below which no field of view is believed


@dataclass(frozen=True, slots=True)
class RoundPicture:
    """Centre and radius as fractions of image width, height and height.

    `off` is how far its edge is off a circle, of the radius; `seen` the share of the circle at which there is an edge.
    """

    x: float
    y: float
    radius: float
    off: float
    seen: float


def looked_at(frames: Any, config: CompassConfig) -> list[Image]:
    """Upright grey images of a recording, some of its beginning."""
    oriented = Orientation.of(config)
    chosen: list[Frame] = list(islice(frames, 0, EVERY * MOST, EVERY))
    return [
        np.ascontiguousarray(oriented.upright(to_grey(frame.image, frame.encoding)))
        for frame in chosen
        if frame.image.shape[:2] == chosen[0].image.shape[:2]
    ]


def with_circles(images: Sequence[Image], config: CompassConfig) -> tuple[CompassConfig, dict[str, tuple[Any, str]]]:
    """Settings with the circles that are seen in upright images, and each parameter found, with its evidence.

    A value of None was not found, and stays as it is set.
    """
    found: dict[str, tuple[Any, str]] = {}
    if config.projection not in ("fisheye", "dual_fisheye", "ring") or not images:
        return config, found
    height, width = images[0].shape
    brightest = np.max([one >> 8 if one.dtype == np.uint16 else one for one in images], axis=0).astype(np.uint8)
    parts = [(slice(None), slice(None))]
    if config.projection == "dual_fisheye":
        half = (slice(0, width // 2), slice(width // 2, width))
        parts = [(slice(None), one) for one in half]
        if height > width:
            parts = [(slice(0, height // 2), slice(None)), (slice(height // 2, height), slice(None))]
    circles = [round_picture(brightest, part) for part in parts]
    for name, circle in zip(("circle", "circle2"), circles, strict=False):
        if circle is None:
            found[f"{name}_radius"] = None, "no dark surround with a round edge"
            continue
        basis = (
            f"edge seen over {100 * circle.seen:.0f} % of the circle, off it by {100 * circle.off:.2f} % of its radius"
        )
        for key, value in (("x", circle.x), ("y", circle.y), ("radius", circle.radius)):
            found[f"{name}_{key}"] = round(float(value), 4), basis
    config = replace(config, **{name: value for name, (value, _) in found.items() if value is not None})
    if config.projection == "ring" and circles[0] is not None and not config.ring_inner:
        found |= _inner_radius(images, circles[0])
    if config.projection == "dual_fisheye" and None not in circles:
        found |= _field_of_view(images, config)
    return replace(config, **{name: value for name, (value, _) in found.items() if value is not None}), found


def round_picture(grey: npt.NDArray[np.uint8], part: tuple[slice, slice]) -> RoundPicture | None:
    """The round picture in a part of an image that is dark around it; None where there is none."""
    inside = cv2.GaussianBlur(grey[part], (0, 0), 1.0)
    height, width = inside.shape
    dark, bright = np.percentile(inside, (1.0, 70.0))
    level = dark + EDGE * (bright - dark)
    if bright - dark < 20.0:
        return None
    found, _ = cv2.findContours((inside > level).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    edge = max(found, key=cv2.contourArea)[:, 0].astype(float)
    edge = edge[(edge > 2).all(axis=1) & (edge < np.array([width, height]) - 3).all(axis=1)]
    if len(edge) < 50:
        return None
    kept = edge
    for _ in range(8):  # flares and the robot's own parts lie off the circle
        x, y, radius = _circle_through(kept)
        off = np.abs(np.hypot(*(edge - (x, y)).T) - radius)
        kept = edge[off <= max(3.0 * float(np.median(off)), 1.0)]
    spread = float(np.sqrt(np.mean((np.hypot(*(kept - (x, y)).T) - radius) ** 2)))
    angle = np.arctan2(kept[:, 1] - y, kept[:, 0] - x)
    seen = np.unique((angle * (180 / math.tau)).astype(int)).size / 180
    if spread > ROUND * radius or seen < SEEN_EDGE:
        return None
    rows, columns = (one.start or 0 for one in part)
    full_height, full_width = grey.shape
    # the edge's pixels are the outermost bright ones: the circle ends half a pixel beyond their middles
    return RoundPicture(
        (x + columns + 0.5) / full_width,
        (y + rows + 0.5) / full_height,
        (radius + 0.5) / full_height,
        spread / radius,
        seen,
    )


def _circle_through(points: Floats) -> tuple[float, float, float]:
    """Centre and radius of the circle nearest to (n, 2) points (Kasa 1976, doi:10.1109/TIM.1976.6312298)."""
    x, y = points.T
    (a, b, c), *_ = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), x * x + y * y, rcond=None)
    return float(0.5 * a), float(0.5 * b), math.sqrt(max(float(c + 0.25 * (a * a + b * b)), 0.0))


def _inner_radius(images: Sequence[Image], circle: RoundPicture) -> dict[str, tuple[Any, str]]:
    """Within it the image stays while the robot turns: there it shows the camera."""
    height, width = images[0].shape
    changes = np.std(np.stack(images).astype(np.float32), axis=0)
    row, column = np.mgrid[:height, :width]
    radius = np.hypot(column + 0.5 - circle.x * width, row + 0.5 - circle.y * height)
    outer = int(circle.radius * height)
    ring = np.bincount(radius.astype(int).ravel(), changes.ravel())[:outer]
    profile = ring / np.maximum(np.bincount(radius.astype(int).ravel())[:outer], 1)
    usual = float(np.median(profile[outer // 2 :]))
    still = np.flatnonzero(profile[: outer // 2] < TURNS * usual)
    if usual < 2.0 or not still.size:
        return {"ring_inner": (None, "nothing about the centre stays while the robot turns")}
    basis = f"inside of it images change by less than {TURNS:g} of what they do outside"
    return {"ring_inner": (round((int(still[-1]) + 1) / height, 4), basis)}


def _field_of_view(images: Sequence[Image], config: CompassConfig) -> dict[str, tuple[Any, str]]:
    """That with which both lenses show the same about the seam."""
    tried = np.arange(NARROWEST, WIDEST + STEP, STEP)
    scores = np.array([_agreement(images, replace(config, field_of_view_deg=float(one))) for one in tried])
    best = int(np.argmax(scores))
    if scores[best] < ALIKE or best in (0, len(tried) - 1):
        basis = f"the two pictures do not show the same at their edges (correlation {scores[best]:.2f} at best)"
        return {"field_of_view_deg": (None, basis)}
    left, mid, right = scores[best - 1 : best + 2]
    off = 0.5 * (left - right) / min(left - 2.0 * mid + right, -1e-9)
    value = float(tried[best] + STEP * np.clip(off, -0.5, 0.5))
    return {"field_of_view_deg": (round(value, 2), f"both lenses agree about the seam to a correlation of {mid:.2f}")}


def _agreement(images: Sequence[Image], config: CompassConfig) -> float:
    """Mean correlation of what the two lenses show of the same directions about the seam."""
    height, width = images[0].shape
    both = projection_of(config, height, width)
    if not isinstance(both, DualFisheye):
        return 0.0
    reach = min(0.5 * both.ahead.field_of_view - 0.5 * math.pi - math.radians(0.5), BAND)
    beyond = np.linspace(-reach, reach, 25)
    azimuth = np.concatenate([0.5 * math.pi + beyond, -0.5 * math.pi + beyond])[None, :]
    elevation = np.linspace(-LOWEST, LOWEST, 141)[:, None]
    samples = [[_sampled(lens, image, azimuth, elevation) for lens in (both.ahead, both.astern)] for image in images]
    return float(np.mean([np.corrcoef(one, other)[0, 1] for one, other in samples]))


def _sampled(lens: Fisheye, image: Image, azimuth: Floats, elevation: Floats) -> Floats:
    """What a lens shows of directions, and each row's mean on either side taken out, in one row."""
    x, y, _ = lens.locate(azimuth, elevation, *image.shape)
    seen = cv2.remap(image, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    sides = np.asarray(seen, np.float64).reshape(len(seen), 2, -1)
    return np.asarray((sides - sides.mean(axis=2, keepdims=True)).ravel())
