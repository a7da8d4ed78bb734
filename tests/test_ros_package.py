"""The package as colcon, rosdep and ros2 launch see it; none of them is needed here."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import xml.etree.ElementTree as ET  # our own files
from pathlib import Path

import pytest
import yaml

from fusion.settings import TopicSettings, in_bag, load_settings

ROOT = Path(__file__).resolve().parents[1]
LAUNCH = sorted((ROOT / "nodes" / "launch").glob("*.launch.py"))
EXECUTABLES = sorted((ROOT / "nodes" / "executables").iterdir())

# import name -> rosdep key, where they differ
KEYS = {
    "cv2": "python3-opencv",
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
    "platformdirs": "python3-platformdirs",
    "click": "python3-click",
    "rich": "python3-rich",
    "matplotlib": "python3-matplotlib",
    "filterpy": "python3-filterpy-pip",
    "rosbags": "python3-rosbags-pip",
    "mcap": "mcap-ros2-support",
    "tf2_ros": "tf2_ros_py",
}

# imported when needed, and one line says so where they are not there
EXTRAS = ("allantools", "av", "bokeh", "distributed", "fsspec", "pandas", "pyarrow", "rerun", "telemetry_parser")


def imported(path):
    """Top-level names that a module imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


def manifest():
    return ET.parse(ROOT / "package.xml").getroot()


def test_manifest_names_every_import_of_the_package():
    ours = {"compass", "fusion", "nodes", "visual_compass", "__future__", *EXTRAS}
    needed = set()
    for room in ("compass", "fusion", "nodes"):
        for path in (ROOT / room).rglob("*.py"):
            needed |= imported(path) - ours - set(sys.stdlib_module_names)
    declared = {element.text for element in manifest().iter("exec_depend")}
    missing = {KEYS.get(name, name) for name in needed} - declared
    assert not missing, f"package.xml lacks exec_depend for {sorted(missing)}"


def test_manifest_s_keys_of_the_nodes_are_all_that_the_nodes_import():
    """Without those of bags (see `test_imports_of_a_node_are_what_it_uses`); one is from pip."""
    always = {element.text for element in manifest().iter("exec_depend") if element.get("condition") is None}
    assert {key for key in always if key.endswith("-pip")} == {KEYS["filterpy"]}
    assert not always & {KEYS[name] for name in ("rosbags", "mcap", "click", "rich", "matplotlib", "platformdirs")}


def test_colcon_finds_that_pytest_runs_the_tests():
    """It takes unittest, finds nothing and reports success, unless an extra called `test` asks for pytest."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert re.search(r'^test = \["pytest', project, re.MULTILINE)


def test_manifest_and_citation_agree_with_the_distribution():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.+)"$', project, re.MULTILINE).group(1)
    assert manifest().findtext("version") == version
    assert re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE).group(1) == version
    assert manifest().findtext("name") == "visual_compass"
    assert (ROOT / "resource" / "visual_compass").exists()
    for name in re.findall(r'^    "([a-zA-Z_-]+)>=', project.split("[project.optional")[0], re.MULTILINE):
        module = {"opencv-python-headless": "cv2", "PyYAML": "yaml"}.get(name, name)
        assert any(KEYS[module] == element.text for element in manifest().iter("exec_depend"))


@pytest.mark.parametrize("path", EXECUTABLES, ids=lambda path: path.name)
def test_executable_starts_the_node_of_its_name(path):
    assert os.access(path, os.X_OK)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("#!/usr/bin/env python3\n")
    # Ctrl-C while the libraries load, which takes a second, must not print a traceback
    assert (
        0
        < text.index("signal.signal(signal.SIGINT, signal.SIG_DFL)")
        < text.index(f"from nodes.{path.name} import main")
    )
    module = ast.parse((ROOT / "nodes" / f"{path.name}.py").read_text(encoding="utf-8"))
    assert any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in module.body)


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_launch_file_starts_executables_that_exist(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    keywords = [k for node in ast.walk(tree) if isinstance(node, ast.Call) for k in node.keywords]
    named = {k.value.value for k in keywords if k.arg == "executable" and isinstance(k.value, ast.Constant)}
    assert named <= {executable.name for executable in EXECUTABLES}
    assert any(isinstance(n, ast.FunctionDef) and n.name == "generate_launch_description" for n in tree.body)


def test_launch_arguments_are_parameters_of_the_nodes():
    tree = ast.parse((ROOT / "nodes" / "launch" / "visual_compass.launch.py").read_text(encoding="utf-8"))
    table = next(n.value for n in tree.body if isinstance(n, ast.Assign) and n.targets[0].id == "PARAMETERS")
    arguments = set(ast.literal_eval(table))
    known = {spec.name for spec in TopicSettings.specs()}
    assert arguments - known == {"use_sim_time"}
    assert {"compass_image", "compass_output_topic", "compass_textout"} <= arguments  # the paper's


def test_shipped_parameter_file_is_readable_by_nodes_and_command_line():
    load_settings(ROOT / "config" / "visual_compass.yaml")


def test_robot_localization_example_fuses_the_rate_of_the_compass_alone():
    content = yaml.safe_load((ROOT / "config" / "robot_localization.yaml").read_text(encoding="utf-8"))
    parameters = content["ekf_filter_node"]["ros__parameters"]
    assert parameters["odom0"] == TopicSettings().compass_output_topic
    masks = {name: value for name, value in parameters.items() if name.endswith("_config")}
    assert all(len(mask) == 15 for mask in masks.values())
    yaw_rate = 11  # x y z, roll pitch yaw, vx vy vz, vroll vpitch vyaw, ax ay az
    assert [index for index, used in enumerate(masks["odom0_config"]) if used] == [yaw_rate]
    assert parameters["odom0_differential"] is False
    # a gyro would be fused with its bias, for which robot_localization has no state
    assert not any(masks[name][yaw_rate] for name in masks if name != "odom0_config")
    noise = parameters["process_noise_covariance"]
    assert len(noise) == 15
    assert noise[5] < 1e-4  # (rad)^2/s; the default would drown the compass


def test_dds_profile_has_a_segment_for_several_large_frames():
    space = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
    profiles = ET.parse(ROOT / "config" / "fastdds.xml").getroot()
    segment = int(profiles.find(f".//{space}segment_size").text)
    assert segment >= 2 * 4096 * 2048 * 3
    used = {element.text for element in profiles.findall(f".//{space}userTransports/{space}transport_id")}
    assert used == {element.text for element in profiles.findall(f".//{space}transport_descriptor/{space}transport_id")}
    assert profiles.find(f".//{space}participant").get("is_default_profile") == "true"


@pytest.mark.parametrize("name", ["foxglove.json", "plotjuggler.xml"])
def test_plot_layout_shows_topics_that_the_node_has(name):
    text = (ROOT / "config" / name).read_text(encoding="utf-8")
    if name.endswith(".json"):
        panels = json.loads(text)["configById"]
        shown = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    else:
        shown = [curve.get("name") for curve in ET.fromstring(text).iter("curve")]
        assert "covariance[" not in text  # PlotJuggler names its elements covariance/[row;column]
    named = TopicSettings().to_dict().items()
    topics = {
        in_bag(value) for name, value in named if name.endswith("_topic") and name != "truth_topic"
    }  # offline only
    assert {topic for topic in topics for value in shown if value.startswith(topic)} == topics
    assert all(any(value.startswith(topic) for topic in topics) for value in shown)


def test_rviz_layout_shows_outputs_that_match():
    """Relative names, so that rviz2 in a robot's namespace shows that robot; a reliable output serves both kinds."""
    layout = yaml.safe_load((ROOT / "config" / "visual_compass.rviz").read_text(encoding="utf-8"))
    manager = layout["Visualization Manager"]
    topics = {display["Topic"]["Value"]: display["Topic"] for display in manager["Displays"] if "Topic" in display}
    settings = TopicSettings()
    assert set(topics) == {settings.fused_output_topic, settings.compass_output_topic, settings.compass_image}
    assert {topic["Durability Policy"] for topic in topics.values()} == {"Volatile"}
    assert manager["Global Options"]["Fixed Frame"] == settings.odom_frame


def test_licence_is_the_same_everywhere():
    licence = manifest().findtext("license")
    assert f'license="{licence}"' in (ROOT / "setup.py").read_text(encoding="utf-8")
    assert f"license: {licence}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_every_package_of_the_distribution_is_typed():
    """mypy takes a package's annotations only where it finds the marker, which has to be among the package's data."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    packages = re.search(r"^packages = \[(.+?)\]$", project, re.MULTILINE | re.DOTALL).group(1)
    listed = re.findall(r'"([a-z.]+)"', packages)
    assert {name.split(".")[0] for name in listed} == {"compass", "fusion", "nodes"}
    for name in {name.split(".")[0] for name in listed}:
        assert f'{name} = ["py.typed"]' in project
        assert (ROOT / name / "py.typed").exists()


def test_version_is_said_by_the_package():
    import compass

    assert re.fullmatch(r"\d+(\.\d+)*(\+unknown)?", compass.__version__)
