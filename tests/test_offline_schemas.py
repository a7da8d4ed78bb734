"""The JSON Schemas say what files are: those that are written fit, those that are refused do not."""

import json
import re
from pathlib import Path

import pytest
import yaml

from compass import ConfigError
from fusion.offline.cli import main
from fusion.offline.results import COLUMNS
from fusion.settings import Settings, dump_settings, load_settings

pytestmark = pytest.mark.usefixtures("without_plot")

ROOT = Path(__file__).resolve().parents[1]


def schema_of(what, capsys):
    assert main(["schema", what]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def results(tiny_bag, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    for name, more in (("all", ["--smooth"]), ("gyro", ["--image-topic", "none", "--odometry-topic", "none"])):
        assert main(["fuse", "-q", str(tiny_bag), "--out", str(folder / name), "--truth-topic", "none", *more]) == 0
    assert main(["fuse", "-q", str(tiny_bag), "--out", str(folder / "truth")]) == 0
    return folder


def test_summaries_fit_their_schema(results, capsys):
    jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema")
    validator = jsonschema.Draft202012Validator(schema_of("summary", capsys))
    validator.check_schema(validator.schema)
    for name in ("all", "gyro", "truth"):
        summary = json.loads((results / name / "summary.json").read_text())
        assert [error.message for error in validator.iter_errors(summary)] == []
        assert list(validator.iter_errors(summary | {"version": 0}))
        del summary["yaw"]["fused"]["turned_deg"]
        assert list(validator.iter_errors(summary))


def keys(value):
    """All keys of a summary; those of lists' items too."""
    if isinstance(value, dict):
        for key, below in value.items():
            yield key
            yield from keys(below)
    elif isinstance(value, list):
        for below in value:
            yield from keys(below)


def test_summary_has_keys_in_snake_case_and_says_what_its_schema_says(results, capsys):
    """Without a validator: what is at the top, and how keys are spelt."""
    schema = schema_of("summary", capsys)
    for name in ("all", "gyro", "truth"):
        summary = json.loads((results / name / "summary.json").read_text())
        assert set(summary) == set(schema["required"])
        assert all(re.fullmatch(r"[a-z][a-z0-9_]*", key) for key in keys(summary))
        assert summary["version"] == schema["properties"]["version"]["const"]


@pytest.mark.parametrize(
    "text",
    [
        "/**: {ros__parameters: {compass: {metod: rows}}}",
        "/**: {ros__parameters: {compass: {roi_top: 7.0}}}",
        "/**: {ros__parameters: {compass.roi_top: 7.0}}",
        "/**: {ros__parameters: {compass: 3}}",
        "/**: {ros__parameters: {gyro_topc: /a}}",
        "/**: {ros__parameters: {offline: {smooth: 1}}}",
        "/**: {ros__parameters: {image_transport: jpeg}}",
        "/**: {compass: {method: rows}}",
    ],
)
def test_settings_that_are_refused_do_not_fit_their_schema(text, tmp_path, capsys):
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(ConfigError):
        load_settings(tmp_path / "c.yaml")
    jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema")
    validator = jsonschema.Draft202012Validator(schema_of("settings", capsys))
    assert list(validator.iter_errors(yaml.safe_load(text)))


def test_settings_that_are_written_fit_their_schema(capsys):
    schema = schema_of("settings", capsys)
    parameters = schema["properties"]["/**"]["properties"]["ros__parameters"]["properties"]
    written = yaml.safe_load(dump_settings(Settings()))
    for name, value in written["/**"]["ros__parameters"].items():
        if isinstance(value, dict):
            assert {key: one["default"] for key, one in parameters[name]["properties"].items() if key in value} == value
        else:
            assert parameters[name]["default"] == value
    jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema")
    validator = jsonschema.Draft202012Validator(schema)
    validator.check_schema(schema)
    good = "/robot/fusion_node: {ros__parameters: {compass.rows: 32}}\nother: {ros__parameters: {a: 1}}"
    for content in (written, yaml.safe_load(good)):
        assert [error.message for error in validator.iter_errors(content)] == []


def test_every_column_of_the_csv_is_documented(results):
    page = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
    told = re.findall(r"`([a-z_]+)`", page.split("## yaw.csv")[1].split("\n## ")[0])
    smoothed = (results / "all" / "yaw.csv").read_text().split("\n")[0].split(",")
    true = (results / "truth" / "yaw.csv").read_text().split("\n")[0].split(",")
    assert set(COLUMNS) <= set(true)
    for name in {*true, *smoothed}:
        assert name in told, name
