"""Panoramas in, raw compass out: the part that both nodes share."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from itertools import islice
from typing import Any, TypeAlias, cast

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from compass import CompassStatus, ConfigError, VisualCompass, YawIncrement
from compass.features.long_baseline import Comparison
from compass.parameters import shown
from fusion.compass_rate import CompassRate
from fusion.messages import image_of, stamp_to_ns
from fusion.pictures import Picture, PictureStream, packet_of
from fusion.settings import Settings
from nodes.conversions import yaw_odometry
from nodes.diagnostics import Finding, compass_figures, delivered, stream_finding
from nodes.health import Level, StreamHealth
from nodes.link import NO_DEFAULTS, Link
from nodes.names import resolved_name
from nodes.newest_worker import NewestWorker
from nodes.quality import EVERY_IMAGE_QOS, IMAGE_QOS, PACKET_QOS
from nodes.sample_queue import queued
from nodes.throttled_log import ThrottledLog, surviving
from nodes.transport import image_topic

LONGEST_SETTLING_S = 10.0  # of the executor, before an image is worked on all the same: the node is ending

ImageMessage: TypeAlias = Image | CompressedImage


class CompassStream:
    """Subscribes to panoramas, runs the compass in a thread of its own, publishes the raw compass.

    Parameters
    ----------
    node : Node
        Owner of subscription and publisher.
    settings : Settings
        Topics, transport and frames.
    compass : VisualCompass
        Only this stream calls its `update`.
    log : ThrottledLog
        Told of every image that cannot be used.
    measure : callable, optional
        Makes an increment of stamp, image and encoding: `VisualCompass.update`, or `YawPipeline.measure_image`.
    use : callable, optional
        Takes every increment, in the image thread, or that which looks back; tells `health` whether it was used.
    after : callable, optional
        Calls what it is given once all is used that has arrived or was handed to `use`; at once where there is none.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        compass: VisualCompass,
        log: ThrottledLog,
        measure: Callable[[int, Any, str], YawIncrement | None] | None = None,
        use: Callable[[YawIncrement], object] | None = None,
        after: Callable[[Callable[[], None]], None] = lambda done: done(),
    ) -> None:
        topics = settings.topics
        self._node = node
        self._compass = compass
        self._log = log
        self._measure = measure or compass.update
        self._use = use
        self._after = after
        self._frames = (topics.odom_frame, topics.base_frame)
        self._busy = threading.Lock()  # held while an image is worked on
        self._rate = CompassRate()
        self._confidence = math.nan
        self._dropped = 0  # at the last finding
        warm_up(settings)
        self.settings = settings
        self.health = StreamHealth()
        given, self._kind = image_topic(topics.compass_image, topics.image_transport)
        self.topic = resolved_name(node, given, "compass_image")
        self._pictures = PictureStream(settings.compass.decoded_columns)
        self._decode = surviving(node, self.topic, log, self._decode_packet)
        work = surviving(node, self.topic, log, self._work)
        self._worker: NewestWorker[ImageMessage | tuple[Picture, ...]] = NewestWorker(
            work, "images", EVERY_IMAGE_QOS.depth if topics.reliable else 1
        )
        compare = surviving(node, self.topic, log, self._compare)
        self._resets = 0
        self._back: NewestWorker[tuple[int, Comparison]] = NewestWorker(
            compare, "long baselines"
        )  # takes longer than an image may
        self._publisher = node.create_publisher(Odometry, topics.compass_output_topic, 10)
        self._done = node.create_publisher(Header, "~/image_done", EVERY_IMAGE_QOS) if topics.reliable else None
        self._subscription = node.create_subscription(
            self._kind,
            given,
            cast(Any, self._receive),  # takes the message's info, too, which rclpy's types leave out
            EVERY_IMAGE_QOS if topics.reliable else IMAGE_QOS if topics.image_transport == "raw" else PACKET_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=NO_DEFAULTS,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self.link = Link(node, self._subscription, given)

    def apply(self, settings: Settings) -> None:
        """Take over settings that may change while running."""
        self.settings = settings
        self._compass.config = settings.compass

    def reset(self, reset: Callable[[], None] | None = None) -> None:
        """Start the compass anew, by `reset` if given, once the image in work is done and before the next."""
        with self._busy:
            (reset or self._compass.reset)()
            self._resets += 1
            self._rate = CompassRate()

    def close(self) -> None:
        """End the threads, and let go of the subscription."""
        self._worker.close()
        self._back.close()
        self.link.close()

    def finding(self) -> Finding:
        """What the diagnostics say of images and compass."""
        timeout = self.settings.topics.sensor_timeout
        level, text, figures = stream_finding(self._node, self.health, timeout, self.link)
        dropped, self._dropped = self._worker.dropped - self._dropped, self._worker.dropped
        if level is Level.WARN and dropped:
            text += f"; {dropped} images overtaken while they waited for the compass"
        figures["dropped"] = str(self._worker.dropped)
        figures |= compass_figures(self._compass, self._confidence)
        return delivered(self._node, (level, text, figures | self._log.figures(self.topic)), self._publisher)

    @property
    def output(self) -> str:
        """Fully qualified name of the raw compass's topic."""
        return str(self._publisher.topic_name)

    def _receive(self, message: ImageMessage, info: dict[str, Any]) -> None:
        """Take all that wait: an executor that takes one a turn on a busy machine would stay a full queue behind."""
        for one, about in ((message, info), *islice(queued(self._subscription), PACKET_QOS.depth)):
            self._take_in(one, about)

    def _take_in(self, message: ImageMessage, info: dict[str, Any]) -> None:
        self.link.see(info.get("publication_sequence_number"))
        self.link.size = len(message.data)
        if isinstance(message, Image):
            self.link.shape = f"{message.width} x {message.height} {shown(message.encoding, 20)}"
        self.health.receive(time.monotonic())
        self._decode(message)

    def _decode_packet(self, message: ImageMessage) -> None:
        """A picture is decoded when its turn comes, if it comes; a video's packets all are, as they need each other."""
        if packet_of(message) is None:
            self._worker.offer(message)
            return
        pictures = tuple(self._pictures.add(message))
        if pictures or self._done is not None:  # whoever waits to hear that it is done is not to wait for a picture
            self._worker.offer(pictures)

    def _work(self, item: ImageMessage | tuple[Picture, ...]) -> None:
        """Serve a message, or the pictures that a packet completed."""
        try:
            if self._done is not None:  # what the compass knows of the tilt is not to depend on who came first
                settled = threading.Event()
                self._after(settled.set)
                settled.wait(LONGEST_SETTLING_S)
            with self._busy:
                for one in item if isinstance(item, tuple) else (self._picture_of(item),):
                    self._serve(one)
        finally:
            if self._done is not None:
                done, header = self._done, Header() if isinstance(item, tuple) else item.header
                self._after(lambda: done.publish(header))

    def _picture_of(self, message: ImageMessage) -> Picture:
        return Picture(stamp_to_ns(message.header.stamp), *image_of(message, self._compass.config.decoded_columns))

    def _serve(self, picture: Picture) -> None:
        compass, t_ns = self._compass, picture.t_ns
        increment = self._measure(t_ns, picture.image, picture.encoding)
        if increment is not None:
            self._confidence = increment.confidence
            self._publish(increment)
            if self._use is not None:
                self._use(increment)
                comparison = compass.due_long_baseline()
                if comparison is not None and self._done is not None:
                    self._take(comparison())
                elif comparison is not None:
                    self._back.offer((self._resets, comparison))
        elif compass.status is not CompassStatus.FIRST_FRAME:
            self._log(self.topic, compass.status.value)
            return
        if increment is None or self._use is None:
            self.health.use(time.monotonic(), t_ns)

    def _compare(self, due: tuple[int, Comparison]) -> None:
        """Compare over a long baseline; what comes of it after a reset is of before and goes nowhere."""
        resets, comparison = due
        increment = comparison()
        with self._busy:
            if resets == self._resets:
                self._take(increment)

    def _take(self, increment: YawIncrement | None) -> None:
        if increment is not None and self._use is not None:
            self._use(increment)

    def _publish(self, increment: YawIncrement) -> None:
        compass = self._compass
        rate, variance = self._rate.update(increment)
        self._publisher.publish(
            yaw_odometry(increment.t_ns, compass.yaw, compass.yaw_variance, rate, variance, self._frames)
        )
        if self.settings.topics.compass_textout:
            self._node.get_logger().info(f"angle {math.degrees(compass.yaw):.2f} deg")


def warm_up(settings: Settings) -> None:
    """Let the libraries load and plan what they do on first use; else the first images would wait for that."""
    compass = VisualCompass(settings.compass)
    view = np.random.default_rng(0).integers(0, 256, (512, 1024), np.uint8)
    with contextlib.suppress(ConfigError):  # the region of interest may lie outside of an image of another shape
        for t_ns, shift in enumerate((0, 3), 1):
            compass.update(t_ns * 30_000_000, np.roll(view, shift, axis=1))
