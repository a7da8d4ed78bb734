"""Recordings fused by a real scheduler of Dask and two workers in processes of their own, of which one is killed."""

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from tiny_bags import TinyBag, TinyDrive, fill

from fusion.offline.cli import main

pytest.importorskip("distributed", reason="needs the extra `cluster`")
ROOT = Path(__file__).resolve().parents[1]
COUNT = 4


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    for k in range(COUNT):
        with TinyBag(folder / f"run{k}") as bag:
            fill(bag, TinyDrive(seconds=2.0, rate=0.3 + 0.05 * k))
    return folder


def written_address(file: Path) -> str:
    """As the scheduler writes it, once it has done so to the end."""
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, ValueError):
            return str(json.loads(file.read_text())["address"])
        time.sleep(0.05)
    raise TimeoutError("the scheduler has not started")


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler on loopback, and its two workers, one thread each."""
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), str(ROOT / "tests")]), MPLBACKEND="Agg")
    scheduler_file = tmp_path / "scheduler.json"

    def started(kind, *more):
        module = f"distributed.cli.dask_{kind}"
        command = [sys.executable, "-m", module, "--host", "127.0.0.1", "--no-dashboard", *more]
        processes.append(subprocess.Popen(command, env=environment, cwd=tmp_path, stderr=subprocess.DEVNULL))

    processes = []
    try:
        started("scheduler", "--port", "0", "--scheduler-file", str(scheduler_file))
        address = written_address(scheduler_file)
        for name in "ab":
            started("worker", address, "--nthreads", "1", "--no-nanny", "--name", name)
        yield address, processes
    finally:
        for process in reversed(processes):
            process.kill()
        for process in processes:
            process.wait()


def fused_while_killing(victim, bags, address, out):
    """Exit code of a run, and how many results were there when `victim` was killed: some, while more are written."""
    killed_at, done = [], threading.Event()

    def kill_in_the_middle():
        while not list(out.glob("*_yaw")) and not done.wait(0.02):
            pass
        victim.send_signal(signal.SIGKILL)
        killed_at.append(len(list(out.glob("*_yaw"))))

    killer = threading.Thread(target=kill_in_the_middle)
    killer.start()
    try:
        code = main(["fuse", str(bags), "--scheduler", address, "--out", str(out)])
    finally:
        done.set()
        killer.join()
    return code, killed_at[0]


def test_cluster_of_which_a_worker_is_killed_ends_every_bag_once(bags, cluster, tmp_path, capsys):
    address, (_, victim, _) = cluster
    out = tmp_path / "results"
    code, killed_at = fused_while_killing(victim, bags, address, out)
    assert code == 0
    assert killed_at < COUNT  # in the middle
    # What the killed one had finished and not reported is asked for again, and found finished: then "skipped".
    assert f"{COUNT} bags: " in (said := capsys.readouterr().out)
    assert "failed" not in said
    folders = {folder.name for folder in out.iterdir() if folder.is_dir() and not folder.name.startswith(".")}
    assert folders == {f"run{k}_yaw" for k in range(COUNT)}
    with (out / "summary.csv").open() as file:
        assert [row["folder"] for row in csv.DictReader(file)] == sorted(folders)
    # the same bags by this machine alone: nothing is left to do, and what the killed one left half written goes
    assert main(["fuse", "-q", str(bags), "--jobs", "1", "--out", str(out)]) == 0
    with (out / "summary.csv").open() as file:
        assert {row["status"] for row in csv.DictReader(file)} == {"skipped"}


def test_cluster_whose_scheduler_is_killed_is_one_line_and_what_is_finished_stays(bags, cluster, tmp_path, capsys):
    address, (scheduler, *_) = cluster
    out = tmp_path / "results"
    code, _ = fused_while_killing(scheduler, bags, address, out)
    assert code == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith(("failed", "visual-compass"))]
    assert lines == [f"visual-compass: {address}: the scheduler has gone; the same command goes on with the rest"]
    assert list(out.glob("*_yaw"))


def test_cluster_that_is_not_there_is_one_line(bags, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fusion.offline.cluster._ANSWER_WITHIN_S", 0.5)
    assert main(["fuse", str(bags), "--scheduler", "tcp://127.0.0.1:1", "--out", str(tmp_path / "out")]) == 1
    assert "no Dask scheduler answers there" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
