"""A real hand-held walk: the raw yaw against a truth summed up from pairs, and against the hall's vanishing point.

PYTHONPATH=tests python -m tools.walk_table

A line for each region and rate: error at the end against the truth, deg, and in deviations, of which the truth has 0.8
deg; slope of the error over the walk against the vanishing point, deg; RMS error of pairs a second apart against the
truth, deg; error^2/variance of increments whose ends the truth knows; images without an answer.
"""

import argparse
import json
import math

import cv2
import numpy as np
from panoramas import PHOTOS

from compass import CompassConfig, VisualCompass

VIDEO = PHOTOS.parent / "video"
REGIONS, STEPS, RATE_HZ = ((0.25, 0.55), (0.3, 0.6)), (1, 2, 5, 15), 30
TRUTH_AT_END, TRUTH_OF_PAIR = 0.8, 0.05  # deg
UPPER, WEAKEST = 0.55, 4.0  # share of the height above the walker's arm; grey values a pixel of an edge
NEAR = math.sin(math.radians(20.0))  # of the vanishing point, where upright edges seem to meet in it, too
OFF = math.radians(3.0)  # by which an edge may miss it; Geman-McClure's scale


def directions(column, row, shape):
    """(n, 3) unit vectors; x is ahead, in the middle of the image, y left, z up."""
    azimuth = -math.tau * ((column + 0.5) / shape[1] - 0.5)
    elevation = math.pi * (0.5 - (row + 0.5) / shape[0])
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)


def vanishing_point(image, axis):
    """Where the hall's edges meet, a unit vector, sought from `axis`: orthogonal to their great circles' normals."""
    soft = cv2.GaussianBlur(np.pad(image.astype(np.float32), ((0, 0), (16, 16)), mode="wrap"), (0, 0), 1.5)
    right, down = (cv2.Sobel(soft, cv2.CV_32F, *along, scale=0.125)[:, 16:-16] for along in ((1, 0), (0, 1)))
    slope = np.hypot(right, down)
    row, column = np.nonzero(slope[: int(UPPER * len(image))] > WEAKEST)
    seen, tiny = directions(column, row, image.shape), 1e-3
    rightwards, downwards = (
        directions(column + dx, row + dy, image.shape) - seen for dx, dy in ((tiny, 0.0), (0.0, tiny))
    )
    normal = np.cross(seen, right[row, column, None] * downwards - down[row, column, None] * rightwards)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for round_ in range(30):
        apart = np.sqrt(np.maximum(1.0 - (seen @ axis) ** 2, 1e-6))
        scale = max(OFF, math.radians(8.0) * 0.7**round_)
        weight = (apart > NEAR) * np.minimum(slope[row, column], 20.0)
        weight = weight / (1.0 + (normal @ axis / (apart * scale)) ** 2) ** 2 / apart**2
        found = np.linalg.eigh((normal * weight[:, None]).T @ normal)[1][:, 0]
        axis = found * np.sign(found @ axis)
    return axis


def headings(images):
    """Yaw of the camera in the hall, deg, of each image."""
    axis, yaws = np.array([1.0, 0.0, 0.0]), []
    for image in images:
        axis = vanishing_point(image, axis)
        yaws.append(-math.degrees(math.atan2(axis[1], axis[0])))
    return np.array(yaws)


def walked(frames, region, step):
    """Yaw and its variance after each image, deg; increments; images without an answer."""
    compass, rows, increments = VisualCompass(CompassConfig(roi_top=region[0], roi_bottom=region[1])), [], []
    for index in range(0, len(frames), step):
        found = compass.update(round(index * 1e9 / RATE_HZ), frames[index])
        increments += [found] if found else []
        rows.append((index, math.degrees(compass.yaw), math.degrees(1.0) ** 2 * compass.yaw_variance))
    return np.array(rows).T, increments, len(rows) - 1 - len(increments)


def line(frames, region, step, truth, hall):
    """What one region and rate give, as text."""
    at, true = truth
    (index, yaw, variance), increments, missing = walked(frames, region, step)
    yaw, variance = np.interp(at, index, yaw), np.interp(at, index, variance)
    seconds = slice(None, None, 3)
    error = yaw - true
    sigma = math.hypot(variance[-1] ** 0.5, TRUTH_AT_END)
    slope = np.polyfit(at[seconds] / at[-1], (yaw - hall)[seconds], 1)[0]
    pairs = np.sqrt(np.mean(np.diff(error[seconds]) ** 2))
    known, squares = dict(zip(at.tolist(), true.tolist(), strict=True)), []
    for one in increments:
        since, until = (round(t_ns * RATE_HZ * 1e-9) for t_ns in (one.t_ref_ns, one.t_ns))
        if since in known and until in known:
            spread = one.variance * math.degrees(1.0) ** 2 + TRUTH_OF_PAIR**2 * (until - since) / 10
            squares.append((math.degrees(one.yaw) - known[until] + known[since]) ** 2 / spread)
    return (
        f"{region[0]:.2f}-{region[1]:.2f} {RATE_HZ // step:3d} Hz: {error[-1]:5.2f} ({abs(error[-1]) / sigma:.1f}) "
        f"slope {slope:5.2f} pairs {pairs:.3f} error^2/variance {np.mean(squares):.2f} missing {missing}"
    )


def main():
    """Measure the walk at every region and rate."""
    argparse.ArgumentParser(
        "walk_table", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    ).parse_args()
    truth = json.loads((VIDEO / "corridor_walk_truth.json").read_text())
    at, true = np.array(truth["frame"]), np.array(truth["yaw_deg"])
    video = cv2.VideoCapture(str(VIDEO / "corridor_walk.mp4"))
    frames = []
    while (read := video.read())[0]:
        frames.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2GRAY))
    hall = headings(frames[index] for index in at)
    print(f"the truth's slope against the vanishing point: {np.polyfit(at / at[-1], true - hall, 1)[0]:.2f} deg")
    for region in REGIONS:
        for step in STEPS:
            print(line(frames, region, step, (at, true), hall), flush=True)


if __name__ == "__main__":
    main()
