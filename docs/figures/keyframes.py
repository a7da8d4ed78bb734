"""Increments from keyframes and over long baselines, as the compass gives them on a drive: writes keyframes.png."""

import numpy as np
from common import BLUE, GREY, ORANGE, drive_of, plt, save, seconds

from compass import VisualCompass

FRAMES = range(90, 176)  # of demo: stands, drives along a wall, turns into a bend


def main() -> None:
    """Write the picture."""
    drive = drive_of()
    compass, keyframes, baselines = VisualCompass(), {}, []
    for index in FRAMES:
        increment = compass.update(int(drive.frame_truth.t_ns[index]), drive.frame(index))
        if increment is not None:
            keyframes.setdefault(increment.t_ref_ns, []).append(increment.t_ns)
        baseline = compass.long_baseline()
        if baseline is not None:
            baselines.append(baseline)

    start = int(drive.frame_truth.t_ns[FRAMES[0]])
    figure, (steps, arcs, axes) = plt.subplots(
        3, 1, figsize=(8.0, 4.6), sharex=True, height_ratios=(1.3, 0.9, 0.9), gridspec_kw={"hspace": 0.15}
    )
    for line, (reference, ends) in enumerate(keyframes.items()):
        for end in ends:
            steps.plot(1e-9 * (np.array([reference, end]) - start), [line, line], color=BLUE, linewidth=0.8, alpha=0.4)
        steps.plot(1e-9 * (np.array(ends) - start), np.full(len(ends), line), "|", color=BLUE, markersize=4)
        steps.plot(1e-9 * (reference - start), line, "s", color=BLUE, markersize=4)
    steps.invert_yaxis()
    steps.set(yticks=[], ylabel="keyframes")
    steps.set_title("squares: keyframes; each increment starts at one and ends at an image", fontsize=9)
    for one in baselines:
        a, b = 1e-9 * (one.t_ref_ns - start), 1e-9 * (one.t_ns - start)
        angle = np.linspace(0.0, np.pi, 40)
        arcs.plot((a + b) / 2 - (b - a) / 2 * np.cos(angle), (b - a) * np.sin(angle), color=ORANGE, linewidth=1.2)
    arcs.set(yticks=[], ylabel="long\nbaselines")
    t = seconds(drive)[FRAMES.start : FRAMES.stop]
    yaw = np.degrees(drive.frame_truth.yaw[FRAMES.start : FRAMES.stop])
    axes.plot(t - t[0], yaw - yaw[0], color=GREY, linewidth=2.0)
    axes.set(ylabel="true yaw,\ndeg", xlabel="s")
    save(figure, "keyframes")
    print(f"{len(keyframes)} keyframes, {len(baselines)} long baselines")


if __name__ == "__main__":
    main()
