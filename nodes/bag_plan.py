"""What is to be played from a bag and where it goes, from the arguments of a launch file. No ROS graph needed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

import yaml

from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import IMAGE, Topic
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import NONE, TopicSettings, load_settings
from nodes.bag_player import PlayerConfig
from nodes.names import compressed_topic, raw_topic

# launch argument -> option of `visual-compass fuse` that means the same; errors speak of the latter
SENSORS = {"compass_image": "--image-topic", "gyro_topic": "--gyro-topic", "odometry_topic": "--odometry-topic"}


@dataclass(frozen=True)
class BagPlan:
    """What the nodes are to be told.

    Attributes
    ----------
    player : PlayerConfig
        Parameters of the player.
    topics : mapping of str to Topic
        Topics of the bag by the launch argument that names them.
    transport : str
        ``image_transport`` of the compass.
    """

    player: PlayerConfig
    topics: Mapping[str, Topic]
    transport: str

    @property
    def arguments(self) -> dict[str, str]:
        """Launch arguments for the compass; a sensor that the bag does not hold is not there."""
        names = {name: raw_topic(self.topics[name].name) if name in self.topics else NONE for name in SENSORS}
        reliable = {"reliable": "true"} if self.player.image_done else {}
        return names | {"image_transport": self.transport} | reliable

    @property
    def compressed_images(self) -> str | None:
        """Name in the bag of the compressed panoramas; None where they are raw or absent."""
        image = self.topics.get("compass_image")
        return None if image is None or image.msgtype == IMAGE else image.name

    @property
    def remappings(self) -> list[tuple[str, str]]:
        """For the player: compressed panoramas go where image_transport expects them."""
        name = self.compressed_images
        return [] if name is None or name == compressed_topic(name) else [(name, compressed_topic(name))]

    @property
    def republish(self) -> bool:
        """Whether compressed panoramas are to be republished as raw ones."""
        return self.compressed_images is not None and self.transport == "raw"


def plan_bag(given: Mapping[str, str], parameters: str) -> BagPlan:
    """Look into the bag and check the arguments.

    Parameters
    ----------
    given : mapping
        Launch arguments; an empty one is not given.
    parameters : str
        Path of the parameter file.

    Raises
    ------
    VisualCompassError
        An argument is unusable, the bag cannot be read or lacks a topic.
    """
    values = {name: yaml.safe_load(given[name]) for name in ("rate", "start_offset", "loop")}
    path = os.path.abspath(os.path.expanduser(given["bagfile"]))
    player = PlayerConfig.from_dict({"bagfile": path, **values})
    names = [name for name in (*SENSORS, "image_transport") if given.get(name)]
    settings = load_settings(parameters, {name: given[name] for name in names}).topics
    topics = find_topics(path, settings, given)
    image = topics.get("compass_image")
    reliable = yaml.safe_load(given.get("reliable") or "false")
    transport = "raw" if image and image.msgtype == IMAGE else "compressed" if reliable else settings.image_transport
    node = given.get("name") or given.get("node") or "fusion_node"
    done = "/".join(["", *filter(None, given.get("namespace", "").split("/")), node, "image_done"])
    player = replace(player, image_done=done if reliable and image else "")
    return BagPlan(replace(player, wait_for=",".join(topic.name for topic in topics.values())), topics, transport)


def find_topics(path: str, settings: TopicSettings, given: Mapping[str, str]) -> dict[str, Topic]:
    """The topics that `visual-compass fuse` would take, by launch argument."""
    image, gyro, odometry = (given.get(name) or None for name in SENSORS)
    if given.get("node") == "compass_node":
        gyro = odometry = NONE
    try:
        with Bag(path) as bag:
            choice = choose_topics(bag, settings, TopicRequest(image, gyro, odometry))
    except BagError as error:
        text = str(error)
        for argument, option in SENSORS.items():
            text = text.replace(f"{option} /", f"{argument}:=/").replace(option, f"{argument}:=")
        raise BagError(text) from None
    found = zip(SENSORS, (choice.image, choice.gyro, choice.odometry), strict=True)
    return {name: topic for name, topic in found if topic}
