"""How errors of the compass go together: within a keyframe, from keyframe to keyframe, and over long baselines.

    PYTHONPATH=tests python -m tools.correlation_table crowd weave [--worlds tuned] [--seeds N]

A line for each drive: error^2/variance of the increments; correlation of the normalised errors of successive increments
of one keyframe, and of the last increments of keyframes 1, 2 and 4 apart; error^2/variance of the long baselines, and
how their errors go along with those of the increments that span the same time, as sums, rad against rad.
"""

import argparse
from itertools import pairwise

import numpy as np

from compass import wrap_angle
from fusion.offline.run import fuse_recording
from fusion.offline.scores import yaw_at
from fusion.offline.simulated import SimulatedRecording
from fusion.settings import Settings
from fusion.simulation import EXPERIMENTS, simulate
from fusion.simulation.worlds import TUNED_WORLDS

LAGS = 1, 2, 4  # keyframes


def errors(increments, exposed_ns, truth):
    """Reference and end (stamps, ns), error and standard deviation (rad) of each increment."""
    rows = []
    for one in increments:
        since, until = yaw_at(truth, np.array([exposed_ns[one.t_ref_ns], exposed_ns[one.t_ns]]))
        rows.append((one.t_ref_ns, one.t_ns, float(wrap_angle(one.yaw - (until - since))), one.variance**0.5))
    return rows


def correlation(pairs):
    """Of pairs of errors, whose mean is not taken off: one that all have in common counts."""
    a, b = np.array(list(pairs) or [(np.nan, np.nan)]).T
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def line(name, seed, worlds):
    """What one drive gives, as text."""
    recording = SimulatedRecording(simulate(name, seed, worlds=worlds), Settings().imu)
    run = fuse_recording(recording, Settings())
    readings = [row.compass for row in run.rows if row.compass]
    truth, exposed_ns = recording.truth, recording.exposed_ns
    near = errors([one.increment for one in readings if one.increment], exposed_ns, truth)
    far = errors([one.long_baseline for one in readings if one.long_baseline], exposed_ns, truth)
    z = [error / sigma for _, _, error, sigma in near]
    within = correlation((z[i], z[i + 1]) for i in range(len(z) - 1) if near[i][0] == near[i + 1][0])
    last = [k for k, (one, other) in enumerate(pairwise(near)) if one[0] != other[0]]
    between = [correlation((z[i], z[j]) for i, j in zip(last, last[lag:], strict=False)) for lag in LAGS]
    summed = {near[0][0]: 0.0}  # error of the sum of the increments, by image
    for since, until, error, _ in near:
        if since in summed:
            summed[until] = summed[since] + error
    spans = [(error, summed[t] - summed[s]) for s, t, error, _ in far if s in summed and t in summed]
    of_far = np.mean([(error / sigma) ** 2 for _, _, error, sigma in far]) if far else np.nan
    lags = " ".join(f"{value:5.2f}" for value in between)
    return (
        f"{name} {seed}: {np.mean(np.square(z)):.2f}, within {within:.2f}, between {lags}; "
        f"long baselines {of_far:.2f}, with the sum {correlation(spans):.2f}"
    )


def main():
    """Print a line for each drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", nargs="*", default=[name for name in EXPERIMENTS if name != "shifted"])
    parser.add_argument("--worlds", default=TUNED_WORLDS)
    parser.add_argument("--seeds", type=int, default=1)
    arguments = parser.parse_args()
    for name in arguments.drives:
        for seed in range(arguments.seeds):
            print(line(name, seed, arguments.worlds), flush=True)


if __name__ == "__main__":
    main()
