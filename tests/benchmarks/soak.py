"""Soak of the live node: frames lost, latency, CPU and memory over a minute at full load, on loopback.

    python tests/benchmarks/soak.py --seconds 60
    python tests/benchmarks/soak.py --transport raw --profile none
    python tests/benchmarks/soak.py --seconds 30 --busy 2

Three processes, as on a robot: sensors (30 Hz JPEG panoramas of 2048x1024, 200 Hz gyro, 50 Hz track odometry), the
node, and a listener that compares the arrival of each output with its stamp. `--transport raw` sends 15 Hz raw frames
of 1600x800 in colour instead, `--profile none` goes without the Fast DDS profile of this package, `--busy N` has N
programs beside it that take all they can. `--markdown FILE` writes the section of that file as well.
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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
GYRO_HZ, ODOMETRY_HZ = 200, 50
IMAGE_HZ = {"compressed": 30, "raw": 15}
SIZE = {"compressed": (2048, 1024), "raw": (1600, 800)}
REACH = math.radians(30.0)  # the robot turns by twice this and back, smoothly
PERIODIC = ("images", "gyro", "tracks")
SWING = 60  # frames one way, then back the same


def scene(width: int, height: int, seed: int = 0) -> np.ndarray:
    """Textured panorama whose seam is closed: boxes of random grey at several scales, slightly blurred."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width), np.float32)
    for cells in (16, 64, 256):
        coarse = rng.uniform(0.0, 85.0, (cells // 2, cells)).astype(np.float32)
        image += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(np.tile(image, 3), (0, 0), 2.0)[:, width : 2 * width]


def turned(panorama: np.ndarray, yaw: float) -> np.ndarray:
    """What the camera sees at a yaw, rad, to a fraction of a pixel: the scene moves right as the robot turns left."""
    spectrum = np.fft.rfft(panorama, axis=1)
    spectrum *= np.exp(-1j * yaw * np.arange(spectrum.shape[1]))
    return np.clip(np.fft.irfft(spectrum, panorama.shape[1], axis=1), 0, 255).astype(np.uint8)


def yaw_at(frame: float) -> float:
    """Yaw at a frame's number, rad."""
    return REACH * (1.0 - math.cos(math.pi * frame / SWING))


def rate_at(frame: float, image_hz: float) -> float:
    """Its derivative, rad/s."""
    return REACH * math.pi / SWING * image_hz * math.sin(math.pi * frame / SWING)


def image_messages(transport: str) -> list:
    """Images of one way, 0 to `SWING`; their data are the arrays that rclpy sends fastest."""
    from sensor_msgs.msg import CompressedImage, Image

    width, height = SIZE[transport]
    panorama = scene(width, height)
    messages = []
    for step in range(SWING + 1):
        colour = cv2.cvtColor(turned(panorama, yaw_at(step)), cv2.COLOR_GRAY2BGR)
        if transport == "raw":
            message = Image(height=height, width=width, encoding="bgr8", step=3 * width)
            message.data = array.array("B", colour.tobytes())
        else:
            message = CompressedImage(format="jpeg")
            message.data = array.array("B", cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes())
        messages.append(message)
    return messages


def sense(seconds: float, transport: str) -> dict:
    """Publish all three sensors on an absolute schedule; returns how many of each were sent, and how late."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Imu

    images = image_messages(transport)
    rclpy.init()
    node = rclpy.create_node("soak_sensors")
    image_topic = "/viz/pano/image" + ("/compressed" if transport == "compressed" else "")
    publishers = {
        "images": node.create_publisher(type(images[0]), image_topic, qos_profile_sensor_data),
        "gyro": node.create_publisher(Imu, "/imu/data", qos_profile_sensor_data),
        "tracks": node.create_publisher(Odometry, "/odom", qos_profile_sensor_data),
    }
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.05)
    time.sleep(1.0)  # until the subscribers know the publishers, too
    sent = dict.fromkeys(publishers, 0)
    image_hz = IMAGE_HZ[transport]
    period = {"gyro": 1.0 / GYRO_HZ, "tracks": 1.0 / ODOMETRY_HZ, "images": 1.0 / image_hz}
    late_ms = []
    start, start_ns = time.monotonic(), time.time_ns()
    while (now := time.monotonic() - start) < seconds:
        name = min(period, key=lambda n: sent[n] * period[n])
        due = sent[name] * period[name]
        if due > now:
            time.sleep(due - now)
        rate = rate_at(due * image_hz, image_hz)
        if name == "images":
            swing, step = divmod(sent[name], SWING)
            message = images[step if swing % 2 == 0 else SWING - step]
        elif name == "gyro":
            message = Imu()
            message.angular_velocity.z = rate
            message.linear_acceleration.z = 9.81
            message.orientation_covariance[0] = -1.0
        else:
            message = Odometry()
            message.twist.twist.angular.z = rate
            half = 0.5 * yaw_at(due * image_hz)
            message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(half), math.cos(half)
        # Stamped when it was due, so that yaw, rate and time agree however late this process is.
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(start_ns + round(due * 1e9), 1_000_000_000)
        publishers[name].publish(message)
        sent[name] += 1
        late_ms.append((time.monotonic() - start - due) * 1e3)
    time.sleep(3.0)  # for the last diagnostics
    rclpy.try_shutdown()
    return {"sent": sent, "late_p99_ms": float(np.percentile(late_ms, 99))}


def listen() -> dict:
    """Until SIGINT: seconds from stamp to arrival of every output by topic, and the last diagnostics by stream."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    node = rclpy.create_node("soak_listener")
    delays: dict[str, list[float]] = {"/compass_pose": [], "/odometry/fused": []}
    told: dict[str, dict[str, str]] = {}

    def on(topic: str, message: Odometry) -> None:
        stamp = message.header.stamp
        delays[topic].append(time.time() - (stamp.sec + stamp.nanosec * 1e-9))

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            told[status.name.split(": ")[1]] = {pair.key: pair.value for pair in status.values}

    for topic in delays:
        node.create_subscription(Odometry, topic, lambda message, topic=topic: on(topic, message), 100)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    return {"delays": delays, "told": told}


def usage(pid: int) -> tuple[float, float]:
    """CPU seconds used so far and resident memory in MiB of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    ticks = int(fields[11]) + int(fields[12])
    resident = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
    return ticks / os.sysconf("SC_CLK_TCK"), resident / 2**20


def soak(seconds: float, transport: str, profile: str) -> dict[str, float]:
    """Run the three processes; returns the figures."""
    environment = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    if profile != "none":
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = profile

    def start(*arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, *arguments], env=environment, cwd=ROOT, stdout=subprocess.PIPE, text=True
        )

    me = str(Path(__file__).resolve())
    listener = start(me, "--role", "listen")
    node = start("-m", "nodes.fusion_node", "--ros-args", "-p", f"image_transport:={transport}")
    sensors = start(me, "--role", "sense", "--seconds", str(seconds), "--transport", transport)
    samples: list[tuple[float, float, float]] = []
    while sensors.poll() is None:
        if node.poll() is not None:
            sensors.kill()
            listener.kill()
            sys.exit(f"the node ended with exit code {node.returncode}")
        samples.append((time.monotonic(), *usage(node.pid)))
        time.sleep(0.5)
    sensed = json.loads(sensors.communicate()[0])
    for process in (node, listener):
        process.send_signal(signal.SIGINT)
    heard = json.loads(listener.communicate(timeout=30)[0])
    node.wait(timeout=10)
    return figures(sensed, heard, samples[len(samples) // 5 :])


def figures(sensed: dict, heard: dict, samples: list[tuple[float, float, float]]) -> dict[str, float]:
    """Sum up: the first fifth of the run (start, discovery) is left out of CPU and memory."""
    (t0, cpu0, memory0), (t1, cpu1, memory1) = samples[0], samples[-1]
    result = {}
    for stream, count in sensed["sent"].items():
        told = heard["told"][stream]
        result[f"{stream}_sent"] = float(count)
        result[f"{stream}_lost"] = float(count - int(told["used"]))
    result |= {
        "sensors_late_p99_ms": sensed["late_p99_ms"],  # of the delays below, this was our own sender's
        "images_dropped_by_node": float(heard["told"]["images"]["dropped"]),
        "images_lost_on_the_way": float(heard["told"]["images"]["lost on the way"]),
        "cpu_percent": 100.0 * (cpu1 - cpu0) / (t1 - t0),
        "memory_mib": memory1,
        "memory_growth_mib": memory1 - memory0,
    }
    for topic, name in (("/compass_pose", "compass"), ("/odometry/fused", "fused")):
        delays = np.array(heard["delays"][topic]) * 1e3
        p50, p99, worst = np.percentile(delays, [50, 99, 100])
        result |= {
            f"{name}_outputs": float(delays.size),
            f"{name}_within_50_ms_percent": 100.0 * np.mean(delays <= 50.0),
        }
        result |= {f"{name}_p50_ms": p50, f"{name}_p99_ms": p99, f"{name}_max_ms": worst}
    return result


def write_page(page: Path, seconds: float, transport: str, result: dict[str, float]) -> None:
    """Write the section on the live nodes."""
    from fusion.offline.markdown import markdown_table, write_section

    width, height = SIZE[transport]
    rows = [
        (
            name,
            f"{result[f'{key}_within_50_ms_percent']:.2f}",
            *(f"{result[f'{key}_{which}_ms']:.1f}" for which in ("p50", "p99", "max")),
        )
        for key, name in (("compass", "raw compass"), ("fused", "fused yaw"))
    ]
    lost = ", ".join(f"{result[f'{one}_lost']:.0f} of {result[f'{one}_sent']:.0f} {one}" for one in PERIODIC)
    images = f"{IMAGE_HZ[transport]} Hz {transport} images of {width} x {height}"
    header = ("output", "within 50 ms, %", "median, ms", "99th percentile, ms", "largest, ms")
    text = f"""## Live nodes

Sensors, node and listener as three processes on {os.cpu_count()} cores, {seconds:g} s on loopback, turning:
{images}, {GYRO_HZ} Hz gyro, {ODOMETRY_HZ} Hz odometry.
Lost: {lost}. The node uses {result["cpu_percent"]:.0f} % of a core; its memory grows by
{result["memory_growth_mib"]:.1f} MiB. Delay from the stamp to the arrival of the output elsewhere; the sender's own is
{result["sensors_late_p99_ms"]:.1f} ms at the 99th percentile. The aim is 99 % within 50 ms and no image lost.

{markdown_table(header, rows)}"""
    write_section(page, "live nodes", text)


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Programs that take all of a core each, at the same priority as everything else."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--transport", choices=("compressed", "raw"), default="compressed")
    parser.add_argument("--profile", default=str(ROOT / "config" / "fastdds.xml"), help="of Fast DDS, or none")
    parser.add_argument("--busy", type=int, default=0, help="programs beside it that compute without end")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    parser.add_argument("--markdown", type=Path, help="write the section of this file, too")
    parser.add_argument("--role", choices=("soak", "sense", "listen"), default="soak", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.role == "sense":
        print(json.dumps(sense(arguments.seconds, arguments.transport)))
    elif arguments.role == "listen":
        print(json.dumps(listen()))
    else:
        with busy(arguments.busy):
            result = soak(arguments.seconds, arguments.transport, arguments.profile)
        print("\n".join(f"{name:30} {value:10.1f}" for name, value in result.items()))
        if arguments.json:
            arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        if arguments.markdown:
            write_page(arguments.markdown, arguments.seconds, arguments.transport, result)


if __name__ == "__main__":
    main()
