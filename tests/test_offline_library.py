"""Fusion from a program: the same numbers as the command, and arguments of a wrong kind refused in words."""

import csv
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from tiny_bags import START_NS, TinyDrive

from compass import CompassConfig, ConfigError, VisualCompass, VisualCompassError, YawIncrement
from compass.errors import ArgumentError
from fusion import FusionConfig, GyroSample, OdometrySample, YawFusion
from fusion.offline import Run, fuse
from fusion.offline.cli import main
from fusion.offline.fuse_bag import fuse_bag
from fusion.settings import Settings

TURNED = float(TinyDrive().yaw(TinyDrive().seconds))


@pytest.fixture(scope="module")
def run(tiny_bag) -> Run:
    return fuse(str(tiny_bag))


def test_library_gives_what_the_command_writes(run, tiny_bag, tmp_path):
    assert main(["fuse", str(tiny_bag), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "yaw.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = run.columns
    assert set(columns) == {"t_ns", *rows[0]}
    assert columns["t_ns"][0] == START_NS
    for name in ("fused_yaw", "fused_sigma", "truth_yaw", "compass_yaw"):
        assert columns[name] == pytest.approx([float(row[name] or "nan") for row in rows], abs=0.0, nan_ok=True)
    assert columns["compass_status"].tolist() == [row["compass_status"] for row in rows]
    assert run.summary["yaw"]["fused"]["turned_deg"] == pytest.approx(math.degrees(TURNED), abs=0.7)
    assert run.folder is None


def test_library_gives_the_yaw_as_a_table(run):
    pytest.importorskip("pandas", reason="the table needs pandas")
    assert run.yaw.index.name == "t_ns"
    assert run.yaw.index[0] == START_NS
    assert run.yaw.fused_yaw.iloc[-1] == pytest.approx(run.columns["fused_yaw"][-1], abs=0.0)


def test_library_without_pandas_says_so_and_has_columns(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ArgumentError, match=r"pip install pandas; run\.columns goes without"):
        run.yaw  # noqa: B018
    assert run.columns["fused_yaw"].size


def test_library_names_what_is_wrong(tiny_bag):
    alone = fuse(tiny_bag, gyro_topic="none", odometry_topic="none", smooth=True, config=Settings())
    assert set(alone.summary["yaw"]) == {"raw_compass", "fused", "smoothed"}
    assert [one.code for one in alone.warnings] == [one["code"] for one in alone.summary["warnings"]]


def test_library_writes_the_results_where_it_is_told(tiny_bag, tmp_path):
    done = fuse(tiny_bag, out=str(tmp_path / "out"))
    assert done.folder == tmp_path / "out"
    assert (done.folder / "yaw.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"path": 7}, "path is 7; give a path"),
        ({"path": b"x.bag"}, "give a path, as str or pathlib.Path"),
        ({"config": {"compass": 1}}, "config is {'compass': 1}; give a path"),
        ({"image_topic": 3}, "image_topic is 3|image_topic is"),
        ({"video_start": 1_700_000_000_000_000_000}, "are these nanoseconds\\? give 1.7e\\+09"),
        ({"video_start": "soon"}, "video_start is 'soon'; give seconds"),
        ({"report": True}, "give out, the folder for it"),
        ({"path": "no.bag"}, "no.bag: no such file"),
    ],
)
def test_library_refuses_arguments_of_a_wrong_kind_in_a_line(arguments, said, tiny_bag):
    with pytest.raises(VisualCompassError, match=said) as caught:
        fuse(**{"path": tiny_bag, **arguments})
    assert "\n" not in str(caught.value)


def test_text_for_a_path_is_refused_in_words(tiny_bag):
    with pytest.raises(ArgumentError, match=r"out is 'here', a str; give pathlib.Path"):
        fuse_bag(tiny_bag, "here", Settings())
    with pytest.raises(ArgumentError, match=r"path is '.*tiny.mcap', a str; give pathlib.Path"):
        fuse_bag(str(tiny_bag), None, Settings())


@pytest.mark.parametrize("seconds", [1.5, 1_700_000_000.0, np.float64(2.0), "3"])
def test_seconds_for_nanoseconds_are_refused_in_words(seconds):
    said = r"give whole nanoseconds as an int: round\(1e9 \* seconds\)"
    with pytest.raises(TypeError, match=said):
        VisualCompass().update(seconds, np.zeros((64, 128), np.uint8))
    if not isinstance(seconds, str):
        for sample in (GyroSample(seconds, 0.1), OdometrySample(seconds, 0.1, 0.0)):
            with pytest.raises(TypeError, match=said):
                YawFusion().add(sample)
    with pytest.raises(TypeError, match=said):
        YawFusion().estimate(seconds)


def test_whole_numbers_of_numpy_are_stamps():
    fusion = YawFusion()
    assert fusion.add(GyroSample(np.int64(1_000_000_000), 0.1))
    assert VisualCompass().update(np.int64(5), np.zeros((64, 128), np.uint8)) is None


@pytest.mark.parametrize("first", ["fusion.offline.cli", "fusion.offline.fuse_bag", "fusion.offline.demo"])
def test_library_function_is_no_module_whatever_was_imported_first(first):
    code = f"import {first}; from fusion.offline import fuse; assert callable(fuse), fuse"
    root = Path(__file__).parents[1]
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root)


T_NS = 1_700_000_000_000_000_000


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "x" * 5000 + ".mp4", "~/nowhere.bag", "", "s3://bucket/x.bag"])
def test_names_of_no_file_are_refused_in_words(name):
    with pytest.raises(VisualCompassError) as caught:
        fuse(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("whole", [np.int64, np.uint64, lambda t: np.array(t), lambda t: np.array([t], np.uint64)[0]])
@pytest.mark.parametrize("number", [np.float16, np.float32, np.float64, np.array, Fraction])
def test_samples_of_numpy_numbers_are_those_of_python(whole, number):
    """An unsigned stamp less another one overflows; half precision does so within the filter."""
    theirs, ours = YawFusion(), YawFusion()
    for i in range(40):
        t_ns, rate = T_NS + i * 10**7, 0.25 * (i % 3)
        for fusion, stamp, value in ((theirs, whole, number), (ours, int, float)):
            fusion.add(GyroSample(stamp(t_ns), value(rate), value(2.0**-16)))
            fusion.add(OdometrySample(stamp(t_ns), value(rate), value(0.5), value(0.125)))
            if i:
                fusion.add(YawIncrement(stamp(t_ns - 10**7), stamp(t_ns), value(0.0), value(2.0**-14), value(0.5)))
    assert theirs.estimate() == ours.estimate()
    assert theirs.counts == ours.counts


@pytest.mark.parametrize("value", ["0.1", b"1", None, [0.1], np.array([0.1]), 1j, 10**400])
@pytest.mark.parametrize(
    "sample",
    [
        lambda value: GyroSample(T_NS, value),
        lambda value: OdometrySample(T_NS, 0.0, value),
        lambda value: YawIncrement(T_NS, T_NS + 1, 0.1, value, 0.9),
        lambda value: GyroSample(value, 0.1),
        lambda value: YawIncrement(value, T_NS, 0.1, 0.1, 0.9),
    ],
)
def test_fields_that_are_no_numbers_are_named(sample, value):
    if isinstance(value, int) and value in (getattr(sample(value), name, 0) for name in ("t_ns", "t_ref_ns")):
        pytest.skip("any int is a stamp")
    with pytest.raises(ArgumentError, match=r"^(yaw_rate|speed|variance|t_ns|t_ref_ns) is "):
        YawFusion().add(sample(value))


@pytest.mark.parametrize("given", [{}, {"method": "rows"}, "rows", 0, CompassConfig, FusionConfig])
def test_configs_of_another_kind_are_refused(given):
    """Of those that are false, such as an empty dict, the defaults would be taken."""
    for take, name in ((YawFusion, "FusionConfig"), (VisualCompass, "CompassConfig")):
        with pytest.raises(ArgumentError, match=rf"config is .*; give a {name}, such as {name}\("):
            take(given)


def test_configs_take_numbers_of_numpy_and_paths():
    config = CompassConfig(columns=np.int64(512), roi_top=np.float32(0.25), mask=Path("robot.png"))
    assert config == CompassConfig(columns=512, roi_top=0.25, mask="robot.png")
    assert [type(value) for value in (config.columns, config.roi_top, config.mask)] == [int, float, str]
    for value in (True, np.bool_(True), 512.5, "512"):
        with pytest.raises(ConfigError, match="is not of type int"):
            CompassConfig(columns=value)
