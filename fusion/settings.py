"""All settings together, from one YAML in ROS parameter-file form, for the nodes and the command line alike."""

from __future__ import annotations

import difflib
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from compass.config import CompassConfig
from compass.errors import ConfigError
from compass.files import read_bounded
from compass.parameters import ParameterSet, ParameterSpec, Value, parameter, shown
from fusion.bounded_yaml import YamlError, parse_yaml
from fusion.config import FusionConfig
from fusion.imu.levelling import ImuConfig

NODE = "visual_compass"
_NODES = ("/**", "*", NODE, "compass_node", "fusion_node")  # later ones override earlier ones
_LARGEST = 1_000_000  # bytes of a parameter file; those of whole robots have 50 kB
_PARAMETERS = "ros__parameters"
_ROS_OWN = ("use_sim_time", "qos_overrides", "start_type_description_service")


NONE = "none"  # in place of a sensor's topic: the robot has no such sensor
_ABSENT = f"{NONE} or empty: the robot has none"


@dataclass(frozen=True)
class TopicSettings(ParameterSet):
    """Names under which the data comes and goes.

    A name without a leading slash is relative: a node puts it into its namespace, a bag has it behind a slash.
    """

    compass_image: str = parameter("viz/pano/image", f"topic of the panoramas; {_ABSENT}")
    image_transport: str = parameter(
        "raw",
        "raw for sensor_msgs/Image, compressed for sensor_msgs/CompressedImage (JPEG, PNG, or H.264 and H.265), ffmpeg "
        "and foxglove for the packets of ffmpeg_image_transport and of foxglove_msgs/CompressedVideo",
        choices=("raw", "compressed", "ffmpeg", "foxglove"),
    )
    gyro_topic: str = parameter("imu/data", f"topic of the gyro, sensor_msgs/Imu; {_ABSENT}")
    odometry_topic: str = parameter("odom", f"topic of the track odometry, nav_msgs/Odometry; {_ABSENT}")
    truth_topic: str = parameter("/ground_truth/odom", "ground truth in a bag, nav_msgs/Odometry; offline only")
    compass_output_topic: str = parameter("compass_pose", "topic of the raw compass, nav_msgs/Odometry")
    fused_output_topic: str = parameter("odometry/fused", "topic of the fused yaw, nav_msgs/Odometry")
    compass_textout: bool = parameter(False, "print the current angle", live=True)
    odom_frame: str = parameter("odom", "frame_id of the outputs")
    base_frame: str = parameter("base_link", "child_frame_id of the outputs")
    position: str = parameter(
        "dead_reckoning",
        "x and y of fused_output_topic: the speed of odometry_topic along the fused yaw, or zeros",
        choices=("dead_reckoning", NONE),
    )
    publish_tf: bool = parameter(False, "broadcast odom_frame -> base_frame as in fused_output_topic; needs tf2_ros")
    invert_tf: bool = parameter(
        False, "broadcast base_frame -> odom_frame instead, for a base_frame that has a parent already"
    )
    fused_rate: float = parameter(
        0.0,
        "most messages a second on fused_output_topic; 0: whenever there is something newer",
        unit="Hz",
        low=0.0,
        high=1000.0,
    )
    reliable: bool = parameter(
        False,
        "take every message and every image in its turn, and tell each image on ~/image_done; for a bag whose player "
        "waits for that, not for a robot, whose images would wait in a queue",
    )
    sensor_timeout: float = parameter(
        2.0, "a sensor silent for longer is stale in /diagnostics", unit="s", low=0.1, high=3600.0, live=True
    )


def absent(topic: str) -> bool:
    """Whether the name given for a sensor's topic says that the robot has no such sensor."""
    return topic.strip().lower() in ("", NONE)


def in_bag(topic: str) -> str:
    """Name of a topic as a bag has it: a relative one is taken for one of the root namespace."""
    return topic if topic.startswith("/") or absent(topic) else f"/{topic}"


@dataclass(frozen=True)
class OfflineSettings(ParameterSet):
    """What `fuse` makes of a recording; nodes do not use it."""

    smooth: bool = parameter(False, "add the fixed-interval (RTS) smoother")
    start: float = parameter(0.0, "fuse from here on, from the first sample of the recording", unit="s", low=0.0)
    end: float = parameter(0.0, "fuse up to here, from the first sample of the recording; 0: all", unit="s", low=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.end <= self.start:
            raise ConfigError(f"end: {self.end:g} s is not after the start, {self.start:g} s")


@dataclass(frozen=True)
class Settings:
    """Everything that can be set, each group in its own dataclass."""

    compass: CompassConfig = field(default_factory=CompassConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    topics: TopicSettings = field(default_factory=TopicSettings)
    offline: OfflineSettings = field(default_factory=OfflineSettings)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Settings:
        """Build from parameters as a node has them: groups nested or dotted, topics at the top.

        Raises
        ------
        ConfigError
            A key is unknown (the nearest known one is named) or a value unusable.
        """
        groups = _split_groups(_undotted(values))
        return cls(
            CompassConfig.from_dict(groups["compass"], "compass."),
            FusionConfig.from_dict(groups["fusion"], "fusion."),
            ImuConfig.from_dict(groups["imu"], "imu."),
            TopicSettings.from_dict(groups[""]),
            OfflineSettings.from_dict(groups["offline"], "offline."),
        )

    def to_dict(self) -> dict[str, Value | dict[str, Value]]:
        """All values, nested as in the YAML."""
        return {
            **self.topics.to_dict(),
            "compass": self.compass.to_dict(),
            "fusion": self.fusion.to_dict(),
            "imu": self.imu.to_dict(),
            "offline": self.offline.to_dict(),
        }


def load_settings(path: Path | str | None = None, overrides: Mapping[str, Any] | None = None) -> Settings:
    """Defaults < YAML < `overrides`.

    Parameters
    ----------
    path : path, optional
        A ROS parameter file, ``/**: {ros__parameters: {compass: {method: sectors}, gyro_topic: /imu}}``.
        A relative ``compass.mask`` in it counts from its folder.
    overrides : mapping, optional
        Parameters by (dotted) name, such as ``{"compass.method": "rows"}``.

    Raises
    ------
    ConfigError
        The file cannot be read, is no parameter file, or holds an unknown key or an unusable value.
    """
    values: dict[str, Any] = {}
    if path is not None:
        values = _undotted(read_parameter_file(Path(path)))
        _anchor_mask(values, Path(path).parent)
    _merge(values, _undotted(overrides or {}))
    return Settings.from_dict(values)


def dump_settings(settings: Settings) -> str:
    """The settings as a commented parameter file that `load_settings` and ``--params-file`` read back."""
    lines = ["/**:", "  ros__parameters:"]
    for title, parameters in (
        ("", settings.topics),
        ("compass", settings.compass),
        ("fusion", settings.fusion),
        ("imu", settings.imu),
        ("offline", settings.offline),
    ):
        indent = "      " if title else "    "
        lines += ["", f"    {title}:"] if title else []
        values = parameters.to_dict()
        for spec in parameters.specs():
            lines += textwrap.wrap(_explain(spec), 110, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")
            lines.append(indent + yaml.safe_dump({spec.name: values[spec.name]}, width=1000).strip())
    return "\n".join(lines) + "\n"


def _explain(spec: ParameterSpec) -> str:
    """Description, unit and range in one sentence."""
    low = "" if spec.low is None else f"{spec.low:g}"
    high = "" if spec.high is None else f"{spec.high:g}"
    limits = f"{low} .. {high}" if low and high else f"from {low}" if low else f"up to {high}" if high else ""
    facts = " ".join(part for part in (limits, spec.unit) if part) or ", ".join(
        [*spec.choices, *filter(None, [spec.others])]
    )
    return f"{spec.description}{f' [{facts}]' if facts else ''}"


def read_parameter_file(path: Path) -> dict[str, Any]:
    """The parameters of a ROS parameter file that concern us, nested."""
    data = read_bounded(path, _LARGEST, "give a readable YAML file")
    try:
        content = parse_yaml(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not YAML: byte {error.start} is not UTF-8; save it as UTF-8") from None
    except YamlError as error:
        raise ConfigError(f"{path}: not YAML: {error}") from None
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path}: no ROS parameter file; begin with '/**:' and 'ros__parameters:' below it")
    sections = _sections(content, path)
    chosen = [sections[node] for node in _NODES if node in sections]
    if not chosen:
        names = ", ".join([repr(name) for name in sections][:5]) + ", ..." * (len(sections) > 5)
        raise ConfigError(f"{path}: parameters of {names} only; put ours under '/**:'")
    values: dict[str, Any] = {}
    for body in chosen:
        if not isinstance(body, Mapping) or not isinstance(body.get(_PARAMETERS), Mapping):
            raise ConfigError(f"{path}: '{_PARAMETERS}:' is missing below the node's name")
        _merge(values, _undotted(body[_PARAMETERS]))
    return values


def _sections(content: Mapping[Any, Any], path: Path) -> dict[str, Any]:
    """What stands below each node's name, without its namespace.

    Raises
    ------
    ConfigError
        A node stands there in several namespaces, or parameters stand beside the nodes.
    """
    names: dict[str, str] = {}
    sections: dict[str, Any] = {}
    for name, body in _nodes(content):
        node = name if name == "/**" else name.rsplit("/", 1)[-1]
        ours = [*Settings.__dataclass_fields__, *(spec.name for spec in TopicSettings.specs())]
        if node in ours and not (isinstance(body, Mapping) and _PARAMETERS in body):
            raise ConfigError(f"{path}: {node!r} stands beside the nodes; put it below '/**:' and '{_PARAMETERS}:'")
        if node in names and node in _NODES:
            raise ConfigError(f"{path}: parameters of both {names[node]} and {name}; leave those of one robot in it")
        names[node], sections[node] = name, body
    return sections


def _nodes(content: Mapping[Any, Any], namespace: str = "") -> Iterator[tuple[str, Any]]:
    """Nodes by their whole names; a namespace may stand above them as a key of its own."""
    for key, body in content.items():
        name = f"{namespace}/{key}" if namespace else str(key)
        if isinstance(body, Mapping) and _PARAMETERS not in body and _holds_nodes(body):
            yield from _nodes(body, name)
        else:
            yield name, body


def _holds_nodes(body: Any) -> bool:
    """Whether there are nodes below a key."""
    return isinstance(body, Mapping) and (_PARAMETERS in body or any(map(_holds_nodes, body.values())))


def _anchor_mask(values: dict[str, Any], folder: Path) -> None:
    """Let a relative path of the mask count from the folder of its file, wherever the command runs."""
    compass = values.get("compass")
    if isinstance(compass, dict) and isinstance(compass.get("mask"), str) and compass["mask"]:
        try:
            compass["mask"] = str((folder / compass["mask"]).resolve())
        except (OSError, ValueError, RuntimeError) as error:  # a NUL, links in a circle
            raise ConfigError(f"compass.mask: {shown(compass['mask'])}: {error}; give the path of a PNG") from None


def _split_groups(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Sort nested parameters into the groups of `Settings`."""
    groups: dict[str, dict[str, Any]] = {"": {}, "compass": {}, "fusion": {}, "imu": {}, "offline": {}}
    for key, value in values.items():
        if key in _ROS_OWN:
            continue
        if key and key in groups:
            if not isinstance(value, Mapping):
                raise ConfigError(f"{key}: {shown(value)} is not a group of parameters such as {{name: value}}")
            groups[key] = dict(value)
        elif isinstance(value, Mapping):
            near = difflib.get_close_matches(key[:60], [name for name in groups if name], n=1)
            hint = f"did you mean {near[0]!r}?" if near else "known: compass, fusion, imu, offline"
            raise ConfigError(f"unknown parameter group {shown(key)}; {hint}")
        else:
            _refuse_stray(key)
            groups[""][key] = value
    return groups


def _refuse_stray(key: str) -> None:
    """Name the group of a parameter that was given without it."""
    kinds: dict[str, type[ParameterSet]] = {
        "compass": CompassConfig,
        "fusion": FusionConfig,
        "imu": ImuConfig,
        "offline": OfflineSettings,
    }
    top = [spec.name for spec in TopicSettings.specs()]
    for group, kind in kinds.items():
        if key not in top and key in [spec.name for spec in kind.specs()]:
            raise ConfigError(f"unknown parameter {key!r}; did you mean '{group}.{key}'?")


def _undotted(values: Mapping[str, Any]) -> dict[str, Any]:
    """``{"compass.method": x}`` to ``{"compass": {"method": x}}``."""
    nested: dict[str, Any] = {}
    for key, value in values.items():
        group, dot, name = str(key).partition(".")
        part = {group: {name: value}} if dot else {group: dict(value) if isinstance(value, Mapping) else value}
        _merge(nested, part)
    return nested


def _merge(values: dict[str, Any], other: Mapping[str, Any]) -> None:
    """Write `other` over `values`, group by group."""
    for key, value in other.items():
        if isinstance(value, Mapping) and isinstance(values.get(key), dict):
            values[key].update(value)
        else:
            values[key] = dict(value) if isinstance(value, Mapping) else value
