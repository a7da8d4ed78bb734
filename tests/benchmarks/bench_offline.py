"""Is `visual-compass fuse` faster than decoding its panoramas once, at full size, on one thread?

Writes a bag of 2048 x 1024 JPEG panoramas at 30 Hz with a gyro at 200 Hz and odometry at 50 Hz, times
`cv2.imdecode(..., IMREAD_GRAYSCALE)` over all of them on one thread, then the command over the bag, its start included.
Best of three each, in turn, so that a busy machine disturbs both alike. `--markdown FILE` writes the section of that
file as well.
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
from pathlib import Path

import cv2
import numpy as np

from fusion.offline.bag_writer import BagWriter
from fusion.offline.markdown import write_section

START_NS = 1_700_000_000_000_000_000
WIDTH, HEIGHT = 2048, 1024
RATE = 0.4  # rad/s


def panorama(seed: int = 0) -> np.ndarray:
    """A scene with detail of every size, as photographs have it: its spectrum falls with frequency."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH))
    radius = np.hypot(np.fft.fftfreq(HEIGHT)[:, None] * 2, np.fft.rfftfreq(WIDTH)[None, :])
    scene = np.fft.irfft2(np.fft.rfft2(noise) / np.maximum(radius, 1.0 / WIDTH) ** 1.2, (HEIGHT, WIDTH))
    return np.clip(128 + 45 * scene / scene.std(), 0, 255).astype(np.float32)


def write_bag(path: Path, seconds: float) -> list[bytes]:
    """Write the bag; give its JPEG files."""
    scene, rng = panorama(), np.random.default_rng(1)
    pictures = []
    with BagWriter(path) as bag:
        for index in range(int(seconds * 30)):
            shift = round(RATE * index / 30 * WIDTH / math.tau)
            image = np.roll(scene, shift, axis=1) + rng.normal(0.0, 2.0, scene.shape).astype(np.float32)
            jpeg = cv2.imencode(".jpg", np.clip(image, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
            pictures.append(jpeg.tobytes())
            bag.write_jpeg("/viz/pano/image/compressed", START_NS + index * 1_000_000_000 // 30, pictures[-1])
        for index in range(int(seconds * 200)):
            bag.write_imu("/imu/data", START_NS + index * 5_000_000, (0.0, 0.0, RATE), (0.0, 0.0, 9.81))
        for index in range(int(seconds * 50)):
            bag.write_odometry("/odom", START_NS + index * 20_000_000, RATE * index / 50, RATE)
    return pictures


def decode_once(pictures: list[bytes]) -> None:
    """Every picture to grey at full size, on one thread."""
    for picture in pictures:
        cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE)


def seconds_of(work: Callable[[], object]) -> tuple[float, float]:
    """Wall time of a call, and processor time of this process and those it waited for."""
    wall, used = time.perf_counter(), os.times()
    work()
    return time.perf_counter() - wall, sum(os.times()[:4]) - sum(used[:4])


def main() -> None:
    """Print both times and their ratio."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=30.0, help="length of the bag")
    arguments.add_argument("--markdown", type=Path, help="write the section of this file, too")
    parsed = arguments.parse_args()
    seconds = parsed.seconds
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bench.mcap"
        pictures = write_bag(bag, seconds)
        command = [sys.executable, "-m", "fusion.offline.cli", "fuse", str(bag), "--out", str(Path(folder) / "out")]
        rounds = [
            (
                seconds_of(lambda: decode_once(pictures)),
                seconds_of(lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL)),
            )
            for _ in range(3)
        ]
    (decode, decode_cpu), (fuse, fuse_cpu) = (np.min(times, axis=0) for times in zip(*rounds, strict=True))
    cores = len(os.sched_getaffinity(0))
    print(
        f"{len(pictures)} JPEG panoramas of {WIDTH} x {HEIGHT}, {sum(map(len, pictures)) / len(pictures) / 1e3:.0f} kB"
    )
    print(f"decode at full size, one thread   {decode:6.2f} s  {1e3 * decode / len(pictures):5.1f} ms each")
    print(f"fuse, start and plot included     {fuse:6.2f} s  {1e3 * fuse / len(pictures):5.1f} ms each")
    print(f"fuse / decode, {cores} cores            {fuse / decode:6.2f}    aim: at most 1")
    print(f"the same in processor time        {fuse_cpu / decode_cpu:6.2f}")
    if parsed.markdown:
        text = f"""## Fusing a bag

`visual-compass fuse` over {len(pictures)} JPEG panoramas of {WIDTH} x {HEIGHT} that turn, gyro at 200 Hz and odometry
at 50 Hz, its start and its plot included, takes **{fuse / decode:.2f} times** as long as `cv2.imdecode` of the same
panoramas at full size on one thread, best of three of one run on {cores} cores, which other programs use as well; in
processor time, all processes together, {fuse_cpu / decode_cpu:.2f} times. The aim is 1."""
        write_section(parsed.markdown, "fusing a bag", text)


if __name__ == "__main__":
    main()
