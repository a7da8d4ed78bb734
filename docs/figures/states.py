"""The states of the filter and the past yaws (clones) among them, which increments refer to: writes states.png."""

from common import BLUE, GREEN, GREY, ORANGE, plt, save

STATES = (  # name, group
    ("yaw", "motion"),
    ("turn rate", "motion"),
    ("acceleration", "motion"),
    ("gyro bias", "gyro"),
    ("cross bias", "gyro"),
    ("gyro scale", "gyro"),
    ("track scale", "tracks"),
    ("veer", "tracks"),
    ("slip", "tracks"),
    ("track error", "tracks"),
    ("compass error", "compass"),
    ("baseline error", "compass"),
    ("camera delay", "compass"),
)
COLOURS = {"motion": "black", "gyro": GREEN, "tracks": "#cc79a7", "compass": BLUE}
IMAGES = (0.9, 2.0, 3.4, 4.6, 5.6)  # when those were exposed whose yaws are kept
NOW, REFERENCE = 6.6, 4.1


def main() -> None:
    """Write the picture."""
    figure, (boxes, axes) = plt.subplots(
        2, 1, figsize=(9.0, 3.9), height_ratios=(1.0, 1.9), gridspec_kw={"hspace": 0.05}
    )
    for place, (name, group) in enumerate(STATES):
        boxes.text(
            place + 0.5, 0.5, name.replace(" ", "\n"), ha="center", va="center", color="white", fontsize=7
        )  # fmt: skip
        boxes.add_patch(plt.Rectangle((place + 0.03, 0.05), 0.94, 0.9, color=COLOURS[group]))
    boxes.add_patch(plt.Rectangle((len(STATES) + 0.03, 0.05), 2.0, 0.9, color=ORANGE))
    boxes.text(len(STATES) + 1.03, 0.5, "past yaws\n(clones)", ha="center", va="center", color="white", weight="bold")
    boxes.set(xlim=(0, len(STATES) + 2.1), ylim=(0, 1))
    boxes.axis("off")

    axes.axhline(0.0, color=GREY, linewidth=1.0)
    for t in IMAGES:
        axes.plot(t, 0.0, "o", color=ORANGE, markersize=9)
    axes.plot(REFERENCE, 0.0, "D", color=ORANGE, markersize=8)
    axes.plot(NOW, 0.0, "o", color="black", markersize=11)
    axes.text(NOW, -0.28, "yaw now", ha="center", va="top", weight="bold")
    axes.text(REFERENCE, -0.28, "start of the\ntracks' interval", ha="center", va="top", color="#cc79a7")
    axes.text(1.45, -0.28, "yaws at the exposures of images", ha="center", va="top", color=ORANGE)
    for start, end, bend, colour, text, height in (
        (IMAGES[2], IMAGES[4], -0.45, BLUE, "increment from a keyframe", 0.28),
        (IMAGES[0], IMAGES[4], -0.38, BLUE, "increment over a long baseline", 1.2),
        (REFERENCE, NOW, 0.35, "#cc79a7", "turn by the tracks", -0.75),
    ):
        axes.annotate(
            "", (end, 0.0), (start, 0.0),
            arrowprops={
                "arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 6, "shrinkB": 6,
                "connectionstyle": f"arc3,rad={bend}",
            },
        )  # fmt: skip
        axes.text((start + end) / 2, height, text, ha="center", va="center", color=colour)
    axes.set(xlim=(0, 7.4), ylim=(-1.0, 1.35))
    axes.axis("off")
    save(figure, "states")


if __name__ == "__main__":
    main()
