"""Soak of the live node: frames lost, latency, CPU and memory over a minute at full load, on loopback.

    python tests/benchmarks/soak.py --seconds 60

Three processes, as on a robot: sensors (30 Hz JPEG panoramas of 2048x1024, 200 Hz gyro, 50 Hz track odometry), the
node, and a listener that compares the arrival of each output with its stamp.
"""

from __future__ import annotations

import argparse
import array
import json
import math
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
IMAGE_HZ, GYRO_HZ, ODOMETRY_HZ = 30, 200, 50
STEP_DEG = 1.0  # turn per frame
SWING = 60  # frames one way, then back


def scene(width: int = 2048, height: int = 1024, seed: int = 0) -> np.ndarray:
    """Textured panorama whose seam is closed: boxes of random grey at several scales, slightly blurred."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width), np.float32)
    for cells in (16, 64, 256):
        coarse = rng.uniform(0.0, 85.0, (cells // 2, cells)).astype(np.float32)
        image += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(np.tile(image, 3), (0, 0), 2.0)[:, width : 2 * width]


def jpeg_frames() -> list[array.array]:
    """JPEGs of the scene turning from 0 to `SWING` steps, as the arrays that rclpy sends fastest."""
    panorama = scene()
    per_step = STEP_DEG * panorama.shape[1] / 360.0
    frames = []
    for step in range(SWING + 1):
        turned = np.roll(panorama, round(step * per_step), axis=1).astype(np.uint8)
        colour = cv2.cvtColor(turned, cv2.COLOR_GRAY2BGR)
        frames.append(array.array("B", cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()))
    return frames


def sense(seconds: float) -> dict[str, int]:
    """Publish all three sensors on an absolute schedule; returns how many of each were sent."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import CompressedImage, Imu

    frames = jpeg_frames()
    rclpy.init()
    node = rclpy.create_node("soak_sensors")
    publishers = {
        "image": node.create_publisher(CompressedImage, "/viz/pano/image/compressed", qos_profile_sensor_data),
        "gyro": node.create_publisher(Imu, "/imu/data", qos_profile_sensor_data),
        "odometry": node.create_publisher(Odometry, "/odom", qos_profile_sensor_data),
    }
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.05)
    sent = dict.fromkeys(publishers, 0)
    rate = math.radians(STEP_DEG * IMAGE_HZ)
    period = {"gyro": 1.0 / GYRO_HZ, "odometry": 1.0 / ODOMETRY_HZ, "image": 1.0 / IMAGE_HZ}
    start = time.monotonic()
    while (now := time.monotonic() - start) < seconds:
        name = min(period, key=lambda n: sent[n] * period[n])
        due = sent[name] * period[name]
        if due > now:
            time.sleep(due - now)
        swing, step = divmod(round(due * IMAGE_HZ), SWING)
        turning = rate if swing % 2 == 0 else -rate
        if name == "image":
            message = CompressedImage(format="jpeg")
            message.data = frames[step if swing % 2 == 0 else SWING - step]
        elif name == "gyro":
            message = Imu()
            message.angular_velocity.z = turning
            message.linear_acceleration.z = 9.81
            message.orientation_covariance[0] = -1.0
        else:
            message = Odometry()
            message.twist.twist.angular.z = turning
        message.header.stamp = node.get_clock().now().to_msg()
        publishers[name].publish(message)
        sent[name] += 1
    time.sleep(0.5)
    rclpy.try_shutdown()
    return sent


def listen() -> dict[str, list[float]]:
    """Until SIGINT: seconds from stamp to arrival of every output, by topic."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    node = rclpy.create_node("soak_listener")
    delays: dict[str, list[float]] = {"/compass_pose": [], "/odometry/fused": []}

    def on(topic: str, message: Odometry) -> None:
        stamp = message.header.stamp
        delays[topic].append(time.time() - (stamp.sec + stamp.nanosec * 1e-9))

    for topic in delays:
        node.create_subscription(Odometry, topic, lambda message, topic=topic: on(topic, message), 100)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    return delays


def usage(pid: int) -> tuple[float, float]:
    """CPU seconds used so far and resident memory in MiB of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    ticks = int(fields[11]) + int(fields[12])
    resident = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
    return ticks / os.sysconf("SC_CLK_TCK"), resident / 2**20


def soak(seconds: float) -> dict[str, float]:
    """Run the three processes; returns the figures."""
    environment = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(ROOT / "config" / "fastdds.xml")

    def start(*arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, *arguments], env=environment, cwd=ROOT, stdout=subprocess.PIPE, text=True
        )

    me = str(Path(__file__).resolve())
    listener = start(me, "--role", "listen")
    node = start("-m", "nodes.fusion_node", "--ros-args", "-p", "image_transport:=compressed")
    sensors = start(me, "--role", "sense", "--seconds", str(seconds))
    samples: list[tuple[float, float, float]] = []
    while sensors.poll() is None:
        if node.poll() is None:
            samples.append((time.monotonic(), *usage(node.pid)))
        time.sleep(0.5)
    sent = json.loads(sensors.communicate()[0])
    for process in (node, listener):
        process.send_signal(signal.SIGINT)
    delays = json.loads(listener.communicate(timeout=30)[0])
    node.wait(timeout=10)
    return figures(sent, delays, samples[len(samples) // 5 :])


def figures(
    sent: dict[str, int], delays: dict[str, list[float]], samples: list[tuple[float, float, float]]
) -> dict[str, float]:
    """Sum up: the first fifth of the run (start, discovery) is left out of CPU and memory."""
    (t0, cpu0, memory0), (t1, cpu1, memory1) = samples[0], samples[-1]
    result = {
        "images_sent": float(sent["image"]),
        "images_answered": float(len(delays["/compass_pose"]) + 1),  # the first has nothing to be compared with
        "fused_outputs": float(len(delays["/odometry/fused"])),
        "cpu_percent": 100.0 * (cpu1 - cpu0) / (t1 - t0),
        "memory_mib": memory1,
        "memory_growth_mib": memory1 - memory0,
    }
    for topic, name in (("/compass_pose", "compass"), ("/odometry/fused", "fused")):
        p50, p99, worst = np.percentile(delays[topic], [50, 99, 100]) * 1e3
        result |= {f"{name}_p50_ms": p50, f"{name}_p99_ms": p99, f"{name}_max_ms": worst}
    return result


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    parser.add_argument("--role", choices=("soak", "sense", "listen"), default="soak", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.role == "sense":
        print(json.dumps(sense(arguments.seconds)))
    elif arguments.role == "listen":
        print(json.dumps(listen()))
    else:
        result = soak(arguments.seconds)
        print("\n".join(f"{name:20} {value:10.1f}" for name, value in result.items()))
        if arguments.json:
            arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
