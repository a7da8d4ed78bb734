"""Is `visual-compass fuse` faster than decoding its panoramas once, at full size, on one thread?

Writes bags of 2048 x 1024 JPEG panoramas at 30 Hz with a gyro at 200 Hz and odometry at 50 Hz, times
`cv2.imdecode(..., IMREAD_GRAYSCALE)` over all of them on one thread, then the command over the bag, its start included:
a short bag, of whose time the start is a sixth, and a longer one. Best of some each, in turn, so that a busy machine
disturbs both alike. `--markdown FILE` writes the section of that file as well.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fusion.offline.bag_writer import BagWriter
from fusion.offline.markdown import markdown_table, write_section

START_NS = 1_700_000_000_000_000_000
WIDTH, HEIGHT = 2048, 1024
LAP = 900  # images, two turns: a longer bag repeats them
RATE = 2.0 * math.tau / (LAP / 30.0)  # rad/s
LENGTHS = (30.0, 90.0)  # s


def panorama(seed: int = 0) -> np.ndarray:
    """A scene with detail of every size, as photographs have it: its spectrum falls with frequency."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH))
    radius = np.hypot(np.fft.fftfreq(HEIGHT)[:, None] * 2, np.fft.rfftfreq(WIDTH)[None, :])
    scene = np.fft.irfft2(np.fft.rfft2(noise) / np.maximum(radius, 1.0 / WIDTH) ** 1.2, (HEIGHT, WIDTH))
    return np.clip(128 + 45 * scene / scene.std(), 0, 255).astype(np.float32)


def jpegs() -> list[bytes]:
    """JPEG files of a lap."""
    scene, rng = panorama(), np.random.default_rng(1)
    pictures = []
    for index in range(LAP):
        shift = round(RATE * index / 30 * WIDTH / math.tau)
        image = np.roll(scene, shift, axis=1) + rng.normal(0.0, 2.0, scene.shape).astype(np.float32)
        jpeg = cv2.imencode(".jpg", np.clip(image, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        pictures.append(jpeg.tobytes())
    return pictures


def write_bag(path: Path, pictures: list[bytes]) -> None:
    """Write a bag of these JPEG files, one after another, and of what the other sensors say meanwhile."""
    seconds = len(pictures) / 30.0
    with BagWriter(path) as bag:
        for index, picture in enumerate(pictures):
            bag.write_jpeg("/viz/pano/image/compressed", START_NS + index * 1_000_000_000 // 30, picture)
        for index in range(int(seconds * 200)):
            bag.write_imu("/imu/data", START_NS + index * 5_000_000, (0.0, 0.0, RATE), (0.0, 0.0, 9.81))
        for index in range(int(seconds * 50)):
            bag.write_odometry("/odom", START_NS + index * 20_000_000, RATE * index / 50, RATE)


def decode_once(pictures: list[bytes]) -> None:
    """Every picture to grey at full size, on one thread."""
    for picture in pictures:
        cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE)


def seconds_of(work: Callable[[], object]) -> tuple[float, float]:
    """Wall time of a call, and processor time of this process and those it waited for."""
    wall, used = time.perf_counter(), os.times()
    work()
    return time.perf_counter() - wall, sum(os.times()[:4]) - sum(used[:4])


@dataclass(frozen=True)
class Times:
    """Of a bag: panoramas; wall and processor time of decoding them and of the command, s, the best of some runs."""

    panoramas: int
    decode: float
    decode_cpu: float
    fuse: float
    fuse_cpu: float


def times_of(pictures: list[bytes], runs: int) -> Times:
    """Write a bag of these pictures, and take the times."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bench.mcap"
        write_bag(bag, pictures)
        command = [sys.executable, "-m", "fusion.offline.cli", "fuse", str(bag), "--out", str(Path(folder) / "out")]
        rounds = [
            (
                *seconds_of(lambda: decode_once(pictures)),
                *seconds_of(lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL)),
            )
            for _ in range(runs)
        ]
    return Times(len(pictures), *map(min, zip(*rounds, strict=True)))


def main() -> None:
    """Print the times and their ratios."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, nargs="+", default=LENGTHS, help="lengths of the bags")
    arguments.add_argument("--markdown", type=Path, help="write the section of this file, too")
    parsed = arguments.parse_args()
    cv2.setNumThreads(1)
    lap, cores, rows = jpegs(), len(os.sched_getaffinity(0)), []
    print(f"JPEG panoramas of {WIDTH} x {HEIGHT}, {sum(map(len, lap)) / LAP / 1e3:.0f} kB; {cores} cores")
    for seconds in parsed.seconds:
        count = int(seconds * 30)
        times = times_of((lap * -(-count // LAP))[:count], 3 if seconds <= LENGTHS[0] else 2)
        wall, used = times.fuse / times.decode, times.fuse_cpu / times.decode_cpu
        print(f"{count} panoramas")
        print(f"  decode at full size, one thread {times.decode:6.2f} s  {1e3 * times.decode / count:5.1f} ms each")
        print(f"  fuse, start and plot included   {times.fuse:6.2f} s  {1e3 * times.fuse / count:5.1f} ms each")
        print(f"  fuse / decode                   {wall:6.2f}    aim: at most 1")
        print(f"  the same in processor time      {used:6.2f}")
        rows.append((f"{seconds:g} s", str(count), f"{wall:.2f}", f"{used:.2f}"))
    if parsed.markdown:
        text = f"""## Fusing a bag

`visual-compass fuse` over JPEG panoramas of {WIDTH} x {HEIGHT} that turn, gyro at 200 Hz and odometry at 50 Hz, its
start and its plot included, as a multiple of `cv2.imdecode` of the same panoramas at full size on one thread; best of
three runs, of the longer bag of two, on {cores} cores, which other programs use as well. The aim is 1.

{markdown_table(("bag", "panoramas", "time", "processor time, all processes"), rows)}"""
        write_section(parsed.markdown, "fusing a bag", text)


if __name__ == "__main__":
    main()
