"""Many recordings: found, named, fused in processes; what fails, is finished, or breaks off."""

import csv
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from gyro_bags import make_bag, three_bags

from fusion.offline import batch_progress, console
from fusion.offline.atomic_output import OutputError
from fusion.offline.bag_task import FAILED, FUSED, SKIPPED, BagOutcome, BagTask, run_task
from fusion.offline.batch_table import COLUMNS, check_tables, row_of, write_tables
from fusion.offline.cli import cli, main
from fusion.offline.find_bags import find_bags
from fusion.offline.report.table import report_of_folder
from fusion.offline.topics import TopicRequest
from fusion.settings import Settings


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    return three_bags(tmp_path_factory.mktemp("bags"))


@pytest.fixture
def in_this_process(monkeypatch):
    """Call it, and bags are fused here: no process starts, which takes a second or more each."""
    import fusion.offline.worker_pool as pool

    return lambda: monkeypatch.setattr(pool, "run_in_processes", lambda tasks, jobs, part: map(run_task, tasks))


def rows(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "summary.csv").open() as file:
        return {row["folder"]: row for row in csv.DictReader(file)}


# ---------------------------------------------------------------- fused


def test_many_are_fused_told_skipped_and_gathered(bags, tmp_path, capsys, in_this_process):
    bad = tmp_path / "bad.mcap"
    bad.write_text("no bag")
    command = ["fuse", str(bags), str(bad), "--out", str(tmp_path / "out"), "--jobs", "2"]
    assert main(command) == 1
    out, err = capsys.readouterr()
    assert out.startswith("4 bags: 3 fused, 1 failed; ")
    assert err.splitlines()[0].startswith(f"failed: {bad}: not a bag")
    assert err.splitlines()[1:] == [f"visual-compass: 1 of 4 bags failed; {tmp_path}/out/summary.csv says why"]
    table = rows(tmp_path / "out")
    assert [row["status"] for row in table.values()] == [FUSED, FUSED, FUSED, FAILED]
    assert float(table["mon_drive_yaw"]["fused_turned_deg"]) == pytest.approx(57.3 * 0.5 * 0.99, abs=0.1)
    assert table["dusk_yaw"]["raw_compass_turned_deg"] == ""
    assert "not a bag" in table["bad_yaw"]["error"]
    assert not (tmp_path / "out" / "bad_yaw").exists()
    stamp = (tmp_path / "out" / "dusk_yaw" / "yaw.csv").stat().st_mtime_ns
    # again: one of them has lost a file; then another part of two
    in_this_process()
    (tmp_path / "out" / "mon_drive_yaw" / "yaw.png").unlink()
    assert main([*command[:2], *command[3:-1], "1"]) == 0
    assert "3 bags: 1 fused, 2 skipped" in capsys.readouterr().out
    assert (tmp_path / "out" / "dusk_yaw" / "yaw.csv").stat().st_mtime_ns == stamp
    assert main(["fuse", "-q", str(bags / "tue"), "--out", str(tmp_path / "out"), "--start", "0.1", "--jobs", "1"]) == 0
    assert capsys.readouterr() == ("", "")
    status = {name: row["status"] for name, row in rows(tmp_path / "out").items()}
    assert status == {"tue_drive_yaw": FUSED, "dusk_yaw": FUSED, "mon_drive_yaw": "earlier"}


def test_process_that_is_killed_takes_one_bag_with_it(bags, tmp_path):
    """A long bag is killed once it is worked on; all others are fused."""
    shutil.copytree(bags, tmp_path / "in")
    make_bag(tmp_path / "in" / "a_long.mcap", seconds=120.0)
    script = (
        "import os, signal, sys, threading, time, pathlib; from fusion.offline.cli import main\n"
        "import multiprocessing\n"
        "def kill():\n"
        "    out = pathlib.Path(sys.argv[-1])\n"
        "    while not list(out.glob('.a_long_yaw.*.part')): time.sleep(0.01)\n"
        "    os.kill(min(child.pid for child in multiprocessing.active_children()), signal.SIGKILL)\n"
        "if __name__ == '__main__':\n"
        "    threading.Thread(target=kill, daemon=True).start()\n"
        "    sys.exit(main(sys.argv[1:]))\n"
    )
    (tmp_path / "run.py").write_text(script)
    command = [sys.executable, tmp_path / "run.py", "fuse", tmp_path / "in", "--jobs", "1", "--out", tmp_path / "out"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, env=with_path())
    assert done.returncode == 1
    assert "a_long.mcap: its process was ended by SIGKILL; was memory short?" in done.stderr
    assert "4 bags: 3 fused, 1 failed" in done.stdout


def with_path() -> dict[str, str]:
    root = str(Path(__file__).parents[1])
    return dict(os.environ, PYTHONPATH=os.pathsep.join([root, os.environ.get("PYTHONPATH", "")]))


def test_interrupted_run_keeps_what_is_finished_and_goes_on(bags, tmp_path, in_this_process):
    shutil.copytree(bags, tmp_path / "in")
    make_bag(tmp_path / "in" / "zz_long.mcap", seconds=120.0)
    out = tmp_path / "out"
    words = ["fuse", str(tmp_path / "in" / "mon" / "drive.mcap"), str(tmp_path / "in" / "zz_long.mcap")]
    command = [sys.executable, "-m", "fusion.offline.cli", *words, "--jobs", "1", "--out", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=with_path()) as process:
        deadline = time.monotonic() + 120.0
        while not list(out.glob(".zz_long_yaw.*.part")) and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 128 + signal.SIGTERM
    assert err == "visual-compass: interrupted, what is finished stays, the same command goes on with the rest\n"
    assert {file.name for file in out.iterdir()} - {"summary.parquet"} == {"drive_yaw", "summary.csv"}
    in_this_process()
    shutil.copy(tmp_path / "in" / "tue" / "dusk.mcap", tmp_path / "in" / "zz_long.mcap")
    assert main(["-q", *words, "--jobs", "1", "--out", str(out)]) == 0
    assert [row["status"] for row in rows(out).values()] == [SKIPPED, FUSED]


def test_place_without_room_for_the_table_is_left_as_it_was(tmp_path, in_this_process, monkeypatch, capsys):
    in_this_process()

    def full(*_):
        raise OutputError("no room")

    monkeypatch.setattr("fusion.offline.batch.write_tables", full)
    words = ["fuse", str(tmp_path / "none.mcap"), "--jobs", "1", "--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert capsys.readouterr().err.endswith("visual-compass: no room\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["full", "file", "foreign.csv"])
def test_place_that_is_something_else_is_refused(bags, tmp_path, place, capsys):
    out = tmp_path / "out"
    if place == "file":
        out.write_text("mine")
    else:
        out.mkdir()
        (out / ("thesis.tex" if place == "full" else "summary.csv")).write_text("mine")
    assert main(["fuse", str(bags), "--out", str(out), "--jobs", "2"]) == 1
    out_text, err = capsys.readouterr()
    assert (out_text, err.count("\n")) == ("", 1)
    assert {file.read_text() for file in tmp_path.rglob("*") if file.is_file()} == {"mine"}


# ---------------------------------------------------------------- one of many


def task(bag: str | Path, folder: Path, **options) -> BagTask:
    return BagTask(str(bag), folder, Settings(), TopicRequest(), **options)


def test_recording_by_url_is_fused_and_recognised(bags, tmp_path):
    fsspec = pytest.importorskip("fsspec", reason="needs the extra `cluster`")
    memory = fsspec.filesystem("memory")
    memory.pipe("/store/mon.mcap", (bags / "mon" / "drive.mcap").read_bytes())
    assert find_bags(["memory://store/*.mcap"]) == find_bags(["memory://store"]) == ["memory:///store/mon.mcap"]
    url = "memory:///store/mon.mcap"
    first = run_task(task(url, tmp_path / "out"))
    assert (first.status, first.error) == (FUSED, "")
    assert first.summary["source"]["path"] == url
    assert run_task(task(url, tmp_path / "out")).status == SKIPPED
    # the content is that of the file: where it was fetched from does not matter
    assert run_task(task(bags / "mon" / "drive.mcap", tmp_path / "out")).status == SKIPPED
    gone = run_task(task("memory:///store/none.mcap", tmp_path / "none"))
    assert (gone.status, gone.error) == (FAILED, "memory:///store/none.mcap: no such file")
    assert "cannot be brought here" in run_task(task("nosuch://x/y.mcap", tmp_path / "none")).error
    assert not (tmp_path / "none").exists()


def test_recording_by_url_is_recognised_where_the_server_gives_no_parts(bags, tmp_path, monkeypatch):
    fsspec = pytest.importorskip("fsspec", reason="needs the extra `cluster`")
    memory = fsspec.filesystem("memory")
    memory.pipe("/whole/mon.mcap", (bags / "mon" / "drive.mcap").read_bytes())
    monkeypatch.setattr("fusion.offline.bag_task.remote_source", lambda url: None)
    url = "memory:///whole/mon.mcap"
    assert [run_task(task(url, tmp_path / "out")).status for _ in range(2)] == [FUSED, SKIPPED]
    memory.pipe("/whole/mon.mcap", (bags / "tue" / "drive.mcap").read_bytes())
    assert "as it was before it changed" in run_task(task(url, tmp_path / "out")).error


def test_recording_that_fails_unforeseen_is_told_with_its_trace(bags, tmp_path, monkeypatch):
    monkeypatch.setattr("fusion.offline.fuse_bag.summarise", lambda *_: 1 / 0)
    outcome = run_task(task(bags / "mon" / "drive.mcap", tmp_path / "out"))
    assert outcome.error.endswith("ZeroDivisionError: division by zero")
    assert "Traceback" in outcome.trace
    assert list(tmp_path.iterdir()) == []


def test_recording_that_has_changed_is_not_taken_for_finished(tmp_path):
    bag = make_bag(tmp_path / "in" / "drive.mcap")
    assert run_task(task(bag, tmp_path / "out")).status == FUSED
    make_bag(bag, rate=0.3)
    assert "as it was before it changed" in run_task(task(bag, tmp_path / "out")).error
    assert run_task(task(bag, tmp_path / "out", force=True)).status == FUSED
    assert run_task(task(bag, tmp_path / "out")).status == SKIPPED


def test_recording_for_another_version_is_refused(bags, tmp_path):
    outcome = run_task(task(bags / "mon" / "drive.mcap", tmp_path / "out", version="99.0"))
    assert "not 99.0" in outcome.error


# ---------------------------------------------------------------- tables and progress


def test_tables_say_the_same_and_know_each_other(tmp_path):
    failed = BagOutcome("/x/a.mcap", tmp_path / "a_yaw", FAILED, error='says "no", and more')
    written = write_tables(tmp_path, [row_of(failed, tmp_path)])
    (row,) = rows(tmp_path).values()
    assert (row["bag"], row["error"], row["fused_turned_deg"]) == ("/x/a.mcap", 'says "no", and more', "")
    assert list(row) == list(COLUMNS)
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs the extra `cluster`")
    assert written == [tmp_path / "summary.csv", tmp_path / "summary.parquet"]
    (same,) = parquet.read_table(written[1]).to_pylist()
    assert (same["bag"], same["fused_turned_deg"]) == ("/x/a.mcap", None)
    check_tables(tmp_path)
    written[1].write_bytes(b"another's")
    with pytest.raises(OutputError, match="exists already"):
        check_tables(tmp_path)


@pytest.mark.parametrize(
    "summary",
    [
        "",
        "[]",
        "{}",
        '{"source": {"path": "/x", "size_bytes": 1, "content": "a"}, "settings_hash": "", "yaw": 3}',
        '{"source": {"path": "/x", "size_bytes": 1, "content": "a"}, "settings_hash": "", "warnings": [3, {}],'
        ' "yaw": {"fused": 3, "gyro_alone": {"turned_deg": "x"}}, "images": {"ok": []}, "track_scale": "x"}',
    ],
)
def test_summaries_that_are_none_do_not_spoil_the_table(bags, tmp_path, in_this_process, summary):
    in_this_process()
    for name in ("odd", "other_yaw"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(summary)
    bag = str(bags / "mon" / "drive.mcap")
    assert main(["fuse", "-q", bag, "--jobs", "1", "--out", str(tmp_path), "--force", "--end", "0.1"]) == 0
    assert rows(tmp_path)["drive_yaw"]["status"] == FUSED


def test_progress_in_a_pipe_is_a_line_a_minute(capsys):
    now = [0.0]
    lines = console.MinuteLines("fusing", lambda: now[0])
    for second in range(1, 131):
        now[0] = float(second)
        lines(second / 240.0)
    assert capsys.readouterr().err == "fusing: 25 %, 3 min left\nfusing: 50 %, 2 min left\n"


def test_progress_of_many_in_a_pipe_counts_parts_too(tmp_path, capsys):
    now = [0.0]
    lines = batch_progress.Lines(4, clock=lambda: now[0])
    lines.end(BagOutcome("/a", tmp_path, FUSED))
    lines.end(BagOutcome("/b", tmp_path, FAILED, error="/b: wrong"))
    now[0] = 60.0
    lines.part(task("/c", tmp_path), 0.5)
    assert capsys.readouterr().err == "failed: /b: wrong\n2 of 4 bags, 1 failed, 36 s left\n"
    now[0] = 120.0  # where no parts are told, as on a cluster
    lines.end(BagOutcome("/c", tmp_path, FUSED))
    assert capsys.readouterr().err == "3 of 4 bags, 1 failed, 40 s left\n"


@pytest.mark.parametrize("name", sorted(cli.commands))
def test_every_command_takes_quiet_and_verbose(name):
    assert {"-q", "--quiet", "-v", "--verbose"} <= {
        word for option in cli.commands[name].params for word in option.opts
    }


@pytest.mark.parametrize("words", [["-q", "fuse"], ["fuse", "-q"], ["fuse", "--quiet"]])
def test_quiet_says_nothing_anywhere(bags, tmp_path, words, capsys):
    assert main([*words, str(bags / "mon" / "drive.mcap"), "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("words", [["-v", "fuse"], ["fuse", "-v"]])
def test_verbose_is_taken_anywhere(bags, tmp_path, words, caplog):
    level = logging.getLogger().level
    assert main([*words, str(bags / "mon" / "drive.mcap"), "--out", str(tmp_path / "out")]) == 0
    assert "gyro: /imu/data (sensor_msgs/Imu, 100)" in caplog.text
    assert logging.getLogger().level == level


@pytest.mark.parametrize("name", ["\udcff\udcfe", "new\nline", "50% #2?"])
def test_names_of_any_bytes_are_fused_reported_and_gathered(bags, tmp_path, name, in_this_process, capsys):
    """Names of files are bytes; only text is UTF-8."""
    in_this_process()
    where = tmp_path / name
    where.mkdir()
    for day in ("mon", "tue"):  # two alike, so that folders are named after parents, too
        (where / day).mkdir()
        shutil.copy(next(bags.rglob("*.mcap")), where / day / f"{name}.mcap")
    (where / "bad.mcap").write_text("no bag")
    out = tmp_path / "out"
    for _ in range(2):
        assert main(["fuse", str(where), "--out", str(out), "--jobs", "1"]) == 1
    assert capsys.readouterr().err.count("Traceback") == 0
    assert [row["status"] for row in rows(out).values()].count(SKIPPED) == 2
    assert report_of_folder(out)[1] == 2
