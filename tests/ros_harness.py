"""A robot's sensors and a listener on the real rclpy, and what its messages hold."""

from __future__ import annotations

import array
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from nav_msgs.msg import Odometry  # noqa: E402
from rcl_interfaces.srv import GetParameters  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from ros_process import PATIENCE_S  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image, Imu  # noqa: E402

LOST_S = 30.0  # without an answer, after which a message is taken for lost
START_NS = 1_700_000_000_000_000_000


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
        self._thread.join(PATIENCE_S)
        self.node.destroy_node()

    def listen(self, kind: type, topic: str, qos: Any = 1000) -> list[Any]:
        """Messages of a topic from now on, in a list that grows."""
        messages = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def connect(self, kind: type, topic: str, qos: Any = qos_profile_sensor_data) -> Callable[[Any], None]:
        """Send function of a topic; waits until somebody listens. Whether that has heard of us, `meet` tells."""
        publisher = self.node.create_publisher(kind, topic, qos)
        wait_for(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")
        return publisher.publish

    def meet(self, node: str) -> None:
        """Wait until a node and this robot know all that either has made so far: nothing sent from now on is too early.

        The middleware announces the ends of topics and services one by one, in the order they were made, and each
        process matches them when it hears of them; what is sent before is lost, without a word. Whoever answers a
        client that was made last has heard of all that was made before it.
        """
        client = self.node.create_client(GetParameters, f"{node}/get_parameters")
        assert client.wait_for_service(PATIENCE_S), f"no node {node}"
        answers = []  # the first may come before our client is known over there, and is lost
        send_until(
            lambda: answers.append(client.call_async(GetParameters.Request())),
            lambda: any(answer.done() for answer in answers),
            f"an answer of {node}",
        )

    def call(self, kind: type, service: str, request: Any) -> Any:
        """Call a service of a node."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(PATIENCE_S), f"no service {service}"
        self.meet(service.rpartition("/")[0])
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
    """Send again and again until a condition holds: messages of a best-effort topic may be lost.

    What must not arrive twice, as nodes answer a stamp once and complain of the second, has a pause of `LOST_S`.
    """
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
