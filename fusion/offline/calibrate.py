"""``visual-compass calibrate``: region of interest, forward column and noises from a user's own recording."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from compass import CompassConfig
from compass.images.decode import to_grey
from compass.images.orientation import Orientation
from fusion.buffer.events import Sensor
from fusion.offline.atomic_output import refuse_existing, staged_file
from fusion.offline.bag import BagError
from fusion.offline.calibrate_evidence import TURN_STEP, Finding, gather
from fusion.offline.calibrate_images import (
    camera_findings,
    forward_finding,
    image_noise,
    mask_finding,
    mask_name,
    region_findings,
)
from fusion.offline.calibrate_sensors import camera_delay, gyro_noise, track_scale
from fusion.offline.circles import looked_at, with_circles
from fusion.offline.console import progress_bar, shown_name
from fusion.offline.contradiction_check import contradiction
from fusion.offline.image_files import SensorFiles
from fusion.offline.mounting import MASK_COLUMNS, Mask, Panorama, static_pixels
from fusion.offline.open_recording import open_recording
from fusion.offline.run import fuse_recording
from fusion.offline.scores import FUSED, YawTrack, yaw_at, yaw_tracks
from fusion.offline.streams import Frame
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings

GIVEN_SCALE = 1e-3  # of the gyro; with 8e-3 images of the robot's body drew it by 6 %
_HEADER = "# Calibrated from "  # how the settings begin


def calibrate_bag(
    path: Path,
    settings: Settings,
    request: TopicRequest,
    out: Path,
    picture: Path | None,
    *,
    force: bool = False,
    sensors: SensorFiles | None = None,
) -> str:
    """Propose settings from a recording that turns, drives straight and stands; write them as YAML for ``--config``.

    Raises
    ------
    BagError
        The bag cannot be read, has no panoramas, the robot hardly turns in it, or its sensors contradict each other.
    OutputError
        Without `force`: a file is in the way that no earlier calibration wrote.
    """
    inputs = [path, *(sensors.paths if sensors else ())]
    refuse_existing(out, force=force, begins=_HEADER.encode(), inputs=inputs)
    refuse_existing(out.with_name(mask_name(out)), force=force or os.path.exists(out), inputs=inputs)
    refuse_existing(picture, force=force, inputs=inputs)
    with open_recording(path, settings, request, sensors) as opened:
        with progress_bar("reading samples") as progress:
            recording = opened.read(progress)
        left_out = any(one.sensor == Sensor.COMPASS.value for one in recording.warnings)  # is said below
        if recording.topics["image"] is None and not left_out:
            raise BagError(f"{path}: no panoramas in it; name their topic with --image-topic")
        camera, lenses = with_circles(looked_at(recording.frames(), settings.compass), settings.compass)
        settings = replace(settings, compass=camera)
        with progress_bar("fusing") as progress:
            run = fuse_recording(recording, _with_given_scale(settings), progress)
        if wrong := contradiction(run):
            raise BagError(f"{path}: {wrong}")
        fused, delay = yaw_tracks(run)[FUSED], camera_delay(run)
        late_ns = round(1e9 * float(delay.value or 0.0))
        shown = YawTrack(fused.t_ns + late_ns, fused.yaw)  # what an image of a stamp shows
        evidence = gather(recording, shown)
    if len(evidence.turned) < 6:
        turned = math.degrees(len(evidence.turned) * TURN_STEP)
        raise BagError(f"{path}: the robot turns by {turned:.0f} deg; calibration needs 120 and more, best a full turn")
    yaws = yaw_at(shown, np.array([frame.t_ns for frame in evidence.turned]))
    small = [_small(frame, settings.compass) for frame in evidence.turned]
    static = static_pixels(small, yaws if settings.compass.is_full_panorama else None)
    region = region_findings(evidence, static, shown, settings.compass)
    mask = mask_finding(static, region, out, evidence.turned[0], settings.compass)
    findings = [*camera_findings(lenses, settings.compass), *region, mask, forward_finding(evidence, settings.compass)]
    findings += [gyro_noise(recording), track_scale(recording, fused), delay]
    with ExitStack() as files:  # the settings appear last: they never name a mask that is not there
        files.enter_context(staged_file(out)).write_text(
            _as_yaml(findings, path, image_noise(evidence)), encoding="utf-8"
        )
        if mask.value is not None:
            white = Orientation.of(settings.compass).as_taken(static).astype(np.uint8) * np.uint8(255)
            files.enter_context(staged_file(out.with_name(str(mask.value)))).write_bytes(_png(white))
    if picture is not None:
        with staged_file(picture) as staged:
            staged.write_bytes(_png(_drawn(evidence.turned[0], static, settings.compass)))
    return "\n".join([*map(str, findings), f"settings in {out}"])


def _with_given_scale(settings: Settings) -> Settings:
    """Settings by which images that see the robot's own body cannot draw the gyro's scale along."""
    sigma = min(settings.fusion.gyro_scale_sigma, GIVEN_SCALE)
    return replace(settings, fusion=replace(settings.fusion, gyro_scale_sigma=sigma))


def _small(frame: Frame, config: CompassConfig) -> Panorama:
    """The upright frame in grey, brought to `MASK_COLUMNS`, freed of its brightness."""
    grey = Orientation.of(config).upright(to_grey(frame.image, frame.encoding)).astype(np.float32)
    height = round(grey.shape[0] * MASK_COLUMNS / grey.shape[1])
    small = np.asarray(cv2.resize(grey, (MASK_COLUMNS, height), interpolation=cv2.INTER_AREA), np.float32)
    return small * np.float32(128.0 / max(float(small.mean()), 1.0))


def _png(picture: Panorama | npt.NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".png", picture)[1].tobytes()


def _drawn(frame: Frame, static: Mask, config: CompassConfig) -> Panorama:
    """A frame with what stays in orange."""
    grey = np.clip(_small(frame, config), 0, 255).astype(np.uint8)
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    picture[static] = (0.5 * picture[static] + 0.5 * np.array([0, 94, 213])).astype(np.uint8)
    return np.asarray(picture)


def _as_yaml(findings: Sequence[Finding], path: Path, image_noise: float | None) -> str:
    """The findings as a parameter file, the evidence as comments."""
    lines = [f"{_HEADER}{shown_name(path)}"]
    if image_noise is not None:
        lines.append(f"# Noise of the camera: {image_noise:.1f} of 255 grey values.")
    lines += ["/**:", "  ros__parameters:"]
    for group in ("compass", "fusion"):
        lines.append(f"    {group}:")
        for one in findings:
            head, name = one.name.split(".")
            if head == group and one.value is None:
                lines.append(f"      # {name}: not found, {one.evidence}")
            elif head == group:
                lines += [f"      # {one.evidence}", f"      {yaml.safe_dump({name: one.value}).strip()}"]
        if not any(one.name.startswith(group) and one.value is not None for one in findings):
            lines[-1 - sum(one.name.startswith(group) for one in findings)] = f"    {group}: {{}}"
    return "\n".join(lines) + "\n"
