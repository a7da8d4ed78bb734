"""What others' image registration costs on the same panoramas, and by how much it errs.

Every method gets the same grey strips of 1024 columns, two successive ones at a time, and says by how many columns the
second has moved: `cv2.phaseCorrelate`; `skimage.registration.phase_cross_correlation` to a hundredth of a column, if
scikit-image is installed; ORB and SIFT features, matched, with the shift that most of them share (RANSAC). Beside them
the compass's own methods, which remember a keyframe. Processor time, the shortest of several. `--markdown FILE` writes
the section of that file as well.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from bench_compass import FRAME_NS, driving_frames, duration, turning_frames
from rich.console import Console

from compass import CompassConfig, VisualCompass, wrap_angle
from compass.config import METHODS
from fusion.offline.markdown import markdown_table, write_section

REPEATS = 5
COUNT = 24  # images
TURN_PX = 14.2  # an image of the turning camera
INLIER_PX = 1.0
DRAWS = 100  # of RANSAC; one match gives a shift
RATIO = 0.75  # of Lowe's test
Register = Callable[[np.ndarray, np.ndarray], float]


def phase_correlate(before: np.ndarray, now: np.ndarray) -> float:
    """OpenCV's; a window would throw the seam away, and the circle has none."""
    return cv2.phaseCorrelate(before.astype(np.float32), now.astype(np.float32))[0][0]


def features(detector: cv2.Feature2D, norm: int) -> Register:
    """Features of a detector, matched by Lowe's ratio, and the shift of most of them."""
    matcher = cv2.BFMatcher(norm)

    def register(before: np.ndarray, now: np.ndarray) -> float:
        (a, b), (x, y) = zip(*(detector.detectAndCompute(one, None) for one in (before, now)), strict=True)
        if x is None or y is None:
            return math.nan
        pairs = [pair for pair in matcher.knnMatch(x, y, k=2) if len(pair) == 2]
        good = [first for first, second in pairs if first.distance < RATIO * second.distance]
        if not good:
            return math.nan
        ways = np.array([b[match.trainIdx].pt[0] - a[match.queryIdx].pt[0] for match in good])
        drawn = np.random.default_rng(0).choice(ways, DRAWS)
        off = np.abs(around(ways - drawn[:, None], before.shape[1]))
        best = drawn[(off < INLIER_PX).sum(axis=1).argmax()]
        apart = around(ways - best, before.shape[1])
        return float(around(best + apart[np.abs(apart) < INLIER_PX].mean(), before.shape[1]))

    return register


def around(columns: np.ndarray, circle: int) -> np.ndarray:
    """In [-circle / 2, circle / 2)."""
    return (columns + circle / 2) % circle - circle / 2


def peers() -> dict[str, Register]:
    """Those that are installed."""
    found = {
        "`cv2.phaseCorrelate`": phase_correlate,
        "ORB + RANSAC": features(cv2.ORB_create(1000), cv2.NORM_HAMMING),
        "SIFT + RANSAC": features(cv2.SIFT_create(), cv2.NORM_L2),
    }
    try:
        from skimage.registration import phase_cross_correlation
    except ImportError:
        return found

    def cross_correlation(before: np.ndarray, now: np.ndarray) -> float:
        shift, _, _ = phase_cross_correlation(now, before, upsample_factor=100)
        return float(shift[1])

    return {"skimage `phase_cross_correlation`": cross_correlation} | found


def measured_by_peer(register: Register, frames: list[np.ndarray]) -> tuple[float, np.ndarray]:
    """Time of an image, s, and the turn of each, rad; NaN where none is given."""
    config = CompassConfig()
    height, width = frames[0].shape
    rows = slice(round(config.roi_top * height), round(config.roi_bottom * height))
    strips = [np.ascontiguousarray(frame[rows]) for frame in frames]
    turns = np.array([register(*pair) for pair in pairwise(strips)]) * math.tau / width
    times = [
        min(duration(lambda pair=pair: register(*pair)) for _ in range(REPEATS)) for pair in list(pairwise(strips))[::4]
    ]
    return float(np.median(times)), turns


def measured_by_compass(method: str, frames: list[np.ndarray]) -> tuple[float, np.ndarray]:
    """The same of the compass, whole images in."""
    times = np.empty((REPEATS, len(frames)))
    for repeat in range(REPEATS):
        compass, yaws = VisualCompass(CompassConfig(method=method)), []
        for index, frame in enumerate(frames):
            times[repeat, index] = duration(partial(compass.update, index * FRAME_NS, frame))
            yaws.append(compass.yaw)
    return float(np.median(times.min(axis=0)[1:])), np.diff(yaws)


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--markdown", type=Path, help="write the section of this file, too")
    page = arguments.parse_args().markdown
    cv2.setNumThreads(1)
    truth = {"turning": TURN_PX * math.tau / 1024, "driving": 0.0}
    drives = {"turning": turning_frames(COUNT), "driving": driving_frames(COUNT)}
    found = {
        name: {drive: measure(frames) for drive, frames in drives.items()}
        for name, measure in (
            *((f"`{name}`", lambda frames, name=name: measured_by_compass(name, frames)) for name in METHODS[::-1]),
            *((name, lambda frames, one=one: measured_by_peer(one, frames)) for name, one in peers().items()),
        )
    }
    ours = found["`corners`"]
    rows = []
    for name, drive in found.items():
        cells = []
        for which, (seconds, turns) in drive.items():
            errors = np.degrees([wrap_angle(turn - truth[which]) for turn in turns])
            cells += [
                f"{seconds / ours[which][0]:.2f}",
                f"{np.sqrt(np.mean(errors**2)):.4f}",
                f"{abs(errors.sum()):.3f}",
            ]
        rows.append((name, *cells))
    header = ["method"]
    header += [f"{drive}, {what}" for drive in drives for what in ("cost", "RMS deg", "sum deg")]
    table = markdown_table(header, rows)
    Console(width=140).print(table)
    milliseconds = " and ".join(f"{1e3 * seconds:.2f} ms {drive}" for drive, (seconds, _) in ours.items())
    print(f"cost: times that of an update of `corners`, {milliseconds}")
    if "skimage" not in str(list(found)):
        print("scikit-image is not installed: its phase_cross_correlation is left out")
    if page:
        text = f"""## Others' registration on the same panoramas

{COUNT} grey panoramas of 1024 x 512 with noise of 2 grey values. Turning: by {TURN_PX} columns an image, nothing else.
Driving: between walls 1 m and 3 m away, no turn. The others get the same strip of each two successive images; the
compass's methods get whole images, and remember a keyframe. Cost: processor time an image, as a multiple of that of
`corners` in the same run. RMS: error of the turn from image to image; sum: of all {COUNT - 1} turns together.

{table}"""
        write_section(page, "peers", text)


if __name__ == "__main__":
    main()
