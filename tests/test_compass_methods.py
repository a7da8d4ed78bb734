"""A method of one's own: registered, or named as module:function; in this process and in others."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from panoramas import FRAME_NS, START_NS, as_bytes, scene
from scipy.spatial.transform import Rotation
from tiny_bags import TinyDrive

import compass.methods.registry
from compass import CompassConfig, ConfigError, Match, VisualCompass, VisualCompassError, register_method
from compass.config import METHODS
from fusion.offline.cli import main
from fusion.offline.evaluation.experiments import evaluate_experiments
from fusion.settings import Settings

PER_PX = math.tau / 512
MODULE = '''
"""A method as a user writes one: the best of all whole shifts."""

import numpy as np

from compass import Match


def whole_columns(reference, current, search):
    products = np.fft.irfft((reference.spectrum.conj() * current.spectrum).sum(axis=0), reference.columns)
    best = int(products.argmax())
    shift = (best + reference.columns / 2) % reference.columns - reference.columns / 2
    return Match(shift, 1.0 / 12.0, 1.0)


def nothing(reference, current, search):
    return None
'''


def always_three(reference, current, search):
    """Says that it was three columns."""
    return Match(3.0, 1.0, 0.9)


class Counting:
    """Counts how often it was asked, as a method that remembers does."""

    def __init__(self):
        self.asked = 0

    def __call__(self, reference, current, search):
        self.asked += 1
        return Match(float(self.asked), 1.0, 0.9)


@pytest.fixture(autouse=True)
def registry(monkeypatch):
    """What is registered in one test is unknown in the next."""
    monkeypatch.setattr("compass.methods.registry._own", {})
    monkeypatch.setattr(sys, "path", list(sys.path))


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "mine_for_a_test.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    yield "mine_for_a_test"
    sys.modules.pop("mine_for_a_test", None)


def yaw_px(config, frames=3):
    """What it accumulates over images that turn by 5 columns each."""
    one = VisualCompass(config)
    image = as_bytes(scene(3, 512, 128))
    for index in range(frames):
        one.update(START_NS + index * FRAME_NS, np.roll(image, 5 * index, axis=1))
    return one.yaw / PER_PX


def test_method_of_ones_own_is_what_the_compass_asks():
    register_method("three", always_three)
    assert yaw_px(CompassConfig(method="three")) == pytest.approx(6.0)


def test_class_makes_an_object_for_every_compass():
    register_method("counting", Counting)
    for _ in range(2):
        assert yaw_px(CompassConfig(method="counting")) == pytest.approx(3.0)  # 1 + 2


def test_function_of_a_module_in_the_working_directory_is_a_method(module):
    assert yaw_px(CompassConfig(method=f"{module}:whole_columns")) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("old", "name"), [("row_correlation", "rows"), ("sector_median", "sectors"), ("parallax", "corners")]
)
def test_other_names_of_a_method_mean_the_same(old, name):
    assert CompassConfig(method=old) == CompassConfig(method=name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("rowz", "one of: rows, sectors, corners, or 'module:function'"),
        ("no_such_module_here:f", "PYTHONPATH"),
        ("math:no_such", "no_such"),
        ("math:pi", "cannot be called"),
        ("a b:c", "module:function"),
        (":", "module:function"),
        (".:f", "module:function"),
    ],
)
def test_what_is_no_method_is_named_when_it_is_set(name, words):
    with pytest.raises(ConfigError, match=words):
        CompassConfig(method=name)


@pytest.mark.parametrize("name", [*METHODS, "parallax", "a:b", "", 3])
def test_name_that_is_taken_or_none_cannot_be_registered(name):
    with pytest.raises(ConfigError, match="give"):
        register_method(name, always_three)


def test_what_cannot_be_called_cannot_be_registered():
    with pytest.raises(ConfigError, match="int cannot be called"):
        register_method("number", 3)


def test_method_that_gives_no_match_is_named(module):
    with pytest.raises(VisualCompassError, match=f"{module}:nothing gave NoneType"):
        yaw_px(CompassConfig(method=f"{module}:nothing"))


def test_views_far_back_are_compared_for_corners_only():
    register_method("three", always_three)
    for method in ("three", "rows"):
        one = VisualCompass(CompassConfig(method=method, long_baseline_interval=0.1))
        image = as_bytes(scene(3, 512, 128))
        for index in range(6):
            one.update(START_NS + index * FRAME_NS, np.roll(image, 3 * index, axis=1))
            assert one.due_long_baseline() is None


def test_worker_processes_know_what_was_registered_in_this_one():
    """Two real processes, started anew: they import this file, and are told the names."""
    register_method("three", always_three)
    outcomes = evaluate_experiments(["shifted"], range(2), Settings(), 2, False)
    for seed in (0, 1):
        given = {one.source: one.given for one in outcomes if one.seed == seed}
        assert given["three"] > 0.9  # all but the images that repeat one
        assert set(METHODS) < set(given)


def test_evaluate_command_scores_a_function_from_its_folder_and_a_yaw(tiny_bag, module, tmp_path):
    """As a user calls it: another process, in a folder that is not on its path."""
    drive, tum = TinyDrive(), tmp_path / "mine.tum"
    t = np.arange(0.0, 3.0, 0.05)
    yaw = drive.yaw(t) + 0.01 * t
    quaternions = Rotation.from_euler("z", yaw[:, None] + 3.0).as_quat()  # from any start
    lines = [f"{1_700_000_000 + s:.9f} 0 0 0 {' '.join(map(str, q))}" for s, q in zip(t, quaternions, strict=True)]
    tum.write_text("# t x y z qx qy qz qw\n" + "\n".join(lines) + "\n")
    command = Path(sys.executable).parent / "visual-compass"
    arguments = [
        "evaluate",
        str(tiny_bag),
        "--method",
        f"{module}:whole_columns",
        "--yaw",
        "mine.tum",
        "--json",
        "o.json",
    ]
    environment = dict(os.environ, PYTHONPATH=str(Path(compass.__file__).parents[1]))
    done = subprocess.run([command, *arguments], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    scored = json.loads((tmp_path / "o.json").read_text())["summaries_deg"][str(tiny_bag)]
    assert f"{module}:whole_columns" in done.stdout
    assert scored[f"{module}:whole_columns"]["given"] == 1.0
    assert scored["mine.tum"]["final"] == pytest.approx(math.degrees(0.01 * t[-1]), abs=0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "missing.tum"),
        ("", "0 poses"),
        ("1 0 0 0 0 0 0 1\n", "1 poses"),
        ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "do not rise"),
        ("1,0\n2,0\n", "line 1: '1,0' is no pose"),
        ("1 0 0 0 0 0 0 9\n2 0 0 0 0 0 0 9\n", "line 1"),
        ("nan 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "line 1"),
        ("1e400 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "line 1"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "no two times in common"),
    ],
)
def test_yaw_that_cannot_be_scored_is_named(tiny_bag, tmp_path, capsys, text, words):
    file = tmp_path / ("missing.tum" if text is None else "mine.tum")
    if text is not None:
        file.write_text(text)
    assert main(["evaluate", str(tiny_bag), "--yaw", str(file)]) == 1
    assert words in " ".join(capsys.readouterr().err.split())


def test_yaw_needs_a_bag(tmp_path, capsys):
    file = tmp_path / "mine.tum"
    file.write_text("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    assert main(["evaluate", "demo", "--yaw", str(file)]) == 1
    assert "--yaw belongs to one bag" in capsys.readouterr().err


def test_evaluate_refuses_an_unknown_method_at_once(capsys):
    assert main(["evaluate", "demo", "--method", "no_such_module_here:f"]) == 1
    assert "no_such_module_here" in capsys.readouterr().err
