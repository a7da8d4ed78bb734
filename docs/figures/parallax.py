"""Parallax has one sign: how corners move when the robot drives without turning. Writes parallax.png."""

import cv2
import numpy as np
from common import BLUE, GREY, ORANGE, drive_of, plt, save, seconds

BETWEEN = 100, 106  # frames of demo: straight ahead along a wall
CORNERS = 400
LIMIT = 34.0  # columns


def main() -> None:
    """Write the picture."""
    drive = drive_of()
    first, last = (drive.frame(index) for index in BETWEEN)
    height, width = first.shape
    band = np.zeros_like(first)
    band[int(0.25 * height) : int(0.55 * height)] = 255
    corners = cv2.goodFeaturesToTrack(first, CORNERS, 0.01, 8, mask=band)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(first, last, corners, None, winSize=(21, 21))
    back, _, _ = cv2.calcOpticalFlowPyrLK(last, first, moved, None, winSize=(21, 21))
    good = (found.ravel() == 1) & (np.abs(back - corners).max(axis=(1, 2)) < 0.3)
    before, after = corners[good, 0], moved[good, 0]
    turn = np.diff(drive.frame_truth.yaw[list(BETWEEN)])[0] * width / (2.0 * np.pi)
    azimuth = 180.0 - 360.0 * (before[:, 0] / width)  # deg, left is positive; the middle column looks ahead
    shift = after[:, 0] - before[:, 0]

    figure, (picture, axes) = plt.subplots(
        2, 1, figsize=(8.0, 4.8), height_ratios=(1.0, 1.25), gridspec_kw={"hspace": 0.08}, sharex=True
    )
    rows = slice(int(0.2 * height), int(0.6 * height))
    picture.imshow(
        first[rows], cmap="gray", vmin=0, vmax=255, extent=(180, -180, 0.6 * height, 0.2 * height), aspect="auto"
    )
    picture.quiver(
        azimuth, before[:, 1], -shift * 360.0 / width, np.zeros(shift.size), angles="xy",
        scale_units="xy", scale=0.35, width=0.002, color=ORANGE,
    )  # fmt: skip
    picture.set(yticks=[], xlim=(180, -180))
    picture.spines[:].set_visible(False)
    axes.axhline(turn, color=BLUE, linewidth=1.5, label=f"rotation: {turn:.2f} columns everywhere")
    axes.plot(azimuth, shift, ".", color=ORANGE, markersize=4, label="tracked corners: rotation + parallax")
    for side, limit in (([180, 0], LIMIT), ([0, -180], -LIMIT)):
        label = "no distance moves a corner here" if limit > 0 else None
        axes.fill_between(side, turn, limit, color=GREY, alpha=0.18, linewidth=0, label=label)
    axes.set(xlabel="azimuth, deg: ahead 0, left positive", ylabel="shift, columns", ylim=(-LIMIT, LIMIT))
    axes.set_xticks(range(180, -181, -45))
    axes.legend(frameon=False, loc="upper left", fontsize=8)
    elapsed = seconds(drive)[BETWEEN[1]] - seconds(drive)[BETWEEN[0]]
    picture.set_title(
        f"{elapsed:.1f} s of driving straight ahead: the left moves left, the right moves right", fontsize=9
    )
    save(figure, "parallax")
    print(f"turn {turn:.2f} columns, {good.sum()} corners")
    for name, side in (("left", (azimuth > 5) & (azimuth < 175)), ("right", (azimuth < -5) & (azimuth > -175))):
        print(name, np.percentile(shift[side] - turn, [2, 25, 50, 75, 98]).round(2))


if __name__ == "__main__":
    main()
