"""What the panoramas of a recording say of the camera: region of interest, mask, forward column, noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from compass import CompassConfig, ConfigError, VisualCompass, wrap_angle
from compass.images.decode import to_grey
from compass.images.mask import RobotMask, load_mask
from compass.images.strip import prepare_strip
from compass.methods.sector_median import SectorShifts, local_shifts
from fusion.offline.bag import BagError
from fusion.offline.calibrate_evidence import TURN_STEP, Evidence, Finding
from fusion.offline.mounting import Mask, body_top, forward_column
from fusion.offline.scores import YawTrack, yaw_at
from fusion.offline.streams import Frame

DEG = math.radians(1.0)
WRONG_TURN = math.radians(3.0)  # of turns by `TURN_STEP`; real footage measures them to a fifth of a degree
PANORAMAS = ("equirectangular", "cylinder")  # whose rows are elevations
# parameters that say what the camera is: they are written again, as what was found holds only with them
CAMERA = (
    *("projection", "image_rotation_deg", "mirrored", "chroma_below", "field_of_view_deg", "lens_looks", "circle_x"),
    *("circle_y", "circle_radius", "circle_roll_deg", "circle2_x", "circle2_y", "circle2_radius", "circle2_roll_deg"),
    *("fisheye_focal", "fisheye_k1", "fisheye_k2", "fisheye_k3", "fisheye_k4"),
    *("ring_inner", "ring_inner_elevation_deg", "ring_outer_elevation_deg"),
)


def camera_findings(lenses: dict[str, tuple[float | None, str]], config: CompassConfig) -> list[Finding]:
    """What was found of the lenses, and how else the camera was said to be."""
    given = {
        spec.name: getattr(config, spec.name)
        for spec in CompassConfig.specs()
        if spec.name in CAMERA and spec.name not in lenses and getattr(config, spec.name) != spec.default
    }
    kept = [Finding(f"compass.{name}", value, "as given") for name, value in given.items()]
    return kept + [Finding(f"compass.{name}", value, evidence) for name, (value, evidence) in lenses.items()]


def region_findings(evidence: Evidence, static: Mask, shown: YawTrack, config: CompassConfig) -> list[Finding]:
    """Above the body, and of several upper and lower edges those that measure known turns best."""
    body = body_top(static) if config.projection in PANORAMAS else None
    limit = 1.0 if body is None else body - 0.02
    where = "no body in view" if body is None else f"the body begins at {body:.2f}"
    now = replace(config, roi_bottom=max(min(config.roi_bottom, limit), config.roi_top + 0.05))
    errors = {(now.roi_top, now.roi_bottom): _turn_error(evidence.turned, shown, now)}
    for top in (0.15, 0.25, 0.35):
        for bottom in (0.5, 0.55, 0.6, 0.65):
            if bottom <= limit and (top, bottom) not in errors:
                errors[top, bottom] = _turn_error(
                    evidence.turned, shown, replace(config, roi_top=top, roi_bottom=bottom)
                )
    best = min(errors, key=errors.__getitem__)
    if errors[best] > WRONG_TURN:
        off = f"are off by {errors[best] / DEG:.0f} deg" if math.isfinite(errors[best]) else "cannot be measured"
        basis = f"single turns of {TURN_STEP / DEG:.0f} deg between panoramas {off}"
        raise BagError(f"{basis}; do they show the full circle, turned about the vertical? Nothing was calibrated")
    first = (now.roi_top, now.roi_bottom)
    if errors[best] > 0.8 * errors[first]:
        best = first  # no clear gain: stay
    typical = f"{math.degrees(errors[best]):.3f} deg in the median"
    basis = f"turns of {math.degrees(TURN_STEP):.0f} deg measured to {typical}; {where}"
    return [Finding("compass.roi_top", best[0], basis), Finding("compass.roi_bottom", round(best[1], 3), basis)]


def mask_finding(static: Mask, region: Sequence[Finding], out: Path, frame: Frame, config: CompassConfig) -> Finding:
    """A picture of the robot beside the settings, named after them, where the region of interest shows any of it."""
    top, bottom = (float(edge.value or 0.0) for edge in region)
    if config.projection in PANORAMAS:
        share = float(static[round(top * len(static)) : round(bottom * len(static))].mean())
    else:
        config = replace(config, roi_top=top, roi_bottom=bottom)
        strips = [prepare_strip(0, frame.image, config, frame.encoding, one) for one in (None, RobotMask(static))]
        first, masked = (1.0 if strip.seen is None else strip.seen.share for strip in strips)
        share = 1.0 - masked / max(first, 1e-6)
    if share == 0.0:
        return Finding("compass.mask", None, "nothing in the region of interest stays while the robot turns")
    basis = f"{100.0 * share:.1f} % of the region of interest stay while the robot turns, and are ignored"
    return Finding("compass.mask", mask_name(out), basis)


def mask_name(out: Path) -> str:
    """Of the mask beside settings that are called `out`."""
    return f"{out.stem}_mask.png"


def _turn_error(frames: Sequence[Frame], shown: YawTrack, config: CompassConfig) -> float:
    """Typical (median) error of turns between neighbouring frames against the fused yaw, rad; else infinite."""
    errors = []
    for one, other in itertools.pairwise(frames):
        compass = VisualCompass(replace(config, max_yaw_rate=100.0))
        try:
            compass.update(one.t_ns, one.image, one.encoding)
            increment = compass.update(other.t_ns, other.image, other.encoding)
        except ConfigError:  # the camera shows nothing of this region
            return math.inf
        if increment is not None:
            yaw = yaw_at(shown, np.array([one.t_ns, other.t_ns]))
            errors.append(float(wrap_angle(increment.yaw - (yaw[1] - yaw[0]))))
    if len(errors) < 0.5 * (len(frames) - 1):
        return math.inf
    return float(np.median(np.abs(errors)))


def forward_finding(evidence: Evidence, config: CompassConfig) -> Finding:
    """Column from which everything moves away while driving straight ahead."""
    name = "compass.forward_column"
    if len(evidence.straight) < 5:
        return Finding(name, None, f"{len(evidence.straight)} straight stretches; 5 and more are needed")
    found = forward_column(list(_sector_shifts(evidence.straight, config)), config.columns)
    if found is None:
        return Finding(name, None, "the surroundings are too far away to move")
    basis = f"from {len(evidence.straight)} straight stretches, good to {360 * found.sigma:.1f} deg"
    return Finding(name, round(found.column, 4), basis)


def _sector_shifts(pairs: Iterable[tuple[Frame, Frame]], config: CompassConfig) -> Iterator[SectorShifts]:
    mask = load_mask(config)
    for one, other in pairs:
        strips = [prepare_strip(frame.t_ns, frame.image, config, frame.encoding, mask) for frame in (one, other)]
        found = local_shifts(strips[0], strips[1], 0, 64, 2)
        scale = config.columns / strips[0].columns
        yield replace(found, centre_px=found.centre_px * scale)


def image_noise(evidence: Evidence) -> float | None:
    """Noise of the camera at standstill, grey values of 255; None where the robot never stands."""
    differences = [
        to_grey(one.image, one.encoding).astype(np.float32) - to_grey(other.image, other.encoding)
        for one, other in evidence.still
    ]
    if not differences:
        return None
    spreads = [float(np.median(np.abs(difference - np.median(difference)))) for difference in differences]
    return 1.4826 * float(np.median(spreads)) / math.sqrt(2.0)
