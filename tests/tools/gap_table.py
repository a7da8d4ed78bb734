"""Views of simulated drives some seconds apart: matched across a gap, and over long baselines.

    PYTHONPATH=tests python -m tools.gap_table

Of seeds 0, 7 and 14, one of each world; the frames are rendered first, unless `simulate` or `evaluate` has done so.
"""

import argparse
import math
from itertools import combinations

import numpy as np
from panoramas import PHOTO_NAMES, PHOTOS, as_bytes, azimuths, photo, seen_from, shifted

from compass import CompassConfig, CompassStatus, wrap_angle
from compass.features.matching import follow_landmarks, match_landmarks
from compass.images.strip import prepare_strip
from compass.methods.match import Search
from compass.tilt import Tilted
from fusion.simulation import simulate

WIDTH, SEEDS, GAPS = 1024, (0, 7, 14), (1.0, 4.5)  # s apart
PLACES = (  # drives of one line are in one place
    ("dark_gap", "demo"), ("square20", "stop_and_go"), ("crowd",), ("free_race_outdoor", "spin5_yard"), ("weave",),
    ("rough_ground",), ("free_race_passage",), ("symmetric_corridor",),
)  # fmt: skip
LOOKED_BACK = 1, 2, 4  # s
DARK = (7.4, 10.6)  # s
UNRELATED = 600


class View:
    """A frame: what the compass makes of it, and the truth."""

    def __init__(self, drive, index):
        truth, t_ns = drive.frame_truth, int(drive.frame_truth.t_ns[index])
        self.t = 1e-9 * (t_ns - int(drive.frame_truth.t_ns[0]))
        self.strip = prepare_strip(t_ns, drive.frame(index), CompassConfig())
        self.yaw, roll, pitch = (float(values[index]) for values in (truth.yaw, truth.roll, truth.pitch))
        self.up = -math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)


def found(before, now):
    """Match of two strips; None where it is refused."""
    match = match_landmarks(before, now, Search(0.0, WIDTH, WIDTH / 2))
    return match if match.status is CompassStatus.OK else None


def error(before, now, match):
    """Error of the change of heading and its variance, rad, rad^2; the true lean is known."""
    heading = Tilted.upright(before.up).after(match.shift_px * math.tau / WIDTH, match.tilt)[1]
    return wrap_angle(heading - (now.yaw - before.yaw)), match.variance_px2 * (math.tau / WIDTH) ** 2


def px_error(match, turn_px):
    """The same of a camera that stands upright."""
    per_px = math.tau / WIDTH
    return wrap_angle((match.shift_px - turn_px) * per_px), match.variance_px2 * per_px**2


def looked_back(name, worlds, apart):
    """Views of one drive so many seconds apart, the turn known to 0.6 deg, three deviations."""
    rng, count, errors = np.random.default_rng(0), 0, []
    for views in worlds:
        for one, other in combinations(views, 2):
            if abs(other.t - one.t - apart) < 0.3:
                count += 1
                expected = wrap_angle(other.yaw - one.yaw) + math.radians(0.2) * rng.normal()
                search = Search(expected * WIDTH / math.tau, WIDTH / 360 * 0.6, WIDTH / 2)
                match = follow_landmarks(one.strip, other.strip, search)
                if match.status is CompassStatus.OK:
                    errors.append(error(one, other, match))
    report(f"{name}, {apart} s", count, errors)


def report(name, count, errors):
    """One line: pairs, share found, RMS and worst error in deg, mean squared error over variance."""
    line = f"{name}: {count} pairs, {100.0 * len(errors) / count:.0f} % found"
    if errors:
        error, variance = np.array(errors).T
        rms, worst = np.rad2deg([np.sqrt(np.mean(error**2)), np.abs(error).max()])
        line += f", RMS {rms:.3f}, worst {worst:.2f} deg, error^2 / variance {np.mean(error**2 / variance):.1f}"
    print(line, flush=True)


def views_of(name, seed):
    """About one frame a second; in the dark none."""
    drive = simulate(name, seed)
    t = 1e-9 * (drive.frame_truth.t_ns - drive.frame_truth.t_ns[0])
    indices = np.unique(np.searchsorted(t, np.arange(0.0, t[-1], 1.0)))
    return [View(drive, i) for i in indices if name != "dark_gap" or not DARK[0] < t[i] < DARK[1]]


def same_place(name, worlds):
    """Views of one drive, `GAPS` apart; those of `dark_gap` on either side of the dark."""
    count, errors = 0, []
    for views in worlds:
        for one, other in combinations(views, 2):
            apart = other.t - one.t
            across = one.t < DARK[0] < DARK[1] < other.t and apart < 6.0
            if across if name == "dark_gap" else GAPS[0] <= apart <= GAPS[1]:
                count += 1
                match = found(one.strip, other.strip)
                if match:
                    errors.append(error(one, other, match))
    report(name, count, errors)


def different_places(views):
    """Views of drives in places that have nothing in common."""
    rng, accepted = np.random.default_rng(0), 0

    def any_view(place):
        of_a_drive = views[str(rng.choice(PLACES[place]))][int(rng.integers(len(SEEDS)))]
        return of_a_drive[int(rng.integers(len(of_a_drive)))]

    for _ in range(UNRELATED):
        one, other = (any_view(place) for place in rng.choice(len(PLACES), 2, replace=False))
        accepted += found(one.strip, other.strip) is not None
    print(f"different places: {UNRELATED} pairs, {accepted} taken for one", flush=True)


def past_walls(name, strip, left, right, seed):
    """Error and variance, if found, of a photograph driven 1 m in any direction between two walls and turned."""
    direction, turn = np.random.default_rng(seed).uniform(-math.pi, math.pi, 2)
    turn_px = turn * WIDTH / math.tau
    on_the_left = np.sin(azimuths(WIDTH) - direction) > 0.0
    after = seen_from(photo(name), 1.0, direction, np.where(on_the_left, left, right))
    match = found(strip, prepare_strip(1, as_bytes(shifted(after, turn_px), 2.0, seed), CompassConfig()))
    return match and px_error(match, turn_px)


def photographs():
    """Each photograph turned by any angle, dimmed and noisy; as seen 1 m further on; and each with each other."""
    if not PHOTOS.is_dir():
        print("photographs: they are not there")
        return
    rng, errors, count = np.random.default_rng(0), [], 0
    strips = [prepare_strip(0, as_bytes(photo(name), 2.0, k), CompassConfig()) for k, name in enumerate(PHOTO_NAMES)]
    for name, strip in zip(PHOTO_NAMES, strips, strict=True):
        for noise in (2.0, 4.0, 8.0) * 4:
            count, turn_px = count + 1, rng.uniform(-512.0, 512.0)
            dimmed = rng.uniform(0.6, 1.0) * shifted(photo(name), turn_px)
            match = found(strip, prepare_strip(1, as_bytes(dimmed, noise, count), CompassConfig()))
            if match:
                errors.append(px_error(match, turn_px))
    report("photographs turned", count, errors)
    for left, right in ((3.0, 3.0), (1.5, 4.0)):
        pairs = [
            past_walls(name, strip, left, right, k)
            for name, strip in zip(PHOTO_NAMES, strips, strict=True)
            for k in range(8)
        ]
        report(f"photographs past walls {left} and {right} m away", len(pairs), [pair for pair in pairs if pair])
    pairs = list(combinations(strips, 2))
    accepted = sum(found(*pair) is not None for pair in pairs)
    print(f"different photographs: {len(pairs)} pairs, {accepted} taken for one", flush=True)


def main():
    """Print all tables."""
    argparse.ArgumentParser(
        "gap_table", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    ).parse_args()
    photographs()
    views = {name: [views_of(name, seed) for seed in SEEDS] for place in PLACES for name in place}
    for name, worlds in views.items():
        for apart in LOOKED_BACK:
            looked_back(name, worlds, apart)
    for name, worlds in views.items():
        same_place(name, worlds)
    different_places(views)


if __name__ == "__main__":
    main()
