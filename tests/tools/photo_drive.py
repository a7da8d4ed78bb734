"""A bag of real photographs that turn as a real robot turned, with that robot's real gyro and odometry.

The Husky's log has no camera. Its gyro, less the bias it shows standing still, says how it turned; a panoramic
photograph shifted by that yaw (by Fourier's theorem, so by any part of a pixel), with exposure and noise of a camera,
is what a camera on it would have seen far from everything. Real are the motion, the rates and jitter of the stamps,
the IMU (mounted with +Y up), the skid-steered wheels and the scene.

    PYTHONPATH=tests python -m tools.photo_drive forest.jpg photo.mcap
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from fusion.imu.levelling import ImuConfig, ImuLevel
from fusion.imu.tilt import heading_gain
from fusion.offline.bag import Bag
from fusion.offline.bag_writer import BagWriter

DATA = Path(__file__).parents[3] / "shared" / "data"
HUSKY, PHOTOS = DATA / "husky.bag", DATA / "panoramas"
STANDSTILL_BIAS = -0.0003  # rad/s, from the log's own page
NOISE = 2.0  # grey values of 255
GYRO_TOPIC, WHEELS_TOPIC = "/imu/data", "/husky_velocity_controller/odom"


def write_photo_bag(
    path: Path, photo: Path, start: float = 0.0, end: float = 1e9, hertz: float = 10.0, seed: int = 0
) -> None:
    """Write the bag from `start` to `end` seconds of the log, with the yaw of the images as ground truth."""
    scene = cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE)
    spectrum = np.fft.rfft(scene.astype(np.float32), axis=1)
    rng = np.random.default_rng(seed)
    readings, wheels = husky_readings(start, end)
    level = ImuLevel(ImuConfig())
    times = np.array([reading[0] for reading in readings])
    gyro = [level.sample(*reading) for reading in readings]
    rates = np.array([sample.yaw_rate for sample in gyro]) - STANDSTILL_BIAS
    seconds = (times - times[0]) * 1e-9
    yaw = integral(rates, seconds)
    turn = integral(rates / [heading_gain(sample.up) for sample in gyro], seconds)  # the camera leans with the robot
    shots = np.arange(0.0, seconds[-1], 1.0 / hertz)
    with BagWriter(path) as bag:
        for reading in readings:
            bag.write_imu(GYRO_TOPIC, *reading)
        for t_ns, x, y, heading, speed, rate in wheels:
            bag.write_odometry(WHEELS_TOPIC, t_ns, heading, rate, position=(x, y, 0.0), speed=speed)
        for t_ns, true_yaw, true_rate in zip(times.tolist(), yaw.tolist(), rates.tolist(), strict=True):
            bag.write_odometry("/ground_truth/odom", t_ns, true_yaw, true_rate)
        for second in shots:
            turned = float(np.interp(second, seconds, turn))
            gain = 1.0 + 0.2 * np.sin(2.0 * np.pi * second / 17.0)
            image = gain * shifted(spectrum, turned, scene.shape[1]) + rng.normal(0.0, NOISE, scene.shape)
            pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
            jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
            bag.write_jpeg("/viz/pano/image/compressed", int(times[0]) + round(second * 1e9), jpeg.tobytes())


def integral(rates: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """What a rate comes to from the start on, by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(np.diff(seconds) * 0.5 * (rates[1:] + rates[:-1]))])


def shifted(spectrum: np.ndarray, yaw: float, width: int) -> np.ndarray:
    """The photograph after a turn by `yaw` rad to the left: moved to the right."""
    columns = yaw * width / (2.0 * np.pi)
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(width) * columns).astype(np.complex64)
    return np.fft.irfft(spectrum * phase, width, axis=1)


def husky_readings(start: float, end: float) -> tuple[list, list]:
    """IMU readings and wheel odometry (t_ns, x, y, yaw, speed, rate) of a part of the log."""
    imu, wheels = [], []
    with Bag(HUSKY) as bag:
        for message in bag.messages(GYRO_TOPIC, WHEELS_TOPIC):
            m = bag.deserialize(message)
            if message.topic == GYRO_TOPIC:
                w, a, q = m.angular_velocity, m.linear_acceleration, m.orientation
                imu.append((message.stamp_ns, (w.x, w.y, w.z), (a.x, a.y, a.z), (q.x, q.y, q.z, q.w)))
            else:
                q, place, twist = m.pose.pose.orientation, m.pose.pose.position, m.twist.twist
                yaw = 2.0 * np.arctan2(q.z, q.w)
                wheels.append((message.stamp_ns, place.x, place.y, yaw, twist.linear.x, twist.angular.z))
    imu.sort()
    wheels.sort()
    first = imu[0][0]
    inside = [[one for one in part if start <= (one[0] - first) * 1e-9 < end] for part in (imu, wheels)]
    return inside[0], inside[1]


def main() -> None:
    """Write the bag of a hundred seconds of the log."""
    parser = argparse.ArgumentParser("photo_drive", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("photo", help=f"file in {PHOTOS}")
    parser.add_argument("bag", type=Path, help="MCAP file to write")
    arguments = parser.parse_args()
    write_photo_bag(arguments.bag, PHOTOS / arguments.photo, 100.0, 200.0)


if __name__ == "__main__":
    main()
