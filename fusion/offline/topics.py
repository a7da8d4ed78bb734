"""Which topics of a bag are the panoramas, the gyro, the tracks and the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import COMPRESSED_IMAGE, IMAGE, IMU, ODOMETRY, VIDEOS, Topic
from fusion.settings import NONE, TopicSettings, absent, in_bag

DEPTH = "/compressedDepth"  # the suffix that image_transport's depth plugin adds
PREFERRED = {"compressed": "CompressedImage", "ffmpeg": "FFMPEGPacket", "foxglove": "CompressedVideo"}
TRUTH_TOPIC = TopicSettings().truth_topic  # where simulated bags keep it


@dataclass(frozen=True, slots=True)
class TopicRequest:
    """Topics asked for by name; None finds one, ``"none"`` leaves the sensor out."""

    image: str | None = None
    gyro: str | None = None
    odometry: str | None = None
    truth: str | None = None


@dataclass(frozen=True, slots=True)
class TopicChoice:
    """The topics to read; None where there is none."""

    image: Topic | None
    gyro: Topic | None
    odometry: Topic | None
    truth: Topic | None

    def __iter__(self) -> Iterator[Topic]:
        return (topic for topic in (self.image, self.gyro, self.odometry, self.truth) if topic)


def choose_topics(bag: Bag, settings: TopicSettings, request: TopicRequest | None = None) -> TopicChoice:
    """Pick each topic: the one asked for, else the one the settings name, else the only one of its type.

    A sensor that the settings call absent is left out unless it is asked for.

    Raises
    ------
    BagError
        A requested topic is absent or of another type, several come into question, or no sensor is there at all.
    """
    request = request or TopicRequest()
    if request.truth == request.odometry and not absent(request.truth or NONE):
        raise BagError(
            f"{bag.path}: {request.truth} is asked for as odometry and as truth; what is fused judges nothing"
        )
    outputs = (settings.compass_output_topic, settings.fused_output_topic)
    named = in_bag(settings.odometry_topic)  # on purpose, perhaps
    ours = tuple(name for name in outputs if in_bag(name) != named)
    truth = _choose(bag, [ODOMETRY], request.truth, settings.truth_topic, "--truth-topic", by_type=False)
    taken = (*ours, in_bag(truth.name)) if truth else ours
    odometry = _choose(bag, [ODOMETRY], request.odometry, settings.odometry_topic, "--odometry-topic", taken=taken)
    gyro = _choose(bag, [IMU], request.gyro, settings.gyro_topic, "--gyro-topic")
    kinds = [IMAGE, COMPRESSED_IMAGE, *VIDEOS]
    if settings.image_transport != "raw":
        kinds.sort(key=lambda kind: (kind == IMAGE, PREFERRED[settings.image_transport] not in kind))
    image = _choose(bag, kinds, request.image, settings.compass_image, "--image-topic")
    if not (image or gyro or odometry):
        wanted = ", ".join(kind.replace("/msg/", "/") for kind in (IMAGE, COMPRESSED_IMAGE, IMU, ODOMETRY))
        found = ", ".join(f"{topic.name} ({topic.short_type})" for topic in bag.topics) or "nothing"
        raise BagError(f"{bag.path}: no usable topic; wanted {wanted}; found {found}")
    return TopicChoice(image, gyro, odometry, truth)


def settings_as_asked(settings: TopicSettings, request: TopicRequest) -> TopicSettings:
    """The settings by which `choose_topics` finds in the same bag what it finds by these and `request`."""
    names = {
        "compass_image": request.image,
        "gyro_topic": request.gyro,
        "odometry_topic": request.odometry,
        "truth_topic": request.truth,
    }
    changes = {name: asked for name, asked in names.items() if asked is not None}
    if request.image is not None and not absent(request.image):
        changes["image_transport"] = "raw" if camera_topic(request.image) == request.image else "compressed"
    return replace(settings, **changes)  # type: ignore[arg-type]


def _choose(
    bag: Bag,
    kinds: Sequence[str],
    requested: str | None,
    preferred: str,
    option: str,
    *,
    taken: Sequence[str] = (),
    by_type: bool = True,
) -> Topic | None:
    """One topic of one of `kinds`; earlier kinds win where the same camera is there twice."""
    if absent(preferred if requested is None else requested):
        return None
    candidates = [
        topic
        for kind in kinds
        for topic in bag.topics
        if topic.msgtype == kind and topic.count > 0 and not is_depth(topic)
    ]
    if requested is not None:
        return _requested(bag, candidates, requested, kinds, option)
    candidates = [topic for topic in candidates if not any(_means(name, topic.name) for name in taken)]
    named = [topic for topic in candidates if _means(camera_topic(preferred), _base(topic))]
    in_root = [topic for topic in named if _base(topic) == in_bag(camera_topic(preferred))]
    candidates = in_root[:1] or named or candidates
    if not by_type and not named:
        return None
    if len({_base(topic) for topic in candidates}) > 1:
        names = ", ".join(topic.name for topic in candidates)
        raise BagError(
            f"{bag.path}: several topics of type {_types(kinds)}: {names}; choose one with {option} (or '{NONE}')"
        )
    return candidates[0] if candidates else None


def _requested(bag: Bag, candidates: Sequence[Topic], name: str, kinds: Sequence[str], option: str) -> Topic:
    """The topic of that name, transport suffix optional."""
    exact = [topic for topic in candidates if topic.name == name]
    alike = [topic for topic in candidates if in_bag(name) in (in_bag(topic.name), _base(topic))]
    if exact or alike:
        return (exact or alike)[0]
    names = ", ".join(topic.name for topic in candidates) or NONE
    other = next((topic for topic in bag.topics if topic.name == name), None)
    fault = "not in the bag"
    if other and is_depth(other):
        fault = "is a compressedDepth image, distances and no picture"
    elif other:
        fault = f"is of type {other.short_type}" if other.count else "has no messages"
    raise BagError(f"{bag.path}: {option} {name} {fault}; topics of type {_types(kinds)}: {names}")


def is_depth(topic: Topic) -> bool:
    """Whether image_transport's depth compression made the topic: the type is that of a picture, the content is not."""
    return topic.msgtype == COMPRESSED_IMAGE and topic.name.endswith(DEPTH)


def _means(name: str, topic: str) -> bool:
    """Whether a name of the settings means this topic of the bag; a relative one may be in any namespace."""
    return in_bag(topic) == name if name.startswith("/") else in_bag(topic).endswith(f"/{name}")


def _base(topic: Topic) -> str:
    """The name, with a slash ahead, without the suffix that image_transport adds."""
    name = in_bag(topic.name)
    return camera_topic(name) if topic.msgtype in (COMPRESSED_IMAGE, *VIDEOS) else name


def camera_topic(name: str) -> str:
    """Name of a camera's topic without the suffix that image_transport adds."""
    return name.removesuffix("/compressed").removesuffix("/ffmpeg").removesuffix("/foxglove")


def _types(kinds: Sequence[str]) -> str:
    return " or ".join(kind.replace("/msg/", "/") for kind in sorted(kinds))
