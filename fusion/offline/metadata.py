"""metadata.yaml of a rosbag2 folder: which files it lists, and whether what it counts is there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from compass.errors import ConfigError
from compass.files import read_bounded
from fusion.bounded_yaml import YamlError, parse_yaml

_LARGEST = 16_000_000  # bytes; a recording of a week in files of a minute has 3 MB
_TOLERANCE_NS = 1_000_000_000  # by which recorders count the duration differently
_MOST_NAMED = 3  # topics in one sentence


class MetadataError(ValueError):
    """metadata.yaml is missing or says nothing of use."""


@dataclass(frozen=True, slots=True)
class Metadata:
    """What metadata.yaml says; None where it says nothing usable.

    Attributes
    ----------
    files : tuple of str
        Names of the storage files, without folders.
    counts : dict of str to int, or None
        Messages of each topic.
    total : int or None
        Messages in all.
    start_ns, duration_ns : int or None
        Record time of the first message, and from there to the last one, ns.
    types : dict of str to str
        Of each topic, as far as it says.
    """

    files: tuple[str, ...]
    counts: Mapping[str, int] | None
    total: int | None
    start_ns: int | None
    duration_ns: int | None
    types: Mapping[str, str] = field(default_factory=dict)


def read_metadata(path: Path) -> Metadata:
    """Read what is of use here; qualities of service, versions and hashes are none of it.

    Raises
    ------
    MetadataError
        In one line.
    """
    if not path.exists():
        raise MetadataError("metadata.yaml is missing, as a recorder that was killed leaves it")
    try:
        data = read_bounded(path, _LARGEST, "run 'ros2 bag reindex'")
        tree = parse_yaml(data.decode(), _LARGEST, as_text=True)
    except ConfigError as error:
        raise MetadataError(str(error)) from None
    except (YamlError, UnicodeDecodeError) as error:
        raise MetadataError(f"metadata.yaml is not YAML ({error})") from None
    files = _at(tree, "rosbag2_bagfile_information", "relative_file_paths")
    if not isinstance(files, list) or not all(isinstance(name, str) for name in files):
        raise MetadataError("metadata.yaml is none of a bag: it lists no files")
    bag = tree["rosbag2_bagfile_information"]
    return Metadata(
        tuple(PurePosixPath(name).name for name in files),
        _counts(_at(bag, "topics_with_message_count")),
        _number(_at(bag, "message_count")),
        _number(_at(bag, "starting_time", "nanoseconds_since_epoch")),
        _number(_at(bag, "duration", "nanoseconds")),
        _types(_at(bag, "topics_with_message_count")),
    )


def _types(topics: Any) -> dict[str, str]:
    found = ((_at(one, "topic_metadata", "name"), _at(one, "topic_metadata", "type")) for one in _listed(topics))
    return {name: msgtype for name, msgtype in found if isinstance(name, str) and isinstance(msgtype, str)}


def _listed(topics: Any) -> list[Any]:
    return topics if isinstance(topics, list) else []


def _counts(topics: Any) -> dict[str, int] | None:
    if not isinstance(topics, list):
        return None
    counts: dict[str, int] = {}
    for topic in topics:
        name, count = _at(topic, "topic_metadata", "name"), _number(_at(topic, "message_count"))
        if not isinstance(name, str) or count is None:
            return None
        counts[name] = counts.get(name, 0) + count
    return counts


def _at(tree: Any, *keys: str) -> Any:
    """What stands below the keys; None where there is nothing."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _number(text: Any) -> int | None:
    return int(text) if isinstance(text, str) and re.fullmatch(r"-?\d{1,20}", text) else None


def contradictions(
    said: Metadata, counts: Mapping[str, int], types: Mapping[str, str], start_ns: int, duration_ns: int
) -> list[str]:
    """Where metadata.yaml and the files differ, a sentence each; the files are right."""
    faults = []
    total = sum(counts.values())
    if said.total is not None and said.total != total:
        lost = "; messages are lost" if said.total > total else ""
        faults.append(f"metadata.yaml counts {said.total} messages, the files hold {total}{lost}")
    listed = said.counts or {}
    if said.counts is None:
        faults.append("metadata.yaml does not count the messages of the topics")
    else:
        # a topic without messages need not be in the files
        absent, unknown = (
            [name for name, count in one.items() if count and name not in other]
            for one, other in ((listed, counts), (counts, listed))
        )
        differing = [f"{n} ({listed[n]} and {counts[n]})" for n in listed if n in counts and listed[n] != counts[n]]
        retyped = [f"{n} ({said.types[n]} and {types[n]})" for n in types if said.types.get(n, types[n]) != types[n]]
        for names, what in (
            (absent, "topics that the files do not have"),
            (unknown, "not all topics that the files have"),
            (retyped, "other types than the files have"),
            (differing, "other numbers of messages than the files have"),
        ):
            if names:
                more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
                faults.append(f"metadata.yaml lists {what}: {', '.join(names[:_MOST_NAMED])}{more}")
    if total and said.duration_ns is not None and abs(said.duration_ns - duration_ns) > _TOLERANCE_NS:
        faults.append(f"metadata.yaml says {said.duration_ns * 1e-9:.1f} s, the files last {duration_ns * 1e-9:.1f} s")
    if total and said.start_ns is not None and abs(said.start_ns - start_ns) > _TOLERANCE_NS:
        faults.append(f"metadata.yaml begins {(said.start_ns - start_ns) * 1e-9:+.1f} s from where the files begin")
    return faults
