"""Plays a bag of any format into ROS 2: ROS 1 bags, rosbag2 sqlite3, MCAP."""

from __future__ import annotations

import importlib
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock as SteadyClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from compass.errors import VisualCompassError
from compass.parameters import ParameterSet, parameter
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import COMPRESSED_IMAGE, IMAGE, Message
from nodes.conversions import ns_to_stamp
from nodes.in_turn import LONGEST_TURN_S, InTurn
from nodes.parameters import declare_config
from nodes.playback_clock import PlaybackClock
from nodes.quality import EVERY_IMAGE_QOS, EVERY_SAMPLE_QOS
from nodes.runtime import FinishedError, run

IMAGES = (IMAGE, COMPRESSED_IMAGE)
SETTLE_S = 0.5  # from the first sight of a subscriber until messages surely reach it


@dataclass(frozen=True)
class PlayerConfig(ParameterSet):
    """Settings of the bag player."""

    bagfile: str = parameter("", "the bag: a .bag, an .mcap, a .db3 or a rosbag2 folder")
    rate: float = parameter(1.0, "seconds of the bag per second", unit="s/s", low=0.01, high=100.0, live=True)
    start_offset: float = parameter(
        0.0, "seconds of the bag to skip; set while it plays: go there", unit="s", low=0.0, high=1e9, live=True
    )
    loop: bool = parameter(False, "begin again at the end", live=True)
    paused: bool = parameter(False, "start paused; go on with ~/pause, or from image to image with ~/step")
    topics: str = parameter("", "topics to play, separated by commas; empty: all")
    wait_for: str = parameter("", "topics that must have a subscriber before the start, separated by commas")
    wait_time: float = parameter(
        10.0, "longest wait for those subscribers, and for who tells on `image_done`", unit="s", low=0.0, high=3600.0
    )
    image_done: str = parameter(
        "", "topic on which a node with `reliable` tells that it is done with an image; all else waits for that"
    )
    clock_rate: float = parameter(
        100.0, "messages a second on /clock (bag time, for use_sim_time); 0: none", unit="Hz", low=0.0, high=1000.0
    )


class BagPlayer(Node):
    """Publishes the messages of a bag when they are due, as they were recorded, stamps included."""

    def __init__(self) -> None:
        super().__init__("bag_player", automatically_declare_parameters_from_overrides=True)
        self._config = declare_config(self, PlayerConfig)
        if not self._config.bagfile:
            raise BagError("parameter 'bagfile' is empty; give the path of a bag: -p bagfile:=/path/to/bag")
        self._bag = Bag(self._config.bagfile).__enter__()
        self._loop = self._config.loop
        self._playback = PlaybackClock(self._config.rate)
        self._playback.pause(self._config.paused)
        self._publishers_by_topic = self._make_publishers()
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if self._config.clock_rate > 0.0 else None
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self._seek_ns: int | None = None  # asked for
        self._steps = 0  # images to be played while paused
        self._in_turn = InTurn() if self._config.image_done else None
        self._has_images = any(topic.msgtype in IMAGES for topic in self._bag.topics if self._plays(topic.name))
        if self._in_turn is not None:
            done = self._in_turn.done
            self.create_subscription(Header, self._config.image_done, lambda _: done(), EVERY_IMAGE_QOS)
        self.add_post_set_parameters_callback(self._on_change)
        self._open = True
        self._failure: VisualCompassError | None = None
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)
        self._thread.start()
        self.create_timer(0.1, self._watch, clock=SteadyClock(clock_type=ClockType.STEADY_TIME))

    def _watch(self) -> None:
        """In the main thread: end when the player's thread has ended."""
        if not self._thread.is_alive():
            raise self._failure or FinishedError

    def _make_publishers(self) -> dict[str, Publisher]:
        wanted = listed(self._config.topics)
        missing = [name for name in wanted if name not in {topic.name for topic in self._bag.topics}]
        if missing:
            names = ", ".join(topic.name for topic in self._bag.topics)
            raise BagError(f"{self._bag.path}: {', '.join(missing)} not in the bag; topics: {names}")
        publishers = {}
        for topic in self._bag.topics:
            if topic.name == "/clock" or (wanted and topic.name not in wanted):
                continue
            kind = message_class(topic.msgtype)
            if kind is None:
                self.get_logger().warning(f"{topic.name} is not played: {topic.short_type} is not installed")
            else:
                profile = quality(topic.name, topic.msgtype, every=bool(self._config.image_done))
                publishers[topic.name] = self.create_publisher(kind, topic.name, profile)
        return publishers

    def _run(self) -> None:
        """The player's thread, from the first message to the last."""
        try:
            self._wait_for_subscribers()
            played = self._play()
            while self._loop and played and self._open:
                played = self._play()
        except VisualCompassError as error:
            self._failure = error
        except Exception:
            if self.context.ok():  # else a publisher lost its context: the end was asked for
                raise
        finally:
            self._open = False

    def _wait_for_subscribers(self) -> None:
        awaited = [topic for topic in listed(self._config.wait_for) if topic in self._publishers_by_topic]
        end = time.monotonic() + self._config.wait_time
        while self._open and time.monotonic() < end:
            awaited = [t for t in awaited if not self._publishers_by_topic[t].get_subscription_count()]
            if not awaited and self._is_told():
                break
            time.sleep(0.02)
        if awaited:
            self.get_logger().warning(f"nobody subscribes to {', '.join(awaited)}; playing all the same")
        time.sleep(SETTLE_S)
        if not self._is_told():
            self.get_logger().warning(f"nobody is there to tell on {self._config.image_done}; playing all the same")
            self._in_turn = None

    def _is_told(self) -> bool:
        """Whether somebody would tell that an image is done, where that is waited for."""
        return self._in_turn is None or self.count_publishers(self._config.image_done) > 0

    def _plays(self, topic: str) -> bool:
        return topic in self._publishers_by_topic

    def _play(self) -> int:
        """Play once from start to end, and from wherever it is told to go; returns the number of messages."""
        start_ns = self._bag.start_ns + round(self._config.start_offset * 1e9)
        count = self._play_from(start_ns)
        while self._open and self._seek_ns is not None:
            start_ns, self._seek_ns = self._seek_ns, None
            count += self._play_from(start_ns)
        if not self._open:
            return 0
        for publisher in self._publishers_by_topic.values() if self._config.image_done else ():
            publisher.wait_for_all_acked(Duration(seconds=LONGEST_TURN_S))
        self.get_logger().info(f"played {count} messages of {self._bag.path}")
        return count

    def _play_from(self, start_ns: int) -> int:
        self._playback.start(start_ns)
        count = 0
        for message in self._bag.replay(list(self._publishers_by_topic), start_ns):
            if not self._wait(message):
                return count
            image = message.msgtype in IMAGES
            if self._wait_for_node() and image and self._in_turn is not None:
                self._in_turn.begin()
            self._publishers_by_topic[message.topic].publish(message.raw)
            self._steps -= self._steps > 0 and (image or not self._has_images)
            count += 1
        self._wait_for_node()
        return count

    def _wait_for_node(self) -> bool:
        """Wait until the node is done with the last image; False if it does not tell, as it never will.

        Samples wait as well: an image that takes longer than `lag_window` would come too late after them.
        """
        if self._in_turn is not None and not self._in_turn.wait(lambda: self._open):
            self.get_logger().warning(f"nobody tells on {self._config.image_done}; playing all the same")
            self._in_turn = None
        return self._in_turn is not None

    def _wait(self, message: Message) -> bool:
        """Wait until a message is due, ticking ``/clock`` meanwhile; False when it is not to be played any more."""
        tick = 1.0 / self._config.clock_rate if self._config.clock_rate > 0.0 else 0.1
        while self._open and self._seek_ns is None:
            if self._steps:
                self._playback.start(message.record_ns)  # and it stands there still
                break
            if self._playback.wait(message.record_ns, tick):
                break
            self._tick(min(self._playback.now_ns(), message.record_ns))
        self._tick(message.record_ns)
        return self._open and self._seek_ns is None

    def _tick(self, bag_ns: int) -> None:
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=ns_to_stamp(bag_ns)))

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._playback.pause(request.data)
        response.success, response.message = True, "paused" if request.data else "playing"
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._playback.paused
        self._steps += response.success
        response.message = "one image further" if response.success else "not paused; call ~/pause first"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._open = False
        response.success, response.message = True, "stopped"
        return response

    def _on_change(self, parameters: list[Any]) -> None:
        for changed in parameters:
            if changed.name == "rate":
                self._playback.set_rate(changed.value)
            elif changed.name == "start_offset":
                self._seek_ns = self._bag.start_ns + round(changed.value * 1e9)
            elif changed.name == "loop":
                self._loop = changed.value

    def destroy_node(self) -> None:
        """End the player's thread, close the bag, then the node."""
        self._open = False
        self._thread.join(2.0)
        self._bag.__exit__(None, None, None)
        super().destroy_node()


def listed(names: str) -> list[str]:
    """Names separated by commas."""
    return [name.strip() for name in names.split(",") if name.strip()]


def message_class(msgtype: str) -> Any:
    """The installed class of ``package/msg/Name``; None where there is none."""
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name, None)
    except ImportError:
        return None


def quality(topic: str, msgtype: str, *, every: bool) -> QoSProfile:
    """Reliable, as it serves subscribers of either kind; few images, as a queue of them would be too large.

    Where `every` message counts, as much may wait to be delivered as lies between two images.
    """
    if every:
        return EVERY_IMAGE_QOS if msgtype in IMAGES else EVERY_SAMPLE_QOS
    profile = QoSProfile(depth=2 if msgtype == IMAGE else 50, reliability=ReliabilityPolicy.RELIABLE)
    if topic == "/tf_static":
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return profile


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass bag_player``."""
    return run(BagPlayer, args)


if __name__ == "__main__":
    sys.exit(main())
