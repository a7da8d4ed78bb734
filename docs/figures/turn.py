"""A panorama before and after a turn to the left, and the yaw that the compass makes of it: writes turn.png."""

import numpy as np
from common import BLUE, GREY, ORANGE, drive_of, plt, save, seconds
from matplotlib.patches import ConnectionPatch

from compass import CompassConfig, VisualCompass

BEFORE, AFTER, LAST = 8, 20, 100  # frames
MARK_ROW = 0.68  # where the arrow runs, a fraction of the height


def main() -> None:
    """Write the picture."""
    drive = drive_of()
    t, truth = seconds(drive), np.degrees(drive.frame_truth.yaw - drive.frame_truth.yaw[0])
    compass, yaws, config = VisualCompass(), [], CompassConfig()
    for index in range(LAST):
        compass.update(int(drive.frame_truth.t_ns[index]), drive.frame(index))
        yaws.append(np.degrees(compass.yaw))

    figure = plt.figure(figsize=(11.0, 4.9))
    grid = figure.add_gridspec(2, 2, width_ratios=(1.9, 1.0), hspace=0.06, wspace=0.16)
    panoramas = [figure.add_subplot(grid[row, 0]) for row in (0, 1)]
    shown = drive.frame(BEFORE)
    height, width = shown.shape
    column = 0.455 * width  # of the door
    shift = (yaws[AFTER] - yaws[BEFORE]) * width / 360.0
    for axes, index, colour, at in zip(
        panoramas, (BEFORE, AFTER), (BLUE, ORANGE), (column, column + shift), strict=True
    ):
        axes.imshow(drive.frame(index)[: int(0.78 * height)], cmap="gray", vmin=0, vmax=255)
        axes.axhspan(config.roi_top * height, config.roi_bottom * height, color=colour, alpha=0.12, linewidth=0)
        axes.axvline(at, color=colour, linewidth=1.6)
        axes.set(xticks=[], yticks=[])
        axes.text(
            0.012, 0.93, f"{t[index]:.1f} s", transform=axes.transAxes, va="top", color="white", weight="bold",
            bbox={"facecolor": colour, "edgecolor": "none", "pad": 2.0},
        )  # fmt: skip
        for spine in axes.spines.values():
            spine.set_visible(False)
    row = MARK_ROW * height
    panoramas[1].arrow(
        column, row, shift, 0, color=ORANGE, width=4, head_width=18, head_length=18, length_includes_head=True
    )
    panoramas[1].text(column + shift + 12, row, f"{shift:.1f} columns right", va="center", color="white", weight="bold")
    panoramas[1].add_artist(
        ConnectionPatch((column, 0.78 * height), (column, 0), "data", "data", axesA=panoramas[0], axesB=panoramas[1],
                        color=BLUE, linestyle=":")
    )  # fmt: skip

    axes = figure.add_subplot(grid[:, 1])
    axes.plot(t[:LAST], truth[:LAST], color=GREY, linewidth=6.0, alpha=0.5, label="truth")
    axes.plot(t[:LAST], yaws, color="black", linewidth=1.3, label="compass")
    for index, colour, offset in ((BEFORE, BLUE, (-8, 10)), (AFTER, ORANGE, (9, -5))):
        axes.plot(t[index], yaws[index], "o", color=colour, markersize=8)
        axes.annotate(f"{yaws[index]:.1f}", (t[index], yaws[index]), offset, textcoords="offset points", color=colour)
    axes.set(xlabel="s", ylabel="yaw, deg (left is positive)")
    axes.legend(frameon=False, loc="upper left")
    save(figure, "turn")


if __name__ == "__main__":
    main()
