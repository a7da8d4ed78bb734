"""The time that a bag's sensors have in common: whose stamps are of another, and which samples lie outside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

from fusion.buffer.events import Sensor
from fusion.checks.warnings import WarningLog
from fusion.offline.bag import Bag, BagError
from fusion.offline.bag_messages import Topic
from fusion.offline.columns import Columns
from fusion.offline.stamp_check import Span, clock_warning, of_one_time, usable
from fusion.offline.topics import TopicChoice

FIRST_IMAGES = 20  # of which the stamp in the middle is taken for right
MOST_FOREIGN = 3000  # images of another time that are looked through for one of the others' time
SMALL = (Sensor.GYRO, Sensor.TRACKS)  # read at once


def of_common_time(
    bag: Bag, choice: TopicChoice, columns: dict[str, Columns], log: WarningLog
) -> tuple[TopicChoice, Span | None]:
    """The topics whose stamps have time in common, their samples without those of another time; and that time.

    Raises
    ------
    BagError
        No two of the sensors have time in common.
    """
    topics = {Sensor.GYRO: choice.gyro, Sensor.TRACKS: choice.odometry, Sensor.COMPASS: choice.image}
    spans: dict[Sensor, Span] = {}
    for sensor in SMALL:
        topic = topics[sensor]
        if topic is not None and columns[topic.name].t_ns:
            spans[sensor] = Span.of(columns[topic.name].stamps)
    if choice.image is not None:
        images = _image_span(bag, choice.image, list(spans.values()))
        if images is not None:
            spans[Sensor.COMPASS] = images
    together = of_one_time(spans)
    if len(spans) > 1 and len(together) < 2:
        told = "; ".join(f"{sensor.value} {span.words()}" for sensor, span in spans.items())
        raise BagError(f"{bag.path}: no time in common: {told}; stamp all by one clock, or leave one out (none)")
    whole = (
        Span(min(spans[s].first_ns for s in together), max(spans[s].last_ns for s in together)) if together else None
    )
    if whole is None:
        return choice, None
    foreign = spans.keys() - together
    log.note(clock_warning(sensor, spans[sensor], whole) for sensor in foreign)
    small = {sensor: columns[topic.name] for sensor in SMALL if sensor in together and (topic := topics[sensor])}
    recorded = {sensor: column.recorded for sensor, column in small.items()}
    for sensor, column in small.items():
        others = [one for other, one in recorded.items() if other is not sensor]
        present = [spans[other] for other in together if other is not sensor]
        keep, wrong = usable(sensor, recorded[sensor], whole, others, present, column.told)
        column.only(keep)
        log.note(wrong)
    fields = {Sensor.GYRO: "gyro", Sensor.TRACKS: "odometry", Sensor.COMPASS: "image"}
    return replace(choice, **{fields[sensor]: None for sensor in foreign}), whole


def _image_span(bag: Bag, topic: Topic, others: Sequence[Span]) -> Span | None:
    """From the first images on, and on for as long as was recorded after them.

    Where these are of another time than all others, from the first one of the others' time on.
    """
    images = ((m.stamp_ns, m.record_ns) for m in bag.messages(topic.name) if m.stamp_ns > 0)
    first = list(islice(images, FIRST_IMAGES))
    if not first:
        return None

    def until_the_end(stamp_ns: int, record_ns: int) -> Span:
        return Span(stamp_ns, stamp_ns + max(bag.end_ns - record_ns, 0))

    span = until_the_end(*first[len(first) // 2])
    if others and not any(span.meets(other) for other in others):
        more = islice(images, MOST_FOREIGN)
        found = (one for one in more if any(Span(one[0], one[0]).meets(other) for other in others))
        return next((until_the_end(*one) for one in found), span)
    return span
