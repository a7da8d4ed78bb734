"""Samples of all sensors, gathered from their queues and handed on in the order of their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, cast

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from compass import YawIncrement
from fusion import GyroSample, OdometrySample
from nodes.link import NO_DEFAULTS, Link
from nodes.quality import SENSOR_QOS

Sample = GyroSample | OdometrySample | YawIncrement

TURN_S = 0.01  # between two looks into the queues
_MOST_PASSES = 10  # over the queues within one turn, when messages come faster than they are taken


class SampleQueue:
    """Looks into all queues every `TURN_S` while something comes; what was in them is used in the order of the stamps.

    rclpy's executor spends a millisecond on each message that it delivers, and delivers one per subscription and turn.
    A 200 Hz gyro would cost it half a core, which the images lack; and a node that fell behind would stay behind, and
    worse: images are ahead of the queued gyro then, and each late sample makes the filter replay what came after it.

    So the executor delivers only the first message after a pause. That begins a turn: a timer empties all queues until
    there was nothing in them, and meanwhile the executor does not wait for them. Who hears nothing does nothing.

    Parameters
    ----------
    node : Node
        Owner of the subscriptions.
    use : callable
        Takes samples sorted by stamp, always in the executor's thread.
    qos : QoSProfile
        Of the subscriptions.
    """

    def __init__(self, node: Node, use: Callable[[list[Sample]], None], qos: QoSProfile = SENSOR_QOS) -> None:
        self._node = node
        self._use = use
        self._qos = qos
        self._afterwards: deque[Callable[[], None]] = deque()
        self._increments: deque[YawIncrement] = deque()
        self._queues: list[tuple[Subscription, Link, Callable[[Any], None]]] = []
        self._samples: list[Sample] = []
        self._idle = WhileIdle()
        self._woken = node.create_guard_condition(self._wake)
        # A steady clock: with use_sim_time and a paused bag, the queues are emptied all the same.
        self._timer = node.create_timer(TURN_S, self._turn, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def listen(self, kind: type, topic: str, convert: Callable[[Any], None]) -> Link:
        """Subscribe; `convert` is to `append` the sample of a message, and must not raise."""

        def first(message: Any, info: dict[str, Any]) -> None:
            link.see(info.get("publication_sequence_number"))
            convert(message)
            self._wake()

        subscription = self._node.create_subscription(
            kind,
            topic,
            cast(Any, first),  # takes the message's info, too, which rclpy's types leave out
            self._qos,
            callback_group=self._idle,
            event_callbacks=NO_DEFAULTS,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        link = Link(self._node, subscription, topic)
        self._queues.append((subscription, link, convert))
        return link

    def append(self, sample: Sample) -> None:
        """Add a sample to this turn, from the executor's thread."""
        self._samples.append(sample)

    def send(self, increment: YawIncrement) -> None:
        """Hand in an increment, from any thread."""
        self._increments.append(increment)
        self._trigger()

    def call(self, done: Callable[[], None]) -> None:
        """Have `done` called, in the executor's thread, once all that has arrived so far is used; from any thread."""
        self._afterwards.append(done)
        self._trigger()

    def _trigger(self) -> None:
        """Wake the executor; while it looks into the queues every turn, the next turn is soon enough."""
        if self._idle.idle:
            self._woken.trigger()

    def clear(self) -> None:
        """Forget what waits."""
        self._increments.clear()
        self._samples.clear()

    def _wake(self) -> None:
        """Look into the queues, and go on with that, in the executor's thread."""
        if self._idle.idle:
            self._idle.idle = False
            self._timer.reset()
            self._turn()

    def _turn(self) -> None:
        afterwards = len(self._afterwards)  # those asked for later may mean messages that this turn does not see
        for _ in range(_MOST_PASSES):  # while one queue is emptied, others fill: what they hold by then is older
            if not self._pass():
                break
        while self._increments:
            self._samples.append(self._increments.popleft())
        samples, self._samples = self._samples, []
        if samples:
            self._use(sorted(samples, key=lambda sample: sample.t_ns))
        for _ in range(afterwards):
            self._afterwards.popleft()()
        if not samples:
            self._idle.idle = True
            if self._increments or self._afterwards:  # came since, from a thread that may have seen no pause
                self._idle.idle = False
            else:
                self._timer.cancel()

    def _pass(self) -> int:
        """Empty each queue once, of a flood only as much as it can hold; returns how many messages were in them."""
        count = 0
        for subscription, link, convert in self._queues:
            for message, info in islice(queued(subscription), self._qos.depth):
                link.see(info.get("publication_sequence_number"))
                convert(message)
                count += 1
        return count


class WhileIdle(CallbackGroup):
    """Keeps subscriptions in the executor's wait set only while `idle`: else their queues are emptied by hand."""

    def __init__(self) -> None:
        super().__init__()
        self.idle = False  # the timer runs at the start

    def can_execute(self, entity: Any) -> bool:
        """Tell the executor to wait for them, or to pass over them."""
        return self.idle

    def beginning_execution(self, entity: Any) -> bool:
        """Tell the executor that one of them may run: the first, which ends the pause."""
        return self.idle

    def ending_execution(self, entity: Any) -> None:
        """Nothing to undo."""


def queued(subscription: Subscription) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Messages that wait in a queue, taken out of it (see `rclpy.wait_for_message`), each with its message info."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
            yield taken
