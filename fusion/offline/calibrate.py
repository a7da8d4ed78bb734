"""``visual-compass calibrate``: region of interest, forward column and noises from a user's own recording."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from compass import CompassConfig, ConfigError, VisualCompass, wrap_angle
from compass.images.decode import to_grey
from compass.images.mask import RobotMask, load_mask
from compass.images.orientation import Orientation
from compass.images.strip import prepare_strip
from compass.methods.sector_median import SectorShifts, local_shifts
from fusion.buffer.events import Sensor
from fusion.offline.atomic_output import refuse_existing, staged_file
from fusion.offline.bag import BagError
from fusion.offline.circles import looked_at, with_circles
from fusion.offline.console import progress_bar
from fusion.offline.contradiction_check import contradiction
from fusion.offline.image_files import SensorFiles
from fusion.offline.mounting import MASK_COLUMNS, Mask, Panorama, body_top, forward_column, static_pixels
from fusion.offline.open_recording import FileRecording, open_recording
from fusion.offline.run import FusedRun, fuse_recording
from fusion.offline.scores import FUSED, YawTrack, yaw_at, yaw_tracks
from fusion.offline.streams import Frame, Times
from fusion.offline.summary import KNOWN_DELAY
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings

GIVEN_SCALE = 1e-3  # of the gyro; with 8e-3 images of the robot's body drew it by 6 %
DEG = math.radians(1.0)
TURN_STEP = math.radians(20.0)  # between frames that show the body: a window moves by its width and more
MOST_TURNED, MOST_PAIRS = 60, 40
STRIDE = (0.05, 0.4)  # m driven between the images of a pair
STEADY = math.radians(1.0)  # most turning in a pair
WRONG_TURN = math.radians(3.0)  # of turns by `TURN_STEP`; real footage measures them to a fifth of a degree
_HEADER = "# Calibrated from "  # how the settings begin
PANORAMAS = ("equirectangular", "cylinder")  # whose rows are elevations
# parameters that say what the camera is: they are written again, as what was found holds only with them
CAMERA = (
    *("projection", "image_rotation_deg", "mirrored", "chroma_below", "field_of_view_deg", "lens_looks", "circle_x"),
    *("circle_y", "circle_radius", "circle_roll_deg", "circle2_x", "circle2_y", "circle2_radius", "circle2_roll_deg"),
    *("fisheye_focal", "fisheye_k1", "fisheye_k2", "fisheye_k3", "fisheye_k4"),
    *("ring_inner", "ring_inner_elevation_deg", "ring_outer_elevation_deg"),
)
STILL = 1e-3  # m/s and rad/s by the tracks


@dataclass(slots=True)
class Evidence:
    """Frames worth looking at.

    Attributes
    ----------
    turned : list of Frame
        Each `TURN_STEP` of yaw from the one before.
    straight : list of (Frame, Frame)
        Driven straight ahead between the two.
    still : list of (Frame, Frame)
        Neighbours at standstill.
    """

    turned: list[Frame] = field(default_factory=list)
    straight: list[tuple[Frame, Frame]] = field(default_factory=list)
    still: list[tuple[Frame, Frame]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Finding:
    """A proposed parameter by its dotted name, and the evidence in words; `value` None: nothing could be found."""

    name: str
    value: float | str | None
    evidence: str

    def __str__(self) -> str:
        """One line of the report."""
        value = "not found" if self.value is None else self.value if isinstance(self.value, str) else f"{self.value:g}"
        return f"{self.name}: {value} ({self.evidence})"


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
    refuse_existing(out, force=force, begins=_HEADER.encode())
    refuse_existing(out.with_name(_mask_name(out)), force=force or out.exists())
    refuse_existing(picture, force=force)
    with open_recording(path, settings, request, sensors) as read:
        with progress_bar("reading samples") as progress:
            recording = read(progress)
        left_out = any(one.sensor == Sensor.COMPASS.value for one in recording.warnings)  # is told below
        if recording.topics["image"] is None and not left_out:
            raise BagError(f"{path}: no panoramas in it; name their topic with --image-topic")
        camera, lenses = with_circles(looked_at(recording.frames(), settings.compass), settings.compass)
        settings = replace(settings, compass=camera)
        with progress_bar("fusing") as progress:
            run = fuse_recording(recording, _with_given_scale(settings), progress)
        if wrong := contradiction(run):
            raise BagError(f"{path}: {wrong}")
        fused, delay = yaw_tracks(run)[FUSED], _camera_delay(run)
        late_ns = round(1e9 * float(delay.value or 0.0))
        shown = YawTrack(fused.t_ns + late_ns, fused.yaw)  # what an image of a stamp shows
        evidence = gather(recording, shown)
    if len(evidence.turned) < 6:
        turned = math.degrees(len(evidence.turned) * TURN_STEP)
        raise BagError(f"{path}: the robot turns by {turned:.0f} deg; calibration needs 120 and more, best a full turn")
    static = static_pixels([_small(frame, settings.compass) for frame in evidence.turned])
    region = _region(evidence, static, shown, settings.compass)
    mask = _mask(static, region, out, evidence.turned[0], settings.compass)
    findings = [*_camera(lenses, settings.compass), *region, mask, _forward(evidence, settings.compass)]
    findings += [_gyro_noise(recording), _track_scale(recording, fused), delay]
    with ExitStack() as files:  # the settings appear last: they never name a mask that is not there
        files.enter_context(staged_file(out)).write_text(
            _as_yaml(findings, path, _image_noise(evidence)), encoding="utf-8"
        )
        if mask.value is not None:
            white = Orientation.of(settings.compass).as_taken(static).astype(np.uint8) * np.uint8(255)
            files.enter_context(staged_file(out.with_name(str(mask.value)))).write_bytes(_png(white))
    if picture is not None:
        with staged_file(picture) as staged:
            staged.write_bytes(_png(_drawn(evidence.turned[0], static, settings.compass)))
    return "\n".join([*map(str, findings), f"settings in {out}"])


def gather(recording: FileRecording, shown: YawTrack) -> Evidence:
    """Look through all frames once and keep those that tell something; `shown` is the yaw by their stamps."""
    evidence, last, kept_yaw = Evidence(), None, math.inf
    for frame in recording.frames():
        yaw = float(yaw_at(shown, np.array([frame.t_ns]))[0])
        if abs(yaw - kept_yaw) > TURN_STEP and len(evidence.turned) < MOST_TURNED:
            evidence.turned.append(frame)
            kept_yaw = yaw
        if last is None:
            last = frame
            continue
        motion = _motion(recording, shown, last.t_ns, frame.t_ns)
        if motion is not None and motion.still and len(evidence.still) < MOST_PAIRS:
            evidence.still.append((last, frame))
        if motion is not None and motion.steady and motion.way < STRIDE[0]:
            continue  # wait for the pair's second image
        if motion is not None and motion.steady and motion.way < STRIDE[1] and len(evidence.straight) < MOST_PAIRS:
            evidence.straight.append((last, frame))
        last = frame
    return evidence


@dataclass(frozen=True, slots=True)
class _Motion:
    """Between two images: way forward, m; whether the robot drove straight, or stood."""

    way: float
    steady: bool
    still: bool


def _motion(recording: FileRecording, fused: YawTrack, start_ns: int, end_ns: int) -> _Motion | None:
    """By the tracks and the fused yaw; None where the tracks say nothing."""
    odometry = recording.odometry
    inside = slice(*np.searchsorted(odometry.t_ns, (start_ns, end_ns)))
    speed, rate = odometry.speed[inside], odometry.yaw_rate[inside]
    if not speed.size:
        return None
    yaw = yaw_at(fused, np.array([start_ns, end_ns]))
    way = float(speed.mean()) * (end_ns - start_ns) * 1e-9
    still = bool(np.abs(speed).max() < STILL and np.abs(rate).max() < STILL)
    return _Motion(way, bool(abs(yaw[1] - yaw[0]) < STEADY and speed.min() > STILL), still)


# ---------------------------------------------------------------- findings


def _camera(lenses: dict[str, tuple[float | None, str]], config: CompassConfig) -> list[Finding]:
    """What was found of the lenses, and how else the camera was said to be."""
    given = {
        spec.name: getattr(config, spec.name)
        for spec in CompassConfig.specs()
        if spec.name in CAMERA and spec.name not in lenses and getattr(config, spec.name) != spec.default
    }
    told = [Finding(f"compass.{name}", value, "as given") for name, value in given.items()]
    return told + [Finding(f"compass.{name}", value, evidence) for name, (value, evidence) in lenses.items()]


def _region(evidence: Evidence, static: Mask, shown: YawTrack, config: CompassConfig) -> list[Finding]:
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
        told = f"single turns of {TURN_STEP / DEG:.0f} deg between panoramas {off}"
        raise BagError(f"{told}; do they show the full circle, turned about the vertical? Nothing was calibrated")
    first = (now.roi_top, now.roi_bottom)
    if errors[best] > 0.8 * errors[first]:
        best = first  # no clear gain: stay
    typical = f"{math.degrees(errors[best]):.3f} deg in the median"
    told = f"turns of {math.degrees(TURN_STEP):.0f} deg measured to {typical}; {where}"
    return [Finding("compass.roi_top", best[0], told), Finding("compass.roi_bottom", round(best[1], 3), told)]


def _mask(static: Mask, region: Sequence[Finding], out: Path, frame: Frame, config: CompassConfig) -> Finding:
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
    told = f"{100.0 * share:.1f} % of the region of interest stay while the robot turns, and are ignored"
    return Finding("compass.mask", _mask_name(out), told)


def _mask_name(out: Path) -> str:
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


def _forward(evidence: Evidence, config: CompassConfig) -> Finding:
    """Column from which everything moves away while driving straight ahead."""
    name = "compass.forward_column"
    if len(evidence.straight) < 5:
        return Finding(name, None, f"{len(evidence.straight)} straight stretches; 5 and more are needed")
    found = forward_column(list(_sector_shifts(evidence.straight, config)), config.columns)
    if found is None:
        return Finding(name, None, "the surroundings are too far away to move")
    told = f"from {len(evidence.straight)} straight stretches, good to {360 * found.sigma:.1f} deg"
    return Finding(name, round(found.column, 4), told)


def _sector_shifts(pairs: Iterable[tuple[Frame, Frame]], config: CompassConfig) -> Iterator[SectorShifts]:
    mask = load_mask(config)
    for one, other in pairs:
        strips = [prepare_strip(frame.t_ns, frame.image, config, frame.encoding, mask) for frame in (one, other)]
        found = local_shifts(strips[0], strips[1], 0, 64, 32.0)
        scale = config.columns / strips[0].columns
        yield replace(found, centre_px=found.centre_px * scale)


def _image_noise(evidence: Evidence) -> float | None:
    """Noise of the camera at standstill, grey values of 255; None where the robot never stands."""
    differences = [
        to_grey(one.image, one.encoding).astype(np.float32) - to_grey(other.image, other.encoding)
        for one, other in evidence.still
    ]
    if not differences:
        return None
    spreads = [float(np.median(np.abs(difference - np.median(difference)))) for difference in differences]
    return 1.4826 * float(np.median(spreads)) / math.sqrt(2.0)


def _gyro_noise(recording: FileRecording) -> Finding:
    """Deviation of the gyro's rate while the tracks stand, its slow bias taken out."""
    name = "fusion.gyro_sigma"
    still = _still_times(recording)
    rates = [recording.gyro.yaw_rate[slice(*np.searchsorted(recording.gyro.t_ns, span))] for span in still]
    steps = np.concatenate([np.diff(rate[np.isfinite(rate)]) for rate in rates] or [np.zeros(0)])
    if steps.size < 50:
        return Finding(name, None, f"{steps.size} gyro samples at standstill; 50 and more are needed")
    sigma = float(np.std(steps) / math.sqrt(2.0))
    if sigma < 1e-6:
        return Finding(name, None, "the rate does not change at standstill: filtered or simulated")
    return Finding(name, float(f"{sigma:.3g}"), f"from {steps.size} samples at standstill")


def _still_times(recording: FileRecording) -> list[tuple[int, int]]:
    """Spans between neighbouring track samples that both stand."""
    odometry = recording.odometry
    standing = (np.abs(odometry.speed) < STILL) & (np.abs(odometry.yaw_rate) < STILL)
    both = np.flatnonzero(standing[1:] & standing[:-1])
    spans: list[tuple[int, int]] = []
    for index in both.tolist():
        start, end = int(odometry.t_ns[index]), int(odometry.t_ns[index + 1])
        if spans and spans[-1][1] == start:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((start, end))
    return spans


def _track_scale(recording: FileRecording, fused: YawTrack) -> Finding:
    """Turn the tracks claim over the fused turn, by seconds in which the robot turns."""
    name = "fusion.initial_scale"
    odometry = recording.odometry
    if odometry.t_ns.size < 2:
        return Finding(name, None, "no track odometry")
    seconds: Times = np.arange(odometry.t_ns[0], odometry.t_ns[-1], 2_000_000_000)
    steps = np.diff(odometry.t_ns) * 1e-9 * 0.5 * (odometry.yaw_rate[1:] + odometry.yaw_rate[:-1])
    claimed = YawTrack(odometry.t_ns, np.concatenate([[0.0], np.cumsum(steps)]))
    turns, claims = np.diff(yaw_at(fused, seconds)), np.diff(yaw_at(claimed, seconds))
    turning = np.abs(turns) > math.radians(5.0)
    if np.count_nonzero(turning) < 3:
        return Finding(name, None, "the robot hardly turns")
    scale = float(turns[turning] @ claims[turning] / (turns[turning] @ turns[turning]))
    return Finding(name, round(scale, 3), f"from {np.degrees(np.abs(turns[turning]).sum()):.0f} deg of turning")


def _with_given_scale(settings: Settings) -> Settings:
    """Settings by which images that see the robot's own body cannot draw the gyro's scale along."""
    sigma = min(settings.fusion.gyro_scale_sigma, GIVEN_SCALE)
    return replace(settings, fusion=replace(settings.fusion, gyro_scale_sigma=sigma))


def _camera_delay(run: FusedRun) -> Finding:
    """By how much later than exposed the images were stamped, as the filter has learnt it."""
    name = "fusion.camera_delay"
    last = next((row.fused for row in reversed(run.rows) if row.fused), None)
    sigma = math.sqrt(last.camera_delay_variance) if last else math.inf
    if last is None or sigma > KNOWN_DELAY:
        return Finding(name, None, "no gyro, or the turn rate hardly changes")
    return Finding(name, round(last.camera_delay, 4), f"from exposure to stamp, s; good to {1e3 * sigma:.1f} ms")


# ---------------------------------------------------------------- output


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
    lines = [f"{_HEADER}{path.name}"]
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
