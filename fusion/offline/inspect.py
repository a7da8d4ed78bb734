"""``visual-compass inspect``: what is in a bag, what is wrong with it, and what the compass would look at."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np

from compass import CompassConfig, ImageError
from compass.images.decode import Image, to_grey
from compass.images.orientation import Orientation
from compass.images.projection import projection_of
from compass.images.unwrap import unwrapping
from fusion.messages import MessageError
from fusion.offline.atomic_output import staged_file
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import IMAGES, IMU, ODOMETRY, Message, Topic
from fusion.offline.clock_steps import YEAR_2200_NS
from fusion.offline.console import progress_bar, table
from fusion.offline.first_minute import first_minute
from fusion.offline.streams import Floats, Times
from fusion.offline.topics import TopicRequest, choose_topics, is_depth
from fusion.pictures import PictureStream
from fusion.settings import Settings

_FUSED = (IMU, ODOMETRY, *IMAGES)
MOST = (0.02, 0.98, 0.5)  # from where to where nearly all stamps lie, and their median, as parts of all
DAY_NS = 86_400_000_000_000  # longer than a drive
YEAR_2000_NS = 946_684_800_000_000_000  # before it no bag was recorded
LATEST_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Timing:
    """How the messages of a topic follow each other by ``header.stamp``.

    Attributes
    ----------
    rate_hz : float
        From the median step; NaN below two messages.
    longest_gap_s : float
        Longest silence, s.
    backward, repeated, zero : int
        Stamps smaller than the one recorded before, equal to it, and never set.
    delay_s : float
        Median of record time minus stamp, s; NaN without a record time that can be.
    begin_ns, end_ns : int
        Between which nearly all stamps lie, ns: single wrong ones do not count. 0 without stamps.
    elsewhere, unrecorded : int
        Stamps more than a day from most others, and record times that cannot be.
    damaged : int
        Messages that have no stamp because their bytes are none of their type.
    """

    rate_hz: float
    longest_gap_s: float
    backward: int
    repeated: int
    zero: int
    delay_s: float
    begin_ns: int = 0
    end_ns: int = 0
    elsewhere: int = 0
    unrecorded: int = 0
    damaged: int = 0


def timing(stamps: Times, recorded: Times, damaged: int = 0) -> Timing:
    """Judge the stamps of a topic, in the order of recording; 0 of those that are `damaged`."""
    possible = (recorded > 0) & (recorded < YEAR_2200_NS)
    delays = (recorded - stamps)[possible & (stamps > 0)]
    zero = int(np.count_nonzero(stamps <= 0)) - damaged
    stamps = stamps[stamps > 0]
    ordered = np.sort(stamps)
    steps: Floats = np.diff(ordered).astype(np.float64) * 1e-9
    begin, end, median = (int(ordered[int(part * (ordered.size - 1))]) if ordered.size else 0 for part in MOST)
    return Timing(
        float(1.0 / np.median(steps)) if steps.size and np.median(steps) > 0.0 else float("nan"),
        float(steps.max()) if steps.size else float("nan"),
        int(np.count_nonzero(np.diff(stamps) < 0)),
        int(np.count_nonzero(np.diff(stamps) == 0)),
        zero,
        float(np.median(delays) * 1e-9) if delays.size else float("nan"),
        begin,
        end,
        int(np.count_nonzero(np.abs(ordered - median) > DAY_NS)),
        int(np.count_nonzero(~possible)),
        damaged,
    )


def inspect_bag(
    path: Path, settings: Settings, request: TopicRequest | None = None, roi_preview: Path | None = None
) -> str:
    """Describe a bag in a table and, for `roi_preview`, draw the region of interest over its first frame.

    Raises
    ------
    BagError
        The bag cannot be read, or a preview is asked for and there is no usable image.
    """
    with Bag(path, tell=False) as bag:
        timings = _timings(bag)
        lines = [table(_HEADER, [_line(topic, timings.get(topic.name)) for topic in bag.topics], 2)]
        lines += ["", *_images(bag, settings.compass), *_roles(bag, settings, request)]
        found = [*problems(bag.topics, timings), *first_minute(bag, settings, request)]
        lines += [f"problem: {' '.join(problem.split())}" for problem in (*bag.faults, *found)]
        if roi_preview is not None:
            topic = choose_topics(bag, settings.topics, request).image
            if topic is None:
                raise BagError(f"{path}: no panoramas in it; --roi-preview needs a topic of images")
            picture = draw_region(as_panorama(*_first_image(bag, topic), settings.compass), settings.compass)
            with staged_file(roi_preview) as staged:
                staged.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
            lines.append(f"region of interest drawn in {roi_preview}")
    return "\n".join(lines)


_HEADER = ("topic", "type", "count", "Hz", "longest gap s", "backward", "repeated", "zero stamps", "delay s")


def _line(topic: Topic, found: Timing | None) -> list[str]:
    if found is None:
        return [topic.name, topic.short_type, str(topic.count), *[""] * 6]
    counts = [str(count) if count else "" for count in (found.backward, found.repeated, found.zero)]
    return [
        *(topic.name, topic.short_type, str(topic.count)),
        *(_number(found.rate_hz, 1), _number(found.longest_gap_s, 3), *counts, _number(found.delay_s, 3)),
    ]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def _timings(bag: Bag) -> dict[str, Timing]:
    """Timing of every topic whose messages are stamped."""
    stamps = {topic.name: (array("q"), array("q")) for topic in bag.topics if bag.has_header(topic.msgtype)}
    damaged: Counter[str] = Counter()
    total = sum(topic.count for topic in bag.topics) or 1
    with progress_bar("reading stamps") as progress:
        for count, message in enumerate(bag.messages(*stamps)):
            stamps[message.topic][0].append(message.stamp_ns)
            stamps[message.topic][1].append(min(max(message.record_ns, -1), LATEST_NS))
            if message.stamp_ns <= 0:
                damaged[message.topic] += not _is_sound(bag, message)
            if count % 500 == 0:
                progress(count / total)
    return {
        name: timing(np.frombuffer(stamp, np.int64), np.frombuffer(record, np.int64), damaged[name])
        for name, (stamp, record) in stamps.items()
        if len(stamp)
    }


def _is_sound(bag: Bag, message: Message) -> bool:
    try:
        bag.deserialize(message)
    except MessageError:
        return False
    return True


def problems(topics: Sequence[Topic], timings: Mapping[str, Timing]) -> list[str]:
    """What is wrong with the stamps of the topics that could be fused, a sentence each."""
    found = []
    usable = [t for t in topics if t.name in timings and t.msgtype in _FUSED and not is_depth(t)]
    used = {topic.name: timings[topic.name] for topic in usable}
    for name, count in ((topic.name, topic.count) for topic in usable):
        one = used[name]
        if one.zero:
            found.append(f"{name}: {one.zero} stamps were never set; they are left out")
        if one.damaged:
            found.append(f"{name}: {one.damaged} messages are damaged: their bytes are none of their type")
        if 10 * one.repeated > count:
            found.append(
                f"{name}: {one.repeated} of {count} stamps repeat the one before; they are no times of capture"
            )
        if one.elsewhere:
            found.append(f"{name}: {one.elsewhere} stamps are more than a day from the others")
        if one.unrecorded:
            found.append(
                f"{name}: {one.unrecorded} record times cannot be (before 1970 or after 2200); they are not used"
            )
    groups = _at_one_time({name: one for name, one in used.items() if one.end_ns})
    if len(groups) > 1:
        spans = "; ".join(f"{', '.join(group)} {_span([used[name] for name in group])}" for group in groups)
        found.append(f"topics have no time in common by their stamps, and cannot be fused: {spans}")
    return found


def _at_one_time(timings: Mapping[str, Timing]) -> list[list[str]]:
    """Topics in groups whose stamps overlap, in the order of time."""
    groups: list[list[str]] = []
    end_ns = 0
    for name, one in sorted(timings.items(), key=lambda item: item[1].begin_ns):
        if groups and one.begin_ns <= end_ns:
            groups[-1].append(name)
        else:
            groups.append([name])
            end_ns = 0
        end_ns = max(end_ns, one.end_ns)
    return groups


def _span(timings: Sequence[Timing]) -> str:
    """From when to when, in words: a date, or seconds where the clock does not know the date."""
    begin_ns, end_ns = min(one.begin_ns for one in timings), max(one.end_ns for one in timings)
    if begin_ns < YEAR_2000_NS:
        return f"from {begin_ns * 1e-9:.1f} to {end_ns * 1e-9:.1f} s (since power-up, not since 1970)"
    begin, end = (datetime.fromtimestamp(t // 10**9, timezone.utc) for t in (begin_ns, end_ns))
    return f"from {begin:%Y-%m-%d %H:%M:%S} to {end:%Y-%m-%d %H:%M:%S}"


def _images(bag: Bag, config: CompassConfig) -> list[str]:
    """Size of the first image of each topic of images, with what a panorama should be."""
    lines = []
    for topic in bag.topics:
        if topic.msgtype in IMAGES and topic.count:
            try:
                image, encoding = _first_image(bag, topic)
            except BagError as error:
                lines.append(str(error))
                continue
            height, width = image.shape[:2]
            remark = "" if usual_shape(image, config) else "; not as wide as a full circle usually is, 2:1 or more"
            lines.append(f"{topic.name}: {width} x {height} {encoding or 'compressed'}{remark}")
    return lines


def usual_shape(image: Image, config: CompassConfig) -> bool:
    """Whether an image is as wide as a full circle usually is, or of another kind by its settings."""
    height, width = image.shape[:2]
    return not Orientation.of(config).is_upright or not config.is_full_panorama or width >= 2 * height - 2


def _first_image(bag: Bag, topic: Topic) -> tuple[Image, str]:
    """Pixels and encoding of the first image that can be used."""
    fault, stream = "", PictureStream(0)
    for message in bag.messages(topic.name):
        try:
            for picture in stream.add(bag.deserialize(message)):
                return picture.image, picture.encoding
        except (ImageError, MessageError) as error:
            fault = fault or str(error)
    raise BagError(f"{bag.path}: {topic.name}: no usable image: {fault}")


def _roles(bag: Bag, settings: Settings, request: TopicRequest | None) -> list[str]:
    """What `fuse` would take."""
    try:
        choice = choose_topics(bag, settings.topics, request)
    except BagError as error:
        return [f"fuse would stop: {error}"]
    roles = (("panoramas", choice.image), ("gyro", choice.gyro), ("tracks", choice.odometry), ("truth", choice.truth))
    return ["fuse would take " + ", ".join(f"{role}: {topic.name if topic else 'none'}" for role, topic in roles)]


def as_panorama(image: Image, encoding: str, config: CompassConfig) -> Image:
    """Upright and grey, and of other projections a panorama of the whole sphere, (H, W) uint8 or uint16."""
    grey = np.ascontiguousarray(Orientation.of(config).upright(to_grey(image, encoding)))
    if config.projection in ("equirectangular", "cylinder"):
        return grey
    columns, size = 1024, (grey.shape[0], grey.shape[1])
    how = unwrapping(projection_of(config, *size), size, (0.0, 1.0), columns, columns // 2)
    pixels = how.strip(grey[how.cut]) * (1.0 if how.shown is None else how.shown)
    panorama = np.zeros((how.columns // 2, how.columns), grey.dtype)
    top = round((0.5 - how.top / np.pi) * len(panorama))
    rows = min(how.rows, len(panorama) - top)
    panorama[top : top + rows] = pixels[:rows].astype(grey.dtype)
    return panorama


def draw_region(image: Image, config: CompassConfig) -> Image:
    """Draw the region of interest (bright) and the forward column (line) over an image, (H, W, 3) uint8."""
    grey = to_grey(image)
    grey = grey if grey.dtype == np.uint8 else (grey >> 8).astype(np.uint8)
    height, width = grey.shape
    top, bottom = round(config.roi_top * height), round(config.roi_bottom * height)
    picture = cv2.cvtColor(grey // 3, cv2.COLOR_GRAY2BGR)
    picture[top:bottom] = grey[top:bottom, :, None]
    thick, size = max(1, height // 300), height / 700
    orange, blue = (0, 94, 213), (178, 114, 0)
    for row in (top, bottom):
        cv2.line(picture, (0, row), (width, row), orange, thick)
    ahead = round(config.forward_column * width) % width
    cv2.line(picture, (ahead, 0), (ahead, height), blue, thick)
    words = (("forward", ahead, blue), ("right", ahead + width // 4, blue), ("left", ahead - width // 4, blue))
    for word, column, colour in words:
        place = (column % width + 4 * thick, height - 8 * thick)
        cv2.putText(picture, word, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, thick, cv2.LINE_AA)
    text = f"roi_top {config.roi_top:g}, roi_bottom {config.roi_bottom:g}"
    cv2.putText(
        picture, text, (4 * thick, max(top - 6 * thick, 20)), cv2.FONT_HERSHEY_SIMPLEX, size, orange, thick, cv2.LINE_AA
    )
    return picture
