"""What an update of the compass costs and how near its error comes to the Cramer-Rao bound, per method.

    python tests/benchmarks/bench_compass.py

Cost: `VisualCompass.update` on a grey panorama of 1024 x 512 in ms, and as a multiple of one `scipy.fft.rfft` of its
strip. Both are processor time, in turn, the shortest of several, so that a busy machine disturbs neither. First the
camera turns, then it drives past near things, where the reference moves and an update at times compares with two, then
it sways as it drives, and an IMU tells how. Last, what it takes to find a view again after a gap.

Error: photographs turned by known parts of a column, with noise of 2 grey values in both images: RMS in deg, and as a
multiple of the bound. Needs the photographs; without them only the cost is shown.

`--markdown FILE` writes both tables into their sections of that file as well.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import scipy.fft
from rich.console import Console
from rich.table import Table

from compass import CompassConfig, VisualCompass, wrap_angle
from compass.config import METHODS
from compass.features.matching import follow_landmarks, match_landmarks
from compass.images.strip import prepare_strip
from compass.methods.match import Method, Search
from compass.visual_compass import UpAt
from fusion.offline.markdown import markdown_table, write_section

sys.path.insert(0, str(Path(__file__).parent.parent))
from panoramas import (
    FRAME_NS,
    PHOTO_NAMES,
    PHOTOS,
    as_bytes,
    azimuths,
    compare,
    photo,
    scene,
    seen_from,
    shifted,
    tilted,
)

LIMIT = 12.0  # times the transform of the strip
REPEATS = 12
NOISE = 2.0
TURNS = 40  # of each photograph
SHAPE = (512, 1024)
DRIVES = ("turning", "driving", "swaying")


def duration(action: Callable[[], object]) -> float:
    """Seconds of processor time that the action takes, once."""
    start = time.process_time()
    action()
    return time.process_time() - start


def turning_frames(count: int = 24) -> list[np.ndarray]:
    """The camera turns by 14.2 columns a frame."""
    image = scene(0, SHAPE[1], SHAPE[0])
    return [as_bytes(shifted(image, 14.2 * index), NOISE, index) for index in range(count)]


def driving_frames(count: int = 24) -> list[np.ndarray]:
    """The camera drives past a wall 1 m to its left and one 3 m to its right: at most 1.5 columns a frame."""
    image = scene(0, SHAPE[1], SHAPE[0])
    azimuth = azimuths(SHAPE[1])
    walls = np.where(azimuth > 0.0, 1.0, 3.0)
    step = 1.5 * math.tau / SHAPE[1]
    return [as_bytes(seen_from(image, index * step, 0.0, walls), NOISE, index) for index in range(count)]


def swaying(index: int) -> float:
    """Pitch of the swaying camera at a frame, rad."""
    return math.radians(3.0) * math.sin(index)


def swaying_frames(count: int = 24) -> list[np.ndarray]:
    """The driving camera pitches by 3 deg to and fro."""
    return [as_bytes(tilted(frame, 0.0, -swaying(index))) for index, frame in enumerate(driving_frames(count))]


def swaying_up(t_ns: int) -> tuple[float, float, float]:
    """The vertical in the swaying camera's frame."""
    pitch = swaying(t_ns // FRAME_NS)
    return -math.sin(pitch), 0.0, math.cos(pitch)


def cost(method: str, frames: list[np.ndarray], up_at: UpAt | None = None) -> tuple[float, float, float]:
    """Update in the median, the dearest update, and one transform of its strip, s; each the shortest of `REPEATS`."""
    compass = VisualCompass(CompassConfig(method=method), up_at)
    pixels = prepare_strip(0, frames[0], compass.config).pixels
    updates, transforms = np.empty((REPEATS, len(frames))), []
    for repeat in range(REPEATS):
        compass.reset()
        for index, frame in enumerate(frames):
            updates[repeat, index] = duration(lambda frame=frame, index=index: compass.update(index * FRAME_NS, frame))
            transforms.append(duration(lambda: scipy.fft.rfft(pixels, axis=1)))
    each = updates.min(axis=0)[1:]  # the first has nothing to compare with
    return float(np.median(each)), float(each.max()), min(transforms)


def show_costs(console: Console, page: Path | None) -> None:
    """Print what each method costs, turning and driving."""
    columns = [f"{drive}, {what}" for drive in DRIVES for what in ("ms", "x rfft", "dearest x rfft")]
    drives = (turning_frames(), None), (driving_frames(), None), (swaying_frames(), swaying_up)
    rows = []
    for method in METHODS:
        cells = []
        for frames, up_at in drives:
            update, dearest, transform = cost(method, frames, up_at)
            cells += [f"{1e3 * update:.2f}", f"{update / transform:.1f}", f"{dearest / transform:.1f}"]
        rows.append([method, *cells])
    show(console, "Cost of an update, grey 1024 x 512", ["method", *columns], rows)
    console.print(f"limit: {LIMIT:g} times one scipy.fft.rfft of the strip in the median; the dearest compares twice")
    corners = {
        what: min(cost_of_corners(method) for _ in range(REPEATS))
        for what, method in (("view found again after a gap", match_landmarks), ("long baseline", follow_landmarks))
    }
    for what, seconds in corners.items():
        console.print(f"{what}: {1e3 * seconds:.0f} ms")
    if page:
        ratios = [[row[0], *(cell for k, cell in enumerate(row[1:]) if k % 3)] for row in rows]
        headings = [column for k, column in enumerate(columns) if k % 3]
        updates = {row[0]: float(row[1]) for row in rows}
        others = " and ".join(f"{1e3 * s / updates['corners']:.0f} ({what})" for what, s in corners.items())
        text = f"""## Cost of an update of the compass

Processor time of `VisualCompass.update` on a grey panorama of 1024 x 512, as a multiple of one `scipy.fft.rfft` of its
strip in the same run: median over {len(drives[0][0]) - 1} images, and the dearest image, each the shortest of
{REPEATS}. The aim is {LIMIT:g} in the median. Turning: 14.2 columns an image. Driving: between walls 1 m and 3 m away.
Swaying: the same, and 3 deg of pitch to and fro, of which an IMU informs the compass.

{markdown_table(["method", *headings], ratios)}

Comparing two views by their corners takes as long as so many updates of `corners`: {others}."""
        write_section(page, "cost of an update", text)


def show(console: Console, title: str, header: list[str], rows: list[list[str]]) -> None:
    """Print a table."""
    table = Table(title=title)
    for name in header:
        table.add_column(name.replace(", ", "\n", 1), justify="left" if name == header[0] else "right")
    for row in rows:
        table.add_row(*row)
    console.print(table)


def cost_of_corners(method: Method) -> float:
    """Seconds to compare a view with another by their corners, a step and a third of the circle on."""
    config, view = CompassConfig(), scene(1, SHAPE[1], SHAPE[0])
    after = shifted(seen_from(view, 0.3, 0.8, 1.5), 333.3)
    strips = [prepare_strip(k, as_bytes(image, NOISE, k), config) for k, image in enumerate((view, after))]
    return duration(lambda: method(*strips, Search(333.3, SHAPE[1], SHAPE[1] / 2)))


def bound(image: np.ndarray) -> float:
    """Cramer-Rao bound, rad, of the turn between two images with this noise and rounding to 8 bits."""
    width = image.shape[1]
    gradient = np.fft.irfft(np.fft.rfft(image, axis=1) * 2j * np.pi * np.fft.rfftfreq(width), width, axis=1)
    return math.sqrt(2.0 * (NOISE**2 + 1.0 / 12.0) / float((gradient**2).sum())) * math.tau / width


def errors(method: str, name: str) -> tuple[np.ndarray, float, float]:
    """Errors in rad, mean squared error over variance, and the bound in rad."""
    config = CompassConfig(method=method)
    image = photo(name)
    image = image[round(config.roi_top * image.shape[0]) : round(config.roi_bottom * image.shape[0])]
    compass = VisualCompass(CompassConfig(method=method, roi_top=0.0, roi_bottom=1.0))
    rng = np.random.default_rng(PHOTO_NAMES.index(name))
    found, normalised = [], []
    for columns in rng.uniform(-20.0, 20.0, TURNS):
        pair = (as_bytes(one + rng.normal(0.0, NOISE, one.shape)) for one in (image, shifted(image, columns)))
        increment = compare(compass, *pair)
        found.append(wrap_angle(increment.yaw - columns * math.tau / image.shape[1]))
        normalised.append(found[-1] ** 2 / increment.variance)
    return np.array(found), float(np.mean(normalised)), bound(image)


def show_errors(console: Console, page: Path | None) -> None:
    """Print each method's error for each photograph."""
    header = ["photograph"]
    for method in METHODS:
        header += [f"{method}, RMS deg", f"{method}, x bound", f"{method}, error^2 / variance"]
    pooled: dict[str, list[np.ndarray]] = {method: [] for method in METHODS}
    rows = []
    for name in PHOTO_NAMES:
        cells = []
        for method in METHODS:
            found, normalised, limit = errors(method, name)
            pooled[method].append(found / limit)
            rms = float(np.sqrt(np.mean(found**2)))
            cells += [f"{math.degrees(rms):.5f}", f"{rms / limit:.2f}", f"{normalised:.2f}"]
        rows.append([name, *cells])
    totals = [f"{np.sqrt(np.mean(np.concatenate(pooled[method]) ** 2)):.2f}" for method in METHODS]
    rows.append(["all", *(cell for total in totals for cell in ("", total, ""))])
    show(console, f"Photographs turned by parts of a column, noise {NOISE:g} of 255, {TURNS} turns each", header, rows)
    console.print("limits: RMS 0.005 deg, 1.1 times the bound over all photographs, of the default method")
    if page:
        text = f"""## Photographs turned by parts of a column

Panoramic photographs of 1024 x 512, {TURNS} turns of each by up to 20 columns, noise of {NOISE:g} grey values of 255 in
both images (seed: the photograph's number). Root mean square error, its ratio to the Cramer-Rao bound of that
photograph, and mean squared error over variance of the increments. Turning without driving is the easiest case.
The aims are 0.005 deg and 1.1 times the bound.

{markdown_table(header, rows)}"""
        write_section(page, "photographs", text)


def main() -> None:
    """Print both tables."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--markdown", type=Path, help="write the sections of this file, too")
    page = arguments.parse_args().markdown
    cv2.setNumThreads(1)
    console = Console(width=120)
    show_costs(console, page)
    if PHOTOS.is_dir():
        show_errors(console, page)
    else:
        console.print(f"no photographs in {PHOTOS}: errors are not shown")


if __name__ == "__main__":
    main()
