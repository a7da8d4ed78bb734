"""Samples of all sensors, gathered from their queues and handed on in the order of their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from compass import YawIncrement
from fusion import GyroSample, OdometrySample

Sample = GyroSample | OdometrySample | YawIncrement

# Sensor-data profile, save that half a second of a fast gyro can wait out a pause of the process: each sample counts.
SENSOR_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class Inbox:
    """One turn of the executor empties every queue; its samples are then used in the order of their stamps.

    rclpy hands out one message per subscription and turn. A node that fell behind would stay behind, and worse: images
    are ahead of the queued gyro then, and each late sample makes the filter replay what came after it.

    Parameters
    ----------
    node : Node
        Owner of the subscriptions.
    use : callable
        Takes samples sorted by stamp, always in the executor's thread.
    """

    def __init__(self, node: Node, use: Callable[[list[Sample]], None]) -> None:
        self._node = node
        self._use = use
        self._increments: deque[YawIncrement] = deque()
        self._queues: list[tuple[Subscription, Callable[[Any], None]]] = []
        self._samples: list[Sample] = []
        self._wake = node.create_guard_condition(self._turn)

    def listen(self, kind: type, topic: str, convert: Callable[[Any], None]) -> None:
        """Subscribe; `convert` is to `append` the sample of a message, and must not raise."""

        def receive(message: Any) -> None:
            convert(message)
            self._turn()

        options = QoSOverridingOptions.with_default_policies()
        subscription = self._node.create_subscription(kind, topic, receive, SENSOR_QOS, qos_overriding_options=options)
        self._queues.append((subscription, convert))

    def append(self, sample: Sample) -> None:
        """Add a sample to this turn, from the executor's thread."""
        self._samples.append(sample)

    def send(self, increment: YawIncrement) -> None:
        """Hand in an increment from any other thread."""
        self._increments.append(increment)
        self._wake.trigger()

    def clear(self) -> None:
        """Forget what waits."""
        self._increments.clear()
        self._samples.clear()

    def _turn(self) -> None:
        for subscription, convert in self._queues:
            for message in queued(subscription):
                convert(message)
        while self._increments:
            self._samples.append(self._increments.popleft())
        samples, self._samples = self._samples, []
        self._use(sorted(samples, key=lambda sample: sample.t_ns))


def queued(subscription: Subscription) -> Iterator[Any]:
    """Messages that wait in a subscription's queue, taken out of it (as `rclpy.wait_for_message` does)."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
            yield taken[0]
