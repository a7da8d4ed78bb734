"""Panoramas in, raw compass out: the part that both nodes share."""

from __future__ import annotations

import math
import threading
import traceback
from collections.abc import Callable

from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image

from compass import CompassStatus, VisualCompass, YawIncrement
from compass.errors import VisualCompassError
from fusion.compass_rate import CompassRate
from fusion.messages import image_of, stamp_to_ns
from fusion.settings import Settings
from nodes.complaints import Complaints
from nodes.conversions import yaw_odometry
from nodes.images import NewestWorker

IMAGE_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class CompassStream:
    """Subscribes to panoramas, runs the compass in its own thread, publishes the raw compass.

    Parameters
    ----------
    node : Node
        Owner of subscription and publisher.
    settings : Settings
        Topics, transport and frames.
    compass : VisualCompass
        Only this stream calls its `update`.
    complain : Complaints
        Told of every image that cannot be used.
    use : callable, optional
        Takes every increment, in the image thread.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        compass: VisualCompass,
        complain: Complaints,
        use: Callable[[YawIncrement], object] | None = None,
    ) -> None:
        topics = settings.topics
        self._node = node
        self._compass = compass
        self._complain = complain
        self._use = use
        self._frames = (topics.odom_frame, topics.base_frame)
        self._rate = CompassRate()
        self._busy = threading.Lock()  # held while an image is worked on; reset waits for it
        self.textout = topics.compass_textout
        self.received = 0
        self.worker: NewestWorker[Image | CompressedImage] = NewestWorker(self._work, "images")
        self._publisher = node.create_publisher(Odometry, topics.compass_output_topic, 10)
        compressed = topics.image_transport == "compressed"
        self.topic = topics.compass_image + ("/compressed" if compressed else "")
        self._subscription = node.create_subscription(
            CompressedImage if compressed else Image,
            self.topic,
            self._receive,
            IMAGE_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def reset(self) -> None:
        """Start the compass anew once the image in work is done."""
        with self._busy:
            self._compass.reset()
            self._rate = CompassRate()

    def close(self) -> None:
        """End the image thread."""
        self.worker.close()

    def _receive(self, message: Image | CompressedImage) -> None:
        self.received += 1
        self.worker.offer(message)

    def _work(self, message: Image | CompressedImage) -> None:
        """Everything one image needs; nothing a message carries may end the thread."""
        try:
            with self._busy:
                self._serve(message)
        except VisualCompassError as error:
            self._complain(self.topic, error)
        except Exception:
            if self._node.context.ok():  # else the publisher's context ended: the node is about to
                self._complain(self.topic, traceback.format_exc())

    def _serve(self, message: Image | CompressedImage) -> None:
        t_ns = stamp_to_ns(message.header.stamp)
        image, encoding = image_of(message, self._compass.config.columns)
        increment = self._compass.update(t_ns, image, encoding)
        if increment is not None:
            if self._use is not None:
                self._use(increment)
            self._publish(increment)
        elif self._compass.status is not CompassStatus.FIRST_FRAME:
            self._complain(self.topic, self._compass.status.value)

    def _publish(self, increment: YawIncrement) -> None:
        compass = self._compass
        rate, variance = self._rate.update(increment)
        self._publisher.publish(
            yaw_odometry(increment.t_ns, compass.yaw, compass.yaw_variance, rate, variance, self._frames)
        )
        if self.textout:
            self._node.get_logger().info(f"angle {math.degrees(compass.yaw):.2f} deg")
