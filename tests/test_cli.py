"""The command as its user meets it: results, errors, exit codes, nothing left behind."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

from fusion.offline.bag import Bag
from fusion.offline.cli import main
from fusion.settings import Settings, load_settings

WITHOUT_TRUTH = {"yaw.csv", "compass.tum", "fused.tum", "result.mcap", "summary.json", "yaw.png", "config.yaml"}
RESULTS = WITHOUT_TRUTH | {"truth.tum"}
TURNED = float(TinyDrive().yaw(TinyDrive().seconds))


@pytest.fixture(scope="module")
def fused(tiny_bag, tmp_path_factory):
    out = tmp_path_factory.mktemp("fused") / "out"
    assert main(["fuse", str(tiny_bag), "--out", str(out)]) == 0
    return out


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "yaw.csv").open() as file:
        return list(csv.DictReader(file))


# ---------------------------------------------------------------- fuse: what comes out


def test_fuse_writes_all_results_and_nothing_else(fused):
    assert {file.name for file in fused.iterdir()} == RESULTS
    assert list(fused.parent.iterdir()) == [fused]


def test_fuse_csv_begins_with_the_promised_columns_and_follows_the_turn(fused):
    header = (fused / "yaw.csv").read_text().split("\n")[0]
    assert header.startswith("t,compass_yaw,compass_sigma,confidence,fused_yaw,fused_sigma,yaw_rate,gyro_bias,")
    images = [row for row in rows(fused) if row["compass_status"]]
    assert [row["t"] for row in images[:2]] == ["1700000000.000000000", "1700000000.100000000"]
    # Noise-free texture at 256 columns in JPEG: each of 30 increments is good to 1/100 column = 2.5e-4 rad.
    assert float(images[-1]["compass_yaw"]) == pytest.approx(TURNED, abs=30**0.5 * 2.5e-4)
    assert float(rows(fused)[-1]["fused_yaw"]) == pytest.approx(TURNED, abs=3 * float(rows(fused)[-1]["fused_sigma"]))
    assert float(rows(fused)[-1]["truth_yaw"]) == pytest.approx(TURNED, abs=1e-6)


def test_fuse_tum_files_are_what_evo_reads(fused):
    for name, column in (("compass.tum", "compass_yaw"), ("fused.tum", "fused_yaw"), ("truth.tum", "truth_yaw")):
        lines = [line.split() for line in (fused / name).read_text().splitlines()]
        assert {len(line) for line in lines} == {8}
        expected = {row["t"]: float(row[column]) for row in rows(fused) if row[column]}
        found = {line[0]: 2.0 * math.atan2(float(line[6]), float(line[7])) for line in lines}
        assert found == pytest.approx(expected, abs=1e-8)


def test_fuse_mcap_holds_both_yaws_and_diagnostics(fused):
    with Bag(fused / "result.mcap") as bag:
        counts = {topic.name: (topic.short_type, topic.count) for topic in bag.topics}
        last = [bag.deserialize(message) for message in bag.messages("/odometry/fused")][-1]
        status = [bag.deserialize(message) for message in bag.messages("/diagnostics")][-1].status[0]
    images = TinyDrive().times(10.0).size
    assert counts["/compass_pose"] == ("nav_msgs/Odometry", images - 1)  # the first image has no increment
    assert counts["/viz/pano/image"] == ("sensor_msgs/CompressedImage", images)
    assert counts["/odometry/fused"][1] == len([row for row in rows(fused) if row["fused_yaw"]])
    turn = last.pose.pose.orientation
    assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(float(rows(fused)[-1]["fused_yaw"]), abs=1e-8)
    covariance = last.pose.covariance.reshape(6, 6)
    assert covariance[5, 5] == pytest.approx(float(rows(fused)[-1]["fused_sigma"]) ** 2, rel=1e-6)
    assert all(1e3 < covariance[axis, axis] < math.inf for axis in range(5))
    assert {"gyro_bias", "track_scale"} <= {value.key for value in status.values}


def test_fuse_summary_compares_every_source_with_the_truth(fused):
    summary = json.loads((fused / "summary.json").read_text())
    assert summary["truth_turned_deg"] == pytest.approx(math.degrees(TURNED))
    # gyro: a bias of 0.01 rad/s over 3 s; tracks: they claim 1.2 of the turn
    gyro, tracks = summary["yaw"]["gyro_alone"], summary["yaw"]["tracks_alone"]
    assert gyro["final_error_deg"] == pytest.approx(math.degrees(0.03), abs=math.degrees(0.5 * 0.01))
    assert tracks["final_error_deg"] == pytest.approx(math.degrees(0.2 * TURNED), abs=1e-6)
    assert abs(summary["yaw"]["fused"]["final_error_deg"]) < gyro["final_error_deg"]
    images = {outcome: count for outcome, count in summary["images"].items() if count}
    assert images == {"first_frame": 1, "ok": TinyDrive().times(10.0).size - 1}
    # every sample reached the filter in the order of the stamps, whatever the streams
    counts = {"gyro": 301, "tracks": 61, "compass": 30}  # 256 columns show too few corners for a long baseline
    assert {one["outcome"]: one["count"] for one in summary["samples"]} == {
        f"{sensor}: in order": count for sensor, count in counts.items()
    }
    assert summary["topics"]["image"] == "/viz/pano/image/compressed"


def test_fuse_plot_is_a_picture(fused):
    picture = cv2.imread(str(fused / "yaw.png"))
    assert picture.shape[0] > 600
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


def test_fuse_config_is_as_resolved_and_can_be_used_again(fused, tmp_path, tiny_bag):
    assert load_settings(fused / "config.yaml") == Settings()
    out = tmp_path / "again"
    assert main(["fuse", str(tiny_bag), "--out", str(out), "--config", str(fused / "config.yaml")]) == 0
    assert (out / "yaw.csv").read_bytes() == (fused / "yaw.csv").read_bytes()


def test_fuse_gives_the_same_yaw_however_the_bag_was_recorded(fused, tmp_path):
    with TinyBag(tmp_path / "shuffled") as bag:
        fill(bag, TinyDrive(), shuffle=True)
    assert main(["fuse", str(tmp_path / "shuffled"), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "yaw.csv").read_bytes() == (fused / "yaw.csv").read_bytes()


def test_fuse_prints_table_and_places(tiny_bag, tmp_path, capsys):
    assert main(["fuse", str(tiny_bag), "--out", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    assert [line.split("  ")[0] for line in out.splitlines()[2:7]] == [
        *("truth", "raw compass", "gyro alone", "tracks alone", "fused")
    ]
    assert f"{tmp_path / 'out'}/" in out
    assert "\x1b" not in out + err  # plain where there is no terminal


@pytest.mark.parametrize(
    ("left_out", "columns"),
    [("image", ["compass_yaw"]), ("gyro", ["gyro_nis"]), ("odometry", ["tracks_nis"])],
)
def test_fuse_goes_on_without_any_one_sensor(tiny_bag, tmp_path, left_out, columns):
    out = tmp_path / "out"
    assert main(["fuse", str(tiny_bag), "--out", str(out), f"--{left_out}-topic", "none"]) == 0
    expected = RESULTS - {"compass.tum"} if left_out == "image" else RESULTS  # no TUM file without a yaw
    assert {file.name for file in out.iterdir()} == expected
    for column in columns:
        assert not any(row[column] for row in rows(out))
    assert rows(out)[-1]["fused_yaw"]


def test_fuse_without_out_names_the_folder_after_the_bag(tiny_bag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["fuse", str(tiny_bag), "--truth-topic", "none"]) == 0
    assert {file.name for file in (tmp_path / "tiny_yaw").iterdir()} == WITHOUT_TRUTH
    assert "truth_yaw" not in (tmp_path / "tiny_yaw" / "yaw.csv").read_text()


def test_fuse_by_force_replaces_results_and_keeps_what_is_not_ours(tiny_bag, tmp_path):
    (tmp_path / "yaw.csv").write_text("old")
    (tmp_path / "thesis.tex").write_text("years of work")
    assert main(["fuse", str(tiny_bag), "--out", str(tmp_path), "--force"]) == 0
    assert (tmp_path / "thesis.tex").read_text() == "years of work"
    assert {file.name for file in tmp_path.iterdir()} == RESULTS | {"thesis.tex"}
    assert (tmp_path / "yaw.csv").read_text().startswith("t,")


def test_fuse_smooth_adds_the_yaw_that_knows_the_future(tiny_bag, tmp_path):
    out = tmp_path / "out"
    assert main(["fuse", str(tiny_bag), "--out", str(out), "--smooth"]) == 0
    assert {file.name for file in out.iterdir()} == RESULTS | {"smoothed.tum"}
    both = [row for row in rows(out) if row["smoothed_yaw"]]
    assert len(both) > 25
    # Knowing more never makes less certain: with every later sample the variance can only fall.
    assert all(float(row["smoothed_sigma"]) <= float(row["fused_sigma"]) * (1 + 1e-6) for row in both)
    assert float(both[5]["smoothed_sigma"]) < float(both[5]["fused_sigma"])
    assert "smoothed" in json.loads((out / "summary.json").read_text())["yaw"]
    # and without it, the file of the run before goes
    assert main(["fuse", str(tiny_bag), "--out", str(out)]) == 0
    assert {file.name for file in out.iterdir()} == RESULTS


# ---------------------------------------------------------------- bad input: one line, exit code 1, nothing left


def fails(arguments: list[str], capsys) -> str:
    """Run a command that must fail; give its one line."""
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("visual-compass: ")
    assert err.count("\n") == 1
    return err


def bad_input(kind: str, folder: Path, tiny_bag: Path) -> Path:
    path = folder / "bad.mcap"
    if kind == "not_a_bag":
        path.write_text("no bag")
    elif kind == "truncated":
        path.write_bytes(tiny_bag.read_bytes()[:300])
    elif kind in ("no_topic", "encoding", "zero_stamps", "zero_image_stamps"):
        path = folder / "bad"
        with TinyBag(path) as bag:
            if kind == "no_topic":
                bag.write("/chatter", bag.make("std_msgs/msg/String", data="hello"))
            elif kind == "zero_stamps":
                bag.imu("/imu/data", 0, 0.1)
            elif kind == "zero_image_stamps":
                bag.image("/pano", 0, np.zeros((8, 16), np.uint8))
                bag.imu("/imu/data", START_NS, 0.1)
            else:
                bag.image("/pano", START_NS, np.zeros((8, 16), np.uint8), "jpeg2000")
                bag.imu("/imu/data", START_NS, 0.1)
    return path


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("no_such_file", "no such file"),
        ("not_a_bag", "not a bag"),
        ("truncated", "truncated"),
        ("no_topic", "no usable topic"),
        ("encoding", "encoding 'jpeg2000' is unknown"),
        ("zero_stamps", "stamp is zero"),
        ("zero_image_stamps", "stamp is zero"),
    ],
)
def test_fuse_bad_input_gives_one_line_and_leaves_nothing(kind, says, tmp_path, tiny_bag, capsys):
    (tmp_path / "in").mkdir()
    (tmp_path / "place").mkdir()
    bag = bad_input(kind, tmp_path / "in", tiny_bag)
    assert says in fails(["fuse", str(bag), "--out", str(tmp_path / "place" / "out")], capsys)
    assert list((tmp_path / "place").iterdir()) == []


def test_fuse_bad_input_leaves_earlier_results_as_they_were(tmp_path, tiny_bag, capsys):
    (tmp_path / "yaw.csv").write_text("old")
    bag = bad_input("encoding", tmp_path, tiny_bag)
    before = sorted(tmp_path.iterdir())
    fails(["fuse", str(bag), "--out", str(tmp_path), "--force"], capsys)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "yaw.csv").read_text() == "old"


def test_fuse_config_mistake_is_one_line(tmp_path, tiny_bag, capsys):
    (tmp_path / "c.yaml").write_text("/**: {ros__parameters: {compass: {metod: rows}}}")
    assert "method" in fails(["fuse", str(tiny_bag), "--config", str(tmp_path / "c.yaml")], capsys)


def test_fuse_onto_a_file_is_refused(tmp_path, tiny_bag, capsys):
    (tmp_path / "out").write_text("mine")
    assert "is no folder" in fails(["fuse", str(tiny_bag), "--out", str(tmp_path / "out")], capsys)
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_fuse_into_a_read_only_place_is_one_line(tmp_path, tiny_bag, capsys):
    tmp_path.chmod(0o500)
    assert "Permission denied" in fails(["fuse", str(tiny_bag), "--out", str(tmp_path / "out")], capsys)


def test_unknown_errors_keep_their_traceback(tiny_bag, tmp_path, monkeypatch):
    monkeypatch.setattr("fusion.offline.fuse_bag.summarise", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["fuse", str(tiny_bag), "--out", str(tmp_path / "out")])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_fuse_interrupted_leaves_nothing(tmp_path, number):
    """The signal comes once the staging folder is there, and before the summary, at which the command would wait."""
    with TinyBag(tmp_path / "long") as bag:
        fill(bag, TinyDrive(seconds=5.0))
    place = tmp_path / "place"
    place.mkdir()
    code = (
        "import sys, time, fusion.offline.fuse_bag; from fusion.offline.cli import main;"
        "fusion.offline.fuse_bag.summarise = lambda *_, **__: time.sleep(600);"
        "sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, "fuse", str(tmp_path / "long"), "--out", str(place / "out")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 300.0
        while not list(place.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(number)
        _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (128 + number, "visual-compass: interrupted, nothing was written\n")
    assert list(place.iterdir()) == []


# ---------------------------------------------------------------- the command itself


def test_usage_error_is_exit_code_2(capsys):
    assert main(["fuse", "--no-such-option"]) == 2
    assert "No such option" in capsys.readouterr().err


def test_help_names_every_command(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(command in out for command in ("fuse", "inspect", "simulate", "evaluate", "demo", "calibrate"))


def test_version_is_the_distribution_s(capsys):
    from importlib.metadata import version

    assert main(["--version"]) == 0
    assert version("visual-compass") in capsys.readouterr().out


def test_help_needs_no_numerics():
    """Instant help is a matter of what is imported, which does not vary from machine to machine."""
    code = (
        "import sys; from fusion.offline.cli import main; main(['fuse', '--help']);"
        "sys.exit(bool({'numpy', 'scipy', 'cv2', 'matplotlib', 'rosbags', 'mcap', 'rich', 'yaml'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=False).returncode == 0


@pytest.mark.parametrize(
    ("redirected", "code", "says"),
    [
        (">/dev/full", 1, "visual-compass: standard output cannot be written: No space left on device; make room"),
        ("2>&-", 0, ""),
        (">&- 2>&-", 0, ""),
        (">/dev/null <&-", 0, ""),
    ],
)
def test_output_that_cannot_be_written_or_is_closed_is_no_traceback(tiny_bag, tmp_path, redirected, code, says):
    if "full" in redirected and not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    command = f'"{sys.executable}" -m fusion.offline.cli fuse "{tiny_bag}" --out "{tmp_path}/out" {redirected}'
    ran = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=120, check=False)
    assert (ran.returncode, ran.stderr.startswith(says), ran.stderr.count("\n")) == (code, True, bool(says))
    assert (tmp_path / "out" / "yaw.csv").stat().st_size > 0


def test_names_that_the_terminal_cannot_show_are_printed_as_escapes(tmp_path):
    command = [sys.executable, "-m", "fusion.offline.cli", "inspect", str(tmp_path / "ü\udcff.mcap")]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert (ran.returncode, ran.stderr.count("\n")) == (1, 1)
    assert r"ü\udcff.mcap: no such file" in ran.stderr
