"""The region of interest of a panorama, and what is left out and why: writes region.png."""

from common import ORANGE, drive_of, plt, save

from compass import CompassConfig


def main() -> None:
    """Write the picture."""
    frame, config = drive_of().frame(8), CompassConfig()
    height, width = frame.shape
    top, bottom = config.roi_top * height, config.roi_bottom * height
    figure, axes = plt.subplots(figsize=(7.5, 3.75))
    axes.imshow(frame, cmap="gray", vmin=0, vmax=255)
    for low, high in ((0, top), (bottom, height)):
        axes.axhspan(low, high, color="black", alpha=0.45, linewidth=0)
    axes.axhspan(top, bottom, facecolor="none", edgecolor=ORANGE, linewidth=2.0)
    for y, text in (
        (0.5 * top, "above: near when driving indoors, distorted"),
        (bottom - 36, f"region of interest: {config.roi_top:g} to {config.roi_bottom:g} of the height"),
        (0.5 * (bottom + height), "below: the ground close by, and the robot itself"),
    ):
        axes.text(0.5 * width, y, text, color="white", ha="center", va="center", weight="bold")
    axes.axhline(config.horizon_row * height, color="white", linestyle="--", linewidth=0.8)
    axes.text(width - 6, config.horizon_row * height - 4, "horizon", color="white", ha="right", va="bottom", fontsize=7)
    axes.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))
    save(figure, "region")


if __name__ == "__main__":
    main()
