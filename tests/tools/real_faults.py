"""Faults on a drive whose images are real: a hand-held walk, turned as a robot turns, and measured by the compass.

    PYTHONPATH=tests python -m tools.real_faults [--seeds 1] [--first-seed 0] [--only "GC G"]

Each panorama of the walk is turned by the yaw of a drive of legs and stops, which changes a panorama in no other way.
Gyro and tracks are those of the simulator at the walk's own turn plus that. First every line of the table of faults
(`make torture`) on what the compass makes of these images; then faults of the pictures themselves. A line for each that
is beyond four deviations, or is too unsure, or not named; then how many are none of that.

The walk's own yaw is its file's truth, corrected for its drift against the hall's vanishing point (`tools.walk_table`),
and between these frames, ten apart, what the compass shows of another region.
"""

import argparse
import json
import math
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from robot_drive import HZ, RobotDrive, legs, sensed
from scipy.interpolate import CubicSpline
from torture.drives import SECONDS
from torture.rows import ANY, DISAGREE, MAY, SCALE, SILENT, Row, all_rows
from torture.verdict import try_on

from compass import VisualCompass, YawIncrement
from tools.walk_table import RATE_HZ, VIDEO, headings, walked

STEP = 2  # frames: 15 Hz
OTHER_REGION = (0.3, 0.6)
WALK_SPEED = 1.2  # m/s
DRIFT, APART = math.radians(0.4), math.radians(0.15)  # by which the truth may err at the end, and anywhere
BEGINS = 14.0  # s
NO_TURN = ("images_do_not_turn", "images_mirrored", "sensor_refused", DISAGREE, SCALE)
DARK = ("images_empty", SILENT, "turn_lost")


def walk():
    """Frames of the walk in grey, and the camera's yaw at each, rad."""
    video, frames = cv2.VideoCapture(str(VIDEO / "corridor_walk.mp4")), []
    while (read := video.read())[0]:
        frames.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2GRAY))
    truth = json.loads((VIDEO / "corridor_walk_truth.json").read_text())
    at, true = np.array(truth["frame"]), np.array(truth["yaw_deg"])
    hall = headings(frames[index] for index in at)
    true = true - np.polyfit(at / at[-1], true - hall, 1)[0] * at / at[-1]
    (index, fine, _), _, _ = walked(frames, OTHER_REGION, 1)
    every = np.minimum(index, at[-1])
    return frames, np.radians(CubicSpline(at, true - fine[at.astype(int)])(every) + fine)


def turned(image, angle):
    """The panorama as a camera sees it that has turned left by `angle`, rad, on the spot: it moves to the right."""
    width = image.shape[1]
    whole, part = divmod(angle / math.tau * width, 1.0)
    image = np.roll(image, int(whole), axis=1)
    around = np.concatenate([image[:, -4:], image, image[:, :4]], axis=1)
    across, down = np.meshgrid(
        np.arange(width, dtype=np.float32) + np.float32(4.0 - part), np.arange(len(image), dtype=np.float32)
    )
    return cv2.remap(around, across, down, cv2.INTER_CUBIC)


class RealDrive:
    """A drive through the hall: images as they are, and what gyro and tracks say of it.

    Parameters
    ----------
    frames : list of ndarray
    walked : ndarray
        Yaw of the camera at each frame, rad.
    seed : int
        Of legs, stops and sensors.
    """

    def __init__(self, frames, walked, seed):
        rng = np.random.default_rng(seed)
        t = np.arange(round(HZ * SECONDS)) / HZ
        own = np.interp(t, np.arange(len(walked)) / RATE_HZ, walked)
        own = np.convolve(np.pad(own, 50, mode="edge"), np.ones(101) / 101, mode="valid")
        rate, _ = legs(rng, t.size)
        self._added = np.cumsum(rate) / HZ
        yaw = own + self._added
        speed = np.full(t.size, WALK_SPEED)
        others = sensed(rng, np.gradient(yaw, 1.0 / HZ), speed, veer=0.0)
        self._frames, self._others = frames, [s for s in others.samples if not isinstance(s, YawIncrement)]
        self._t, self._yaw = t, yaw - yaw[0]

    def images(self):
        """(s, panorama, turn that was added, rad) of each."""
        for index in range(0, len(self._frames), STEP):
            at = index / RATE_HZ
            if at < SECONDS:
                yield at, self._frames[index], float(np.interp(at, self._t, self._added))

    def measured(self, change=lambda at, image, added: turned(image, added)):
        """The drive as `torture` takes it: by images each of which is what `change` makes of it (None: none)."""
        compass, samples = VisualCompass(), list(self._others)
        for at, frame, added in self.images():
            image = change(at, frame, added)
            if image is not None:
                found = compass.update(round(at * 1e9), image), compass.long_baseline()
                samples += [one for one in found if one]
        samples.sort(key=lambda sample: sample.t_ns)
        truth_sigma = np.hypot(DRIFT * self._t / SECONDS, APART)
        return RobotDrive(self._t, self._yaw, samples, truth_sigma=truth_sigma)


def _from(since, change, until=math.inf):
    """A change of the picture between two times, s, and a picture that only turns before and after."""

    def one(at, image, added):
        image = turned(image, added)
        return change(at, image) if since <= at < until else image

    return one


def _hidden(since, until):
    """These columns, as shares of the width, show something that stays where it is on the robot."""

    def change(at, image):
        image, width = image.copy(), image.shape[1]
        image[:, int(since * width) : int(until * width)] = 30
        return image

    return change


def _noisy(sigma):
    rng = np.random.default_rng(1)
    return lambda at, image: np.clip(image + rng.normal(0.0, sigma, image.shape), 0, 255).astype(np.uint8)


def _passing(other, share, speed):
    """A share of the width shows another scene, which moves by so many columns a second; as a camera sees it, noisy."""
    noisy = _noisy(3.0)

    def change(at, image):
        image, width = image.copy(), int(share * image.shape[1])
        image[:, :width] = np.roll(other, round(speed * at), axis=1)[:, :width]
        return noisy(at, image)

    return change


def _held(since, until):
    """Turn that was added, held between two times: images that hang, or that a stabiliser keeps from turning."""
    last = []

    def change(at, image, added):
        if since <= at < until:
            last.append((image, added))
            return last[0]
        return image, added

    return change


def picture_faults(frames):
    """(row, change of image and turn) for each fault of the pictures; the row says what is expected."""
    jpeg = lambda at, image: cv2.imdecode(cv2.imencode(".jpg", image, [1, 10])[1], 0)  # noqa: E731
    other = frames[700][:, ::-1]
    hang, stay = _held(BEGINS, BEGINS + 4.0), _held(BEGINS, math.inf)
    row = partial(Row, faulty="C", make=lambda: lambda ride, stream, since, until: stream, words=MAY)
    named = partial(row, words="named", since=BEGINS)
    always = partial(row, words="named", since=0.0, most_sigma=ANY)
    yield row("none", faulty=""), _from(0.0, lambda at, image: image)
    yield row("JPEG of quality 10"), _from(0.0, jpeg)
    yield row("noise of 20 grey values"), _from(0.0, _noisy(20.0))
    flicker = lambda at, image: np.clip(image * (1.0 + 0.6 * math.sin(15.0 * at)), 0, 255).astype(np.uint8)  # noqa: E731
    yield row("flickers by 60 %"), _from(0.0, flicker)
    for hertz in (5, 1):
        yield (
            row(f"{hertz} Hz", most_sigma=ANY),
            lambda at, image, added, hertz=hertz: None if round(15 * at) % (15 // hertz) else turned(image, added),
        )
    yield named("dark for 4 s", codes=DARK, seconds=4.0), _from(BEGINS, lambda at, image: image // 50, BEGINS + 4.0)
    yield named("hangs for 4 s", codes=("images_frozen", SILENT), seconds=4.0), lambda *one: turned(*hang(*one))
    yield named("stabilised", codes=NO_TURN), lambda at, image, added: turned(image, stay(at, None, added)[1])
    yield always("mirrored", codes=NO_TURN), _from(0.0, lambda at, image: image[:, ::-1].copy())
    yield always("turns by 0.97 of it", codes=(SCALE,)), lambda at, image, added: turned(image, 0.97 * added)
    yield always("turns by 1.05 of it", codes=(SCALE,)), lambda at, image, added: turned(image, 1.05 * added)
    for share, speed in ((0.3, 0.0), (0.4, 50.0), (0.5, -15.0)):
        yield (
            row(f"{share:.0%} shows what moves by {speed:.0f} columns/s", since=BEGINS, most_sigma=ANY),
            _from(BEGINS, _passing(other, share, speed)),
        )
    yield row("40 % hidden behind the robot", since=BEGINS, most_sigma=ANY), _from(BEGINS, _hidden(0.2, 0.6))


def line(result):
    """A result as text."""
    row, named = result.row, ", ".join(sorted(result.warnings))
    return (
        f"{result.seed} {row.who} {row.faulty or '-'} {row.name}: {result.error:.2f} +- {result.sigma:.2f} deg at the"
        f" end, {result.worst:.1f} at worst, {result.ratio:.1f} deviations, beyond 4 for {result.over4:.1f} s;"
        f" {named or 'nobody named'}: {'; '.join(result.faults) or 'ok'}"
    )


def results(frames, walked, seed, only):
    """Of all rows, then of all faults of the pictures, with and without tracks or gyro."""
    drive = RealDrive(frames, walked, seed)
    sound = drive.measured()
    for row in all_rows():
        if only in f"{row.who} {row.faulty} {row.name}" and not row.lifted and "C" in row.who:
            yield try_on(row, sound, "walk", seed)
    for row, change in picture_faults(frames):
        if only in f"GTC {row.faulty} {row.name}":
            faulty = drive.measured(change)
            for who, sigma in (("GTC", row.most_sigma), ("GC", ANY), ("TC", ANY)):
                if who != "TC" or row.codes != (
                    SCALE,
                ):  # of images whose factor is wrong tracks of any factor know nothing
                    yield try_on(replace(row, who=who, most_sigma=sigma), faulty, "walk", seed)


def main():
    """Run all, print what does not pass, and how many do."""
    parser = argparse.ArgumentParser(
        "real_faults", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--only", default="", help="only lines that contain this text: 'GC G'")
    parser.add_argument("--all", action="store_true", help="print those that pass, too")
    args = parser.parse_args()
    frames, walked = walk()
    found = []
    for seed in range(args.first_seed, args.first_seed + args.seeds):
        for result in results(frames, walked, seed, args.only):
            found.append(result)
            if result.faults or args.all:
                print(line(result), flush=True)
    passed, beyond = sum(not one.faults for one in found), sum(one.over4 > 1.0 for one in found)
    print(f"{passed} of {len(found)} pass, {beyond} are beyond 4 deviations for more than a second")


if __name__ == "__main__":
    main()
