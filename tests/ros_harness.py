"""A robot's sensors and a listener on the real rclpy, and nodes of ours as separate processes, on loopback only."""

from __future__ import annotations

import array
import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")


def _own_domain() -> tuple[int, Any]:
    """A ROS domain that no other test run on this machine uses, and the lock on it, held while the process lives."""
    for domain in [1 + (os.getpid() + k) % 100 for k in range(100)]:
        lock = (Path(tempfile.gettempdir()) / f"visual-compass-domain-{os.getuid()}-{domain}").open("w")
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return domain, lock
        lock.close()
    raise RuntimeError("all ROS domains from 1 to 100 are in use by other test runs")


# The environment is read when the first context opens: a domain of our own, never beyond this machine.
_DOMAIN, _LOCK = _own_domain()
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(_DOMAIN)

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image, Imu  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 300.0  # for anything that a loaded machine does late: no verdict on speed; a healthy one needs a second
START_NS = 1_700_000_000_000_000_000


class Process:
    """One of our nodes, started as ``python -m module``."""

    def __init__(self, module: str, parameters: Mapping[str, Any], arguments: list[str], log: Path) -> None:
        command = [sys.executable, "-m", module, "--ros-args", *arguments]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
        self.log = log
        environment = dict(os.environ, PYTHONUNBUFFERED="1", PYTHONFAULTHANDLER="1")
        with log.open("wb") as out:
            self._process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=out, stderr=subprocess.STDOUT)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def text(self) -> str:
        """All the node has printed so far."""
        return self.log.read_text(errors="replace")

    def complaints(self) -> list[str]:
        """Lines printed of messages that could not be used (they begin with the topic) and of crashes."""
        ours = ("[INFO]", "[WARN]")
        return [line for line in self.text().splitlines() if "]: /" in line or not line.startswith(ours)]

    def wait(self, timeout: float = PATIENCE_S) -> int:
        return self._process.wait(timeout)

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        """Send a signal; returns the exit code."""
        self._process.send_signal(how)
        try:
            return self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.send_signal(signal.SIGABRT)  # its fault handler writes where every thread stands
            self._process.wait(PATIENCE_S)
            raise AssertionError(f"{how.name} did not end the node in {PATIENCE_S:g} s:\n{self.text()}") from None

    def close(self) -> None:
        if self.alive:
            self._process.kill()
            self._process.wait(PATIENCE_S)


@contextmanager
def started(module: str, log: Path, arguments: list[str] | None = None, **parameters: Any) -> Iterator[Process]:
    """A running node, gone afterwards; ``__`` in a parameter's name stands for a dot."""
    named = {name.replace("__", "."): value for name, value in parameters.items()}
    process = Process(module, named, arguments or [], log)
    try:
        yield process
    finally:
        process.close()


class Robot:
    """Sends what sensors send and keeps what comes back."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("robot", context=self.context)
        self._publishers: dict[str, Any] = {}
        self.heard: dict[str, list[Any]] = {}
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self) -> None:
        rclpy.shutdown(context=self.context)
        self._thread.join(5.0)
        self.node.destroy_node()

    def listen(self, kind: type, topic: str, qos: Any = 1000) -> list[Any]:
        """Messages of a topic from now on, in a list that grows."""
        messages = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def connect(self, kind: type, topic: str, qos: Any = qos_profile_sensor_data) -> Callable[[Any], None]:
        """Send function of a topic; waits until the node listens."""
        publisher = self.node.create_publisher(kind, topic, qos)
        wait_for(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")
        return publisher.publish

    def wait_publisher(self, topic: str) -> None:
        """Wait until somebody publishes a topic we listen to."""
        wait_for(lambda: self.node.count_publishers(topic) > 0, f"a publisher of {topic}")

    def call(self, kind: type, service: str, request: Any) -> Any:
        """Call a service."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(PATIENCE_S), f"no service {service}"
        future = client.call_async(request)
        wait_for(future.done, f"an answer of {service}")
        return future.result()


def wait_for(true: Callable[[], Any], what: str, patience: float = PATIENCE_S) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + patience
    while not true():
        assert time.monotonic() < end, f"waited {patience:g} s for {what}"
        time.sleep(0.01)


def send_until(send: Callable[[], Any], true: Callable[[], Any], what: str, pause: float = 1.0) -> None:
    """Send again and again until a condition holds: the first messages of a best-effort topic may be lost."""
    end = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < end, f"sent for {PATIENCE_S:g} s and waited for {what}"
        send()
        again = time.monotonic() + pause
        while not true() and time.monotonic() < again:
            time.sleep(0.005)


def scene(width: int = 512, height: int = 64, seed: int = 0) -> np.ndarray:
    """A textured strip without seam, band-limited so that it can be turned by fractions of a pixel."""
    rng = np.random.default_rng(seed)
    waves = np.arange(width // 2 + 1)
    spectrum = np.fft.rfft(rng.standard_normal((height, width)), axis=1) * np.exp(-((waves / (width / 12.0)) ** 2))
    texture = np.fft.irfft(spectrum, width, axis=1)
    return texture / texture.std()


def panorama(yaw: float, texture: np.ndarray) -> np.ndarray:
    """What the camera sees at a yaw, rad: turned left, the scene moves right."""
    width = texture.shape[1]
    phase = np.exp(-1j * np.arange(width // 2 + 1) * yaw)
    return np.clip(128.0 + 40.0 * np.fft.irfft(np.fft.rfft(texture, axis=1) * phase, width, axis=1), 0, 255).astype(
        np.uint8
    )


def stamp(message: Any, t_ns: int) -> Any:
    """Put a stamp into a message's header."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(t_ns, 1_000_000_000)
    return message


def image_message(t_ns: int, image: np.ndarray, encoding: str = "mono8") -> Image:
    message = Image(height=image.shape[0], width=image.shape[1], encoding=encoding, step=image.strides[0])
    message.data = array.array("B", image.tobytes())
    return stamp(message, t_ns)


def jpeg_message(t_ns: int, image: np.ndarray) -> CompressedImage:
    import cv2

    message = CompressedImage(format="jpeg")
    message.data = array.array("B", cv2.imencode(".jpg", image)[1].tobytes())
    return stamp(message, t_ns)


def imu_message(t_ns: int, yaw_rate: float) -> Imu:
    message = Imu()
    message.angular_velocity.z = yaw_rate
    message.linear_acceleration.z = 9.81
    message.orientation_covariance[0] = -1.0
    return stamp(message, t_ns)


def odometry_message(t_ns: int, yaw_rate: float, speed: float = 0.0) -> Odometry:
    message = Odometry()
    message.twist.twist.angular.z = yaw_rate
    message.twist.twist.linear.x = speed
    message.pose.pose.orientation.w = 0.0  # no rotation at all: the pose is not known
    return stamp(message, t_ns)


def stamp_of(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def yaw_of(message: Odometry) -> float:
    q = message.pose.pose.orientation
    return 2.0 * float(np.arctan2(q.z, q.w))


def newest(diagnostics: list[Any], source: str) -> Any:
    """Newest status of ``/diagnostics`` whose name ends with `source`; None if there is none."""
    for message in reversed(diagnostics):
        for status in message.status:
            if status.name.endswith(source):
                return status
    return None


def figures(diagnostics: list[Any], source: str) -> dict[str, str]:
    """Values of the newest status of a source."""
    status = newest(diagnostics, source)
    return {} if status is None else {pair.key: pair.value for pair in status.values}
