"""Settings: defaults < YAML < overrides, and mistakes named."""

import re
from pathlib import Path

import pytest

from compass import ConfigError
from fusion.settings import Settings, absent, dump_settings, load_settings

SHIPPED = Path(__file__).parent.parent / "config" / "visual_compass.yaml"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    return path


def test_settings_without_file_are_the_defaults():
    assert load_settings() == Settings()


def test_settings_yaml_beats_defaults_and_overrides_beat_yaml(tmp_path):
    path = write(tmp_path, "/**:\n  ros__parameters:\n    gyro_topic: /a\n    compass: {rows: 32, columns: 512}\n")
    settings = load_settings(path, {"compass.columns": 256})
    assert (settings.topics.gyro_topic, settings.compass.rows, settings.compass.columns) == ("/a", 32, 256)


def test_settings_numbers_are_those_of_ros(tmp_path):
    """Without a point an exponent is text in YAML 1.1, and a number for ROS."""
    for text in ("1e-3", "1E-3", "+1.e-3", ".1e-2", "0.001"):
        path = write(tmp_path, f"/**:\n  ros__parameters:\n    fusion: {{gyro_sigma: {text}}}\n")
        assert load_settings(path).fusion.gyro_sigma == 0.001
    quoted = write(tmp_path, "/**:\n  ros__parameters:\n    gyro_topic: '1e-3'\n")
    assert load_settings(quoted).topics.gyro_topic == "1e-3"


def test_settings_dotted_and_nested_keys_mean_the_same(tmp_path):
    nested = write(tmp_path, "/**:\n  ros__parameters:\n    compass: {rows: 32}\n")
    first = load_settings(nested)
    dotted = write(tmp_path, "/**:\n  ros__parameters:\n    compass.rows: 32\n")
    assert load_settings(dotted) == first != Settings()


def test_settings_node_section_overrides_wildcard(tmp_path):
    path = write(
        tmp_path,
        "/robot/fusion_node: {ros__parameters: {gyro_topic: /node}}\n"
        "/**: {ros__parameters: {gyro_topic: /all, odometry_topic: /all, use_sim_time: true}}\n"
        "ekf_filter_node: {ros__parameters: {frequency: 30.0}}\n",
    )
    topics = load_settings(path).topics
    assert (topics.gyro_topic, topics.odometry_topic) == ("/node", "/all")


def test_settings_round_trip_through_yaml(tmp_path):
    settings = load_settings(None, {"compass.method": "rows", "imu.up": "-z", "publish_tf": True})
    assert load_settings(write(tmp_path, dump_settings(settings))) == settings


def test_settings_shipped_file_is_what_the_code_does():
    """Defaults live in the dataclasses; the file that teaches them is made from there by `make config`."""
    text = SHIPPED.read_text()
    assert text.endswith(dump_settings(Settings())), "run `make config`"
    assert load_settings(SHIPPED) == Settings()


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("/**: {ros__parameters: {gyro_topc: /a}}", "did you mean 'gyro_topic'"),
        ("/**: {ros__parameters: {compass: {metod: rows}}}", "'method'"),
        ("/**: {ros__parameters: {compas: {method: rows}}}", "did you mean 'compass'"),
        ("/**: {ros__parameters: {method: rows}}", "did you mean 'compass.method'"),
        ("/**: {ros__parameters: {compass: 3}}", "not a group"),
        ("/**: {ros__parameters: {compass: {roi_top: 7.0}}}", "compass.roi_top: 7.0 is outside 0 .. 1"),
        ("/**: {compass: {method: rows}}", "'ros__parameters:' is missing"),
        ("other: {ros__parameters: {}}", "'/**:'"),
        ("[1, 2]", "no ROS parameter file"),
        ("{a: [", "not YAML"),
    ],
)
def test_settings_mistake_is_named_with_its_cure(tmp_path, text, hint):
    with pytest.raises(ConfigError) as caught:
        load_settings(write(tmp_path, text))
    assert hint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.yaml.*No such file"):
        load_settings(tmp_path / "absent.yaml")


def test_settings_relative_mask_counts_from_the_folder_of_the_yaml(tmp_path, monkeypatch):
    (tmp_path / "robot").mkdir()
    write(tmp_path / "robot", "/**: {ros__parameters: {compass: {mask: mask.png}}}")
    monkeypatch.chdir(tmp_path)
    settings = load_settings("robot/settings.yaml")
    assert settings.compass.mask == str(tmp_path / "robot" / "mask.png")
    # written to another folder, as with the results of a run, it still means the same file
    assert load_settings(write(tmp_path, dump_settings(settings))) == settings
    assert load_settings("robot/settings.yaml", {"compass.mask": ""}).compass.mask == ""


def test_settings_absolute_mask_stays(tmp_path):
    path = write(tmp_path, "/**: {ros__parameters: {compass.mask: /robot/mask.png}}")
    assert load_settings(path).compass.mask == "/robot/mask.png"


def test_former_name_of_a_parameter_is_read_and_told_once(tmp_path, caplog):
    file = write(tmp_path, "/**:\n  ros__parameters:\n    compass: {look_back: 2.0, lean_sigma: 0.03}\n")
    with caplog.at_level("WARNING"):
        compass = load_settings(file).compass
    assert (compass.long_baseline_interval, compass.tilt_sigma) == (2.0, 0.03)
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 2
    assert told[0].startswith("compass.look_back is now called compass.long_baseline_interval")
    assert "look_back" not in compass.to_dict()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("/**: {ros__parameters: {gyro_topic: /a, gyro_topic: /b}}", "'gyro_topic' stands twice, in lines 1 and 1"),
        (
            "/**:\n  ros__parameters:\n    compass: {method: rows}\n    imu: {}\n    fusion: {}\n    compass: {}",
            "'compass' stands twice, in lines 3 and 6",
        ),
        ("/**: {ros__parameters: {}}\n/**: {ros__parameters: {compass.method: rows}}", "'/**' stands twice"),
        ("/**: {ros__parameters: {}}\ncompass: {method: rows}", "'compass' stands beside the nodes"),
        ("/**: {ros__parameters: {}}\ngyro_topic: /a", "'gyro_topic' stands beside the nodes"),
        (
            "/r1/fusion_node: {ros__parameters: {}}\n/r2/fusion_node: {ros__parameters: {}}",
            "parameters of both /r1/fusion_node and /r2/fusion_node",
        ),
        (
            "r1: {fusion_node: {ros__parameters: {}}}\nr2: {fusion_node: {ros__parameters: {}}}",
            "parameters of both r1/",
        ),
    ],
)
def test_settings_that_would_be_lost_without_a_word_are_refused(tmp_path, text, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        load_settings(write(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "/*: {ros__parameters: {compass: {rows: 40}}}",
        "/robot/*: {ros__parameters: {compass.rows: 40}}",
        "/**/fusion_node: {ros__parameters: {compass.rows: 40}}",
        "robot: {fusion_node: {ros__parameters: {compass.rows: 40}}, imu: {ros__parameters: {rate: 5}}}",
        "/robot: {arm: {fusion_node: {ros__parameters: {compass.rows: 40}}}}\ncompass: {ros__parameters: {x: 1}}",
        "/a/cam: {ros__parameters: {}}\n/b/cam: {ros__parameters: {}}\n/**: {ros__parameters: {compass.rows: 40}}",
    ],
)
def test_settings_below_wildcards_and_namespaces_are_read(tmp_path, text):
    assert load_settings(write(tmp_path, text)).compass.rows == 40


@pytest.mark.parametrize("name", ["none", "None", "NONE", " none ", ""])
def test_sensor_is_absent_however_none_is_written(tmp_path, name):
    """Else the only topic of that type would be taken for it."""
    assert absent(
        load_settings(write(tmp_path, f"/**: {{ros__parameters: {{gyro_topic: {name!r}}}}}")).topics.gyro_topic
    )
