"""Compressed panoramas in, raw ones out, as ``image_transport republish`` does."""

from __future__ import annotations

import array
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from rclpy.clock import Clock as SteadyClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image

from compass.errors import ImageError
from compass.parameters import ParameterSet, parameter
from nodes.names import compressed_topic, raw_topic, resolved_name
from nodes.newest_worker import NewestWorker
from nodes.parameters import declare_config
from nodes.runtime import run
from nodes.throttled_log import ThrottledLog, surviving

RAW_QOS = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)  # serves subscribers of either kind


@dataclass(frozen=True)
class RepublishConfig(ParameterSet):
    """Settings of the republisher."""

    compass_image: str = parameter("viz/pano/image", "raw topic; the compressed one has /compressed behind it")


class RepublishNode(Node):
    """Decodes ``<topic>/compressed`` into ``<topic>``; idle while somebody else publishes that.

    It listens once it is listened to: a player that waits for its subscription loses no image at the start then.
    """

    def __init__(self) -> None:
        super().__init__("republish_node", automatically_declare_parameters_from_overrides=True)
        self._topic = raw_topic(declare_config(self, RepublishConfig).compass_image)
        name = resolved_name(self, self._topic, "compass_image")
        self._log = ThrottledLog(self.get_logger().warning)
        self._worker = NewestWorker(surviving(self, name, self._log, self._republish), "images")
        self._publisher = self.create_publisher(Image, self._topic, RAW_QOS)
        self._timer = self.create_timer(0.1, self._watch, clock=SteadyClock(clock_type=ClockType.STEADY_TIME))

    def _watch(self) -> None:
        if self._publisher.get_subscription_count():
            self._timer.cancel()
            topic = compressed_topic(self._topic)
            self.create_subscription(CompressedImage, topic, self._worker.offer, qos_profile_sensor_data)

    def _republish(self, message: CompressedImage) -> None:
        if self.count_publishers(self._topic) == 1:
            self._publisher.publish(decoded(message))

    def destroy_node(self) -> None:
        """End the image thread, then the node."""
        self._worker.close()
        super().destroy_node()


def decoded(message: CompressedImage) -> Image:
    """A JPEG or PNG as raw ``bgr8`` or ``mono8`` of the same header; `ImageError` where it is corrupt."""
    data = np.frombuffer(message.data, np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_ANYCOLOR) if data.size else None
    if pixels is None:
        raise ImageError(f"compressed image of {data.size} bytes is corrupt or neither JPEG nor PNG")
    image = Image(header=message.header, height=pixels.shape[0], width=pixels.shape[1])
    image.encoding = "mono8" if pixels.ndim == 2 else "bgr8"
    image.step = pixels.strides[0]
    image.data = array.array("B", pixels.tobytes())  # rclpy takes an array as it is, bytes one by one
    return image


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass republish_node``."""
    return run(RepublishNode, args)


if __name__ == "__main__":
    sys.exit(main())
