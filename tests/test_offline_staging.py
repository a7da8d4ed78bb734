"""What killed runs leave behind goes with the next run; what running ones are writing stays."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from tiny_bags import TinyBag, TinyDrive, fill

from fusion.offline.atomic_output import OutputError, scratch_folder, staged_file, staged_folder
from fusion.offline.cli import main

HOLD = """
import sys, time
from pathlib import Path
from fusion.offline.atomic_output import staged_folder
with staged_folder(Path(sys.argv[1])) as staging:
    (staging / "half").write_text("written")
    print(staging, flush=True)
    time.sleep(60)
"""


def hold(target: Path) -> tuple[subprocess.Popen[str], Path]:
    """A process that is writing, and its hidden folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(target)], stdout=subprocess.PIPE, text=True)
    assert process.stdout
    return process, Path(process.stdout.readline().strip())


def kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    if process.stdout:
        process.stdout.close()


def test_staging_of_a_killed_process_is_removed_by_the_next_run(tmp_path):
    process, left = hold(tmp_path / "out")
    kill(process)
    assert (left / "half").exists()
    with staged_folder(tmp_path / "out") as staging:
        assert sorted(tmp_path.iterdir()) == [staging]
    assert sorted(tmp_path.iterdir()) == [tmp_path / "out"]


def test_staging_of_a_running_process_and_of_another_place_stays(tmp_path):
    running, kept = hold(tmp_path / "out")
    other, left = hold(tmp_path / "out.2")
    kill(other)
    mine = tmp_path / ".out.mine.part"
    mine.mkdir()
    try:
        with staged_folder(tmp_path / "out"):
            pass
        assert (kept / "half").exists()
        assert left.exists()
        assert mine.exists()
    finally:
        kill(running)


def test_staging_survives_a_name_full_of_wildcards(tmp_path):
    process, left = hold(tmp_path / "o[u]*.t")
    kill(process)
    (tmp_path / ".oxxx.0123456789abcdef.part").mkdir()
    with staged_file(tmp_path / "o[u]*.t") as staged:
        staged.write_text("x")
    assert not left.exists()
    assert (tmp_path / ".oxxx.0123456789abcdef.part").exists()


def test_staging_does_not_follow_a_link_of_its_name(tmp_path):
    (tmp_path / "years").mkdir()
    (tmp_path / "years" / "thesis.tex").write_text("years of work")
    (tmp_path / ".out.0123456789abcdef.part").symlink_to(tmp_path / "years")
    with staged_folder(tmp_path / "out"):
        pass
    assert (tmp_path / "years" / "thesis.tex").exists()


def test_staging_below_a_file_is_one_error(tmp_path):
    (tmp_path / "file").write_text("x")
    for target in (tmp_path / "file" / "out", tmp_path / "file" / "below" / "out", Path("/proc/none/below/out")):
        with pytest.raises(OutputError, match="cannot be written"), staged_folder(target):
            pass


def test_scratch_is_private_and_gone_afterwards(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with scratch_folder() as folder:
        assert folder.parent == tmp_path
        assert folder.stat().st_mode & 0o077 == 0
    assert list(tmp_path.iterdir()) == []


def test_fuse_killed_leaves_nothing_after_the_next_run(tmp_path, tiny_bag):
    """A real run, killed without warning while it is writing."""
    with TinyBag(tmp_path / "long") as bag:
        fill(bag, TinyDrive(seconds=20.0))
    place = tmp_path / "place"
    place.mkdir()
    command = [sys.executable, "-m", "fusion.offline.cli", "fuse", str(tmp_path / "long"), "--out", str(place / "out")]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 60.0
        while not list(place.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.01)
        os.kill(process.pid, signal.SIGKILL)
    assert len(list(place.glob(".out.*.part"))) == 1
    assert not (place / "out").exists()
    assert main(["fuse", str(tiny_bag), "--out", str(place / "out")]) == 0
    assert list(place.iterdir()) == [place / "out"]
