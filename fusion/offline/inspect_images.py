"""``visual-compass inspect`` of a video or a folder of images: what is in it, what is wrong, what to type next."""

from __future__ import annotations

import shlex
from collections import Counter
from pathlib import Path

import cv2

from compass.errors import VisualCompassError
from fusion.offline.atomic_output import staged_file
from fusion.offline.console import progress_bar
from fusion.offline.first_minute import LENGTH_NS, MOST_IMAGES, Beginning
from fusion.offline.image_files import EMBEDDED, Images, SensorFiles, read_image_recording
from fusion.offline.inspect import as_panorama, draw_region, usual_shape
from fusion.offline.run import fuse_recording
from fusion.offline.streams import Frame
from fusion.settings import Settings

NO_GYRO_INSIDE = "no gyro found inside"


def inspect_images(images: Images, settings: Settings, roi_preview: Path | None = None) -> str:
    """Describe a video or a folder of images; for `roi_preview`, draw the region of interest over its first image.

    Raises
    ------
    VisualCompassError
        It holds no usable image.
    """
    first = _first(images)
    span, (height, width) = images.span(), first.image.shape[:2]
    seconds = 1e-9 * (span.last_ns - span.first_ns)
    rate = f", {(images.count - (images.kind == 'folder')) / seconds:.1f} a second" if seconds > 0.0 else ""
    lines = [f"{images.path}: {images.count} images of {width} x {height}{rate}, {seconds:.1f} s"]
    found = _problems(images, settings)
    circle = not any(problem.endswith("[not_full_circle, compass]") for problem in found)
    if not usual_shape(first.image, settings.compass):
        lines.append("not as wide as a full circle usually is, 2:1 or more; see projection and field_of_view_deg")
    elif circle and settings.compass.is_full_panorama:
        lines.append("nothing speaks against the full circle")
    lines += [*_gyro(images), *(f"problem: {' '.join(problem.split())}" for problem in found)]
    if roi_preview is not None:
        picture = draw_region(as_panorama(first.image, first.encoding, settings.compass), settings.compass)
        with staged_file(roi_preview) as staged:
            staged.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
        lines.append(f"region of interest drawn in {roi_preview}")
    return "\n".join(lines)


def _first(images: Images) -> Frame:
    dropped: Counter[str] = Counter()
    for frame in images.frames(0, dropped):
        return frame
    raise VisualCompassError(f"{images.path}: no usable image: {', '.join(dropped) or 'it is empty'}")


def _problems(images: Images, settings: Settings) -> list[str]:
    """What is wrong in the first minute, a sentence each."""
    recording = read_image_recording(images, SensorFiles(), settings.imu, settings.compass.decoded_columns)
    beginning = Beginning(recording, recording.gyro, recording.odometry, images.span().first_ns + LENGTH_NS)
    with progress_bar(f"looking at the first minute, or {MOST_IMAGES} images") as progress:
        run = fuse_recording(beginning, settings, progress)
    found = [f"{one.text} [{one.code}, {one.sensor}]" for one in (warned.warning for warned in run.warnings)]
    return list(dict.fromkeys(found))


def _gyro(images: Images) -> list[str]:
    """Whether a gyro is inside, and how to fuse with it or with others."""
    path, inside, gyro = shlex.quote(str(images.path)), "", "imu.csv"
    try:
        t_ns, _ = images.gyro_readings()
        gyro, inside = EMBEDDED, f"gyro inside: {len(t_ns)} samples"
    except VisualCompassError as error:
        if images.kind == "video":
            text = str(error).removeprefix(f"{images.path}: ")
            inside = NO_GYRO_INSIDE if text.startswith(NO_GYRO_INSIDE) else text
    fuse = (
        f"next: visual-compass fuse {path} --gyro {gyro} --odometry odom.csv   (each if there is one; docs/videos.md)"
    )
    return [*filter(None, [inside]), fuse]
