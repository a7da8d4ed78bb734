"""Settings from files that were never meant as settings: one line each, at once, whatever they are."""

import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from compass import CompassConfig, ConfigError, VisualCompass
from compass.parameters import shown
from fusion.bounded_yaml import DEEPEST, LONGEST_VALUE, MOST_VALUES, YamlError, parse_yaml
from fusion.settings import load_settings

RATE = "/**: {{ros__parameters: {{compass: {{max_yaw_rate: {}}}}}}}"


def aliases(levels: int = 30) -> str:
    """A few hundred characters that stand for 9^30 values."""
    lines = ["x0: &a0 [lol, lol]"]
    lines += [f"x{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join([*lines, f"/**: {{ros__parameters: {{gyro_topic: *a{levels - 1}}}}}"])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (aliases(), "alias *a0 in line 2"),
        ("a: &a {b: *a}", "alias *a"),
        ("/**: &all {ros__parameters: {}}\nfusion_node: {<<: *all}", "alias *all in line 2"),
        ("[" * 10_000, "nest"),
        ("{a: " * 10_000, "nested deeper"),
        ("- " * 10_000, "nested deeper"),
        ("? " * 10_000, "nested deeper"),
        ("/**: \0", "#x0000"),
        (b"/**: \xe9", "byte 5 is not UTF-8"),
        ("/**: 1".encode("utf-16"), "not UTF-8"),
        ("a: " + ":".join(["1"] * 100_000), f"more than {LONGEST_VALUE}"),
        ("- 1\n" * (MOST_VALUES + 1), f"more than {MOST_VALUES} values"),
        ("a: 1\n" * 300_000, "more than the 1000000 allowed"),
        ("/**: 2001-99-99", "not of its type"),
        ("/**: !!int ''", "not of its type"),
        ("/**: !!timestamp x", "not of its type"),
        ("/**: !!python/object/apply:os.system [true]", "not YAML"),
        ("{[1]: 2}", "unhashable"),
        (RATE.format("1" + "0" * 400), "beyond all numbers"),
        (RATE.format("-0x" + "f" * 900), "beyond all numbers"),
        (RATE.format("1" + "0" * 5000), f"more than {LONGEST_VALUE}"),
        (RATE.format(".inf"), "inf is outside"),
        (RATE.format("[" + "1, " * 5000 + "]"), "..."),
        ('/**: {ros__parameters: {compass.mask: "a\\0b"}}', "compass.mask"),
        ("\n".join(f"k{i}: 1" for i in range(5000)), "'k4', ... only"),
    ],
)
def test_settings_file_of_hostile_content_is_one_short_line(tmp_path, content, says):
    path = tmp_path / "s.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError, match=re.escape(says)) as caught:
        load_settings(path)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 500


@pytest.mark.parametrize("kind", ["folder", "pipe", "/dev/zero", "/dev/null"])
def test_settings_that_are_no_file_are_refused_without_reading(tmp_path, kind):
    path = tmp_path / "s.yaml"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)  # nobody writes into it: to open it is to wait for ever
    else:
        path = Path(kind)
    with pytest.raises(ConfigError, match=r"is a (folder|pipe|device), not a regular file; give a readable YAML file"):
        load_settings(path)
    with pytest.raises(ConfigError, match=r"mask: .* is a (folder|pipe|device), not a regular file; give the path"):
        VisualCompass(CompassConfig(mask=str(path)))


def test_settings_of_standard_input_are_refused_at_once():
    command = [sys.executable, "-m", "fusion.offline.cli", "inspect", "x.bag", "--config", "/dev/stdin"]
    reader, writer = os.pipe()
    try:
        ran = subprocess.run(command, stdin=reader, capture_output=True, text=True, timeout=60, check=False)
    finally:
        os.close(reader), os.close(writer)
    assert (ran.returncode, ran.stderr.count("\n")) == (1, 1)
    assert "not a regular file" in ran.stderr


def test_settings_hostile_files_take_little_memory(tmp_path):
    """In a process that may not have more than 1 GB, of which the libraries take some."""
    (tmp_path / "laugh.yaml").write_text(aliases())
    (tmp_path / "deep.yaml").write_text("[" * 400_000)
    code = (
        "import sys; from fusion.settings import load_settings; from compass import ConfigError\n"
        "for path in sys.argv[1:]:\n"
        "    try: load_settings(path)\n"
        "    except ConfigError: print('refused')\n"
    )
    files = [str(tmp_path / "laugh.yaml"), str(tmp_path / "deep.yaml"), "/dev/zero"]
    ran = subprocess.run(
        [sys.executable, "-c", code, *files],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30)),
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert ran.stdout.splitlines() == ["refused"] * 3, ran.stderr


def test_yaml_of_ordinary_files_is_as_pyyaml_reads_it():
    text = "a: {b: [1, 2.5, yes, ~, 'x', 2001-01-01]}\nc: |\n  long\n  text\n"
    assert parse_yaml(text) == yaml.safe_load(text)
    assert parse_yaml("a: 1\nb: yes", as_text=True) == {"a": "1", "b": "yes"}
    assert parse_yaml("[" * DEEPEST + "]" * DEEPEST)


def test_yaml_without_libyaml_is_refused_alike(monkeypatch):
    monkeypatch.delattr(yaml, "CSafeLoader", raising=False)
    for text in (aliases(), "{a: " * 10_000, "/**: \0", "{a: [", "a: " + "1" * 2000):
        with pytest.raises(YamlError):
            parse_yaml(text)


def test_settings_file_with_a_byte_order_mark_is_read(tmp_path):
    (tmp_path / "s.yaml").write_bytes(b"\xef\xbb\xbf/**: {ros__parameters: {compass: {rows: 32}}}")
    assert load_settings(tmp_path / "s.yaml").compass.rows == 32


def test_shown_values_are_short_whatever_they_are():
    endless: list[object] = []
    endless.append(endless)
    assert [len(shown(value)) <= 60 for value in (10**5000, "x" * 10_000, endless, 1.5)] == [True] * 4
    assert shown("a") == "'a'"
