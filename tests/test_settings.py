"""Settings: defaults < YAML < overrides, and mistakes named."""

from pathlib import Path

import pytest

from compass import ConfigError
from fusion.settings import Settings, dump_settings, load_settings

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
