"""JSON Schemas (2020-12) of what is written and read: a parameter file, and summary.json."""

from __future__ import annotations

from typing import Any

from compass import CompassStatus
from compass.config import CompassConfig
from compass.parameters import ParameterSet, ParameterSpec
from fusion.buffer.events import Sensor
from fusion.config import FusionConfig
from fusion.imu.levelling import ImuConfig
from fusion.offline.scores import COMPASS, FUSED, GYRO, SMOOTHED, TRACKS
from fusion.offline.summary import VERSION, key_of
from fusion.settings import OfflineSettings, TopicSettings

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string"}
_GROUPS: dict[str, type[ParameterSet]] = {
    "compass": CompassConfig,
    "fusion": FusionConfig,
    "imu": ImuConfig,
    "offline": OfflineSettings,
}

Schema = dict[str, Any]


def settings_schema() -> Schema:
    """Of a ROS parameter file as ``--config`` reads it; parameters of nodes that are none of ours may be in it."""
    groups = {name: _group(kind) for name, kind in _GROUPS.items()}
    ours = _group(TopicSettings)
    ours["properties"] |= groups | {
        f"{group}.{name}": schema for group, found in groups.items() for name, schema in found["properties"].items()
    }
    ours["properties"] |= {"use_sim_time": {"type": "boolean"}, "start_type_description_service": {"type": "boolean"}}
    ours["properties"]["qos_overrides"] = {"type": "object"}
    node = _object({"ros__parameters": ours})
    nodes = ("/**", "visual_compass", "compass_node", "fusion_node")
    return {
        "$schema": DIALECT,
        "title": "Parameters of visual-compass",
        "type": "object",
        "properties": dict.fromkeys(nodes, node),
        "patternProperties": {f"/({'|'.join(nodes[1:])})$": node},
    }


def _group(kind: type[ParameterSet]) -> Schema:
    properties = {spec.name: _parameter(spec) for spec in kind.specs()}
    former = {spec.formerly: _parameter(spec) | {"deprecated": True} for spec in kind.specs() if spec.formerly}
    return {"type": "object", "properties": properties | former, "additionalProperties": False}


def _parameter(spec: ParameterSpec) -> Schema:
    unit = f" [{spec.unit}]" if spec.unit else ""
    schema: Schema = {"type": _TYPES[type(spec.default)], "description": spec.description + unit}
    schema["default"] = spec.default
    if spec.low is not None:
        schema["minimum"] = spec.low
    if spec.high is not None:
        schema["maximum"] = spec.high
    if spec.choices and spec.others:
        schema["examples"] = list(spec.choices)
    elif spec.choices:
        schema["enum"] = list(spec.choices)
    return schema


def summary_schema() -> Schema:
    """Of summary.json; a key that is added later leaves `version` as it is."""
    yaw = _object(
        {
            "turned_deg": _number("from the start to the last yaw, turns counted; left is positive"),
            "sigma_deg": _number("standard deviation of the last yaw"),
            "final_error_deg": _number("error at the end against the truth, both zero where they begin to overlap"),
            "rms_error_deg": _number("root mean square of that error"),
            "worst_error_deg": _number("largest magnitude of that error"),
        },
        optional=("sigma_deg", "final_error_deg", "rms_error_deg", "worst_error_deg"),
    )
    sources = [key_of(name) for name in (COMPASS, GYRO, TRACKS, FUSED, SMOOTHED)]
    gate = _object({name: _count(f"samples {name} at the gate") for name in ("accepted", "rejected", "recovered")})
    topics = {role: _text(f"topic of the {role}", or_null=True) for role in ("image", "gyro", "odometry", "truth")}
    properties = {
        "version": {"const": VERSION, "description": "grows when a key changes its meaning or goes"},
        "package_version": _text("version of visual-compass that made it"),
        "source": _object(
            {
                "path": _text("where the recording was found: an absolute path, or a URL"),
                "size_bytes": _count("size of all its files, bytes"),
                "content": _text("SHA-256 of samples of its files"),
            }
        ),
        "settings_hash": _text("SHA-256 of version, settings, topics asked for, and mask"),
        "warnings": {"type": "array", "items": _warning(), "description": "what is wrong, most serious first"},
        "topics": _object(topics),
        "start_ns": {"type": ["integer", "null"], "description": "first stamp, ns"},
        "duration_s": {"type": "number", "minimum": 0, "description": "to the last stamp, s"},
        "gyro_vertical": _text("where the gyro's vertical came from"),
        "vertical_words": _text("the same in words; null without a gyro", or_null=True),
        "greatest_tilt_deg": _number("largest angle of the robot from its rest, where it is known"),
        "truth_turned_deg": _number("from the first to the last true yaw; null without truth"),
        "yaw": _object(dict.fromkeys(sources, yaw), optional=sources) | {"description": "by source, those that are"},
        "gyro_bias_rad_s": _number("gyro bias at the end"),
        "gyro_bias_sigma_rad_s": _number("its standard deviation"),
        "track_scale": _number("claimed turn rate of the tracks over the true one, at the end"),
        "track_scale_sigma": _number("its standard deviation"),
        "camera_delay_s": _number("stamp minus exposure, at the end"),
        "camera_delay_sigma_s": _number("its standard deviation"),
        "camera_roll_deg": _number("of the camera on the robot, right side down is positive, as learnt by the end"),
        "camera_pitch_deg": _number("of the camera on the robot, front down is positive, as learnt by the end"),
        "camera_tilt_sigma_deg": _number(
            "standard deviation of either; about 6 while no turn has shown them, which takes an IMU"
        ),
        "images": _object({one.name.lower(): _count(one.value) for one in CompassStatus})
        | {"description": "outcomes of all images"},
        "samples": _counts("outcome", "what became of the samples of each sensor"),
        "gates": _object({sensor.value: gate for sensor in Sensor}),
        "unusable_messages": _counts("reason", "messages that could not be used"),
    }
    return {
        "$schema": DIALECT,
        "title": "summary.json of visual-compass fuse",
        **_object(properties),
        "additionalProperties": True,
    }


def _warning() -> Schema:
    return _object(
        {
            "code": _text("stable and short, see docs/warnings.md"),
            "sensor": _text("whose it is"),
            "since_ns": {"type": "integer", "description": "stamp, ns, as it was given"},
            "since_s": {"type": "number", "description": "from the start of the run, s"},
            "until_s": _number("from the start of the run, s; null where it held to the end"),
            "text": _text("what was seen, by how much, and what to do"),
        }
    )


def _object(properties: Schema, optional: Any = ()) -> Schema:
    required = [name for name in properties if name not in optional]
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def _number(description: str) -> Schema:
    return {"type": ["number", "null"], "description": description}


def _count(description: str) -> Schema:
    return {"type": "integer", "minimum": 0, "description": description}


def _text(description: str, *, or_null: bool = False) -> Schema:
    return {"type": ["string", "null"] if or_null else "string", "description": description}


def _counts(what: str, description: str) -> Schema:
    item = _object({what: _text("in words, which may change"), "count": _count("how many")})
    return {"type": "array", "items": item, "description": description}
