"""The way from the publishers of a topic to a subscription: who sends, what does not match, what is lost."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.utilities import get_rmw_implementation_identifier
from sensor_msgs.msg import Image

from nodes.health import SequenceGaps
from nodes.names import compressed_topic
from nodes.throttled_log import ThrottledLog

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
SEGMENT = 512 * 1024  # bytes of shared memory of a Fast DDS participant without a profile
LOST_SHARE = 0.1  # of what was sent in a period; more than this is worth a warning
NO_DEFAULTS = SubscriptionEventCallbacks(use_default_callbacks=False)


class Link:
    """What can be seen at a subscription of the publishers and of the messages that never arrive.

    Parameters
    ----------
    node : Node
        Owner of the subscription.
    subscription : Subscription
        Made with `NO_DEFAULTS`: who does not match is seen in the graph.
    given : str
        The name it was made with, not yet resolved.

    Attributes
    ----------
    name : str
        Fully qualified name of the topic.
    lost : int
        Messages of which the middleware says that they were sent and never arrived.
    size : int or None
        Bytes of the last message.
    shape : str
        The last message in words, such as ``3840 x 1920 bgr8``.
    """

    def __init__(self, node: Node, subscription: Subscription, given: str) -> None:
        self.name = subscription.topic_name
        self.kind: Any = subscription.msg_type
        self.lost = 0
        self.size: int | None = None
        self.shape = ""
        self._node = node
        self._given = given
        self._profile: QoSProfile = subscription.qos_profile
        self._gaps = SequenceGaps()
        self._received = 0
        self._ids: set[bytes] = set()
        self._period = (0, 0, 0)  # lost, overtaken and received at its start
        self._losses = ""
        self._log = ThrottledLog(lambda line: node.get_logger().warning(line))
        self._steps_back: deque[int] = deque([0, 0], maxlen=2)  # of the last two periods
        self._lost = LostMessages(subscription)

    def close(self) -> None:
        """Let go of the subscription, which is about to be destroyed."""
        self._lost.close()

    def see(self, number: int | None) -> None:
        """Note a message that arrived; `number` is its publisher's sequence number, None where there is none."""
        self._received += 1
        self._gaps.see(number)

    def look(self) -> tuple[str, bool, dict[str, str]]:
        """What is wrong since the last look, in words (empty: nothing), whether that explains silence, and figures."""
        senders = self._node.get_publishers_info_by_topic(self._given)
        self.lost = self._lost.count()
        lost, overtaken, received = self._since_last(senders)
        figures = {
            "publishers": ", ".join(names(senders)) or "none",
            "lost on the way": str(self.lost),
            "overtaken before they were taken": str(max(self._gaps.skipped - self.lost, 0)),
        }
        wrong = self._mismatch(senders)
        if wrong:
            figures["not matching"] = wrong
        loss = self._loss(lost, overtaken, received, senders)
        several = self._several(senders)
        for fault in filter(None, (wrong, loss, several)):
            self._log(self.name, fault)
        return "; ".join(filter(None, (wrong, loss, several))), bool(wrong or loss), figures

    def _since_last(self, senders: list[TopicEndpointInfo]) -> tuple[int, int, int]:
        """Messages lost, overtaken and received since the last look."""
        ids = {bytes(sender.endpoint_gid) for sender in senders}
        self._gaps.settle(len(ids) == 1 and ids == self._ids)  # else a gap may be between two publishers
        self._ids = ids
        self._steps_back.append(self._gaps.take_steps_back())
        now = self.lost, max(self._gaps.skipped - self.lost, 0), self._received
        before, self._period = self._period, now
        lost, overtaken, received = (new - old for new, old in zip(now, before, strict=True))
        return lost, max(overtaken, 0), received

    def _loss(self, lost: int, overtaken: int, received: int, senders: list[TopicEndpointInfo]) -> str:
        sent = lost + overtaken + received
        if sent or self._received:  # else nothing new is known: all there ever was is lost
            why = self._why_lost(senders)
            parts = [(lost, f"lost on the way {why}"), (overtaken, "overtaken before the node could take them")]
            self._losses = "; ".join(
                f"{count} of {sent} messages ({100.0 * count / sent:.0f} %) {what}"
                for count, what in parts
                if count > LOST_SHARE * sent + 1.0
            )
        return self._losses if senders else ""

    def _why_lost(self, senders: list[TopicEndpointInfo]) -> str:
        """What is known of the reason, and the remedy."""
        who = " and ".join(names(senders)) or "a publisher that is gone"
        large = self.size is None or self.size > SEGMENT
        if self.kind is not Image or not large or "fastrtps" not in get_rmw_implementation_identifier():
            return f"from {who}: the machine or the network is overloaded"
        size = "raw panoramas are larger" if self.size is None else f"{self.shape} are {self.size / 1e6:.1f} MB"
        profile = os.environ.get(PROFILE, "config/fastdds.xml of this package")
        return (
            f"from {who}: its shared memory has {SEGMENT / 1e6:.1f} MB unless its DDS profile says otherwise, "
            f"and {size}; start it with {PROFILE}={profile}, or let it send compressed images"
        )

    def _mismatch(self, senders: Iterable[TopicEndpointInfo]) -> str:
        """Publishers from which nothing can come, as their quality of service does not match."""
        return mismatches(senders, lambda sender: (sender.qos_profile, self._profile), "sends nothing to us")

    def _several(self, senders: list[TopicEndpointInfo]) -> str:
        """Two publishers whose messages come by turns; one that is restarted goes back in its numbers only once."""
        if len(senders) < 2 or sum(self._steps_back) < 2:
            return ""
        return f"{len(senders)} publishers send on {self.name}: {', '.join(names(senders))}; one of them is to be used"

    def why_silent(self) -> str:
        """What can be seen from here of the reason why nothing comes; begins with "; " unless empty."""
        wanted = type_name(self.kind)
        others = {sender.topic_type for sender in self._node.get_publishers_info_by_topic(self._given)}
        if not others:
            compressed = compressed_topic(self._given)
            if compressed != self._given and self._node.count_publishers(compressed):
                hint = f"{compressed_topic(self.name)} is there: set image_transport to compressed"
                return f"; nobody publishes {self.name}, but {hint}"
            return f"; nobody publishes {self.name}"
        if wanted not in others:
            return f"; {self.name} is a {', '.join(sorted(others))}, not a {wanted}"
        return ""


class LostMessages:
    """The middleware's count of the messages of a subscription that were sent and never arrived.

    It is asked now and then: an event handler in the executor's wait set would wake that with every message. Its
    handle, as `rclpy.event_handler` has it, must not outlive the subscription: `close` it before.
    """

    def __init__(self, subscription: Subscription) -> None:
        self._event: Any = None
        self._count = 0
        with suppress(UnsupportedEventTypeError), subscription.handle:
            kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
            self._event = rclpy_implementation.EventHandle(subscription.handle, kind)

    def count(self) -> int:
        """All so far; 0 where the middleware does not count."""
        event = self._event
        if event is not None:
            with event:
                status = event.take_event()
            self._count = self._count if status is None else int(status.total_count)
        return self._count

    def close(self) -> None:
        """Let go of the handle; the count stays."""
        if self._event is not None:
            self._event.destroy_when_not_in_use()
            self._event = None


def unserved(node: Node, topic: str, profile: QoSProfile) -> str:
    """Subscribers of a topic of ours that get nothing, as their quality of service does not match; empty if none."""
    takers = node.get_subscriptions_info_by_topic(topic)
    return mismatches(takers, lambda taker: (profile, taker.qos_profile), "gets nothing from us")


def rivals(node: Node, topic: str) -> str:
    """Others who publish on a topic of ours, as a node that was started twice; empty if none."""
    senders = names(node.get_publishers_info_by_topic(topic))
    if len(senders) < 2:
        return ""
    return (
        f"{len(senders)} publishers send on {node.resolve_topic_name(topic)}: {', '.join(senders)}; who listens hears "
        "them by turns: stop one, or give it another namespace"
    )


def mismatches(
    ends: Iterable[TopicEndpointInfo],
    pair: Callable[[TopicEndpointInfo], tuple[QoSProfile, QoSProfile]],
    effect: str,
) -> str:
    """Who is at the other end in vain, and why; `pair` gives what the publisher offers and the subscriber asks for."""
    found = []
    for end in ends:
        offered, asked = pair(end)
        why = []
        if asked.reliability == ReliabilityPolicy.RELIABLE and offered.reliability == ReliabilityPolicy.BEST_EFFORT:
            why.append("reliable is asked for, best effort offered")
        if asked.durability == DurabilityPolicy.TRANSIENT_LOCAL and offered.durability == DurabilityPolicy.VOLATILE:
            why.append("transient local is asked for, volatile offered")
        if why:
            found.append(f"{full_name(end)} {effect}: {', '.join(why)}")
    return "; ".join(found)


def names(ends: Iterable[TopicEndpointInfo]) -> list[str]:
    """Fully qualified names of the nodes at the other end, each as often as it is there."""
    return sorted(full_name(end) for end in ends)


def full_name(end: TopicEndpointInfo) -> str:
    """Fully qualified name of a node at the other end."""
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"


def type_name(kind: type) -> str:
    """Name of a message class as ROS writes it, ``sensor_msgs/msg/Imu``."""
    package = kind.__module__.split(".")[0]
    return f"{package}/msg/{kind.__name__}"
