"""The compass in a process of its own: the same results, and one clear line when it dies."""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from types import SimpleNamespace

import cv2
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

from fusion.offline import cli, compass_process
from fusion.offline.bag import Bag, BagError
from fusion.offline.compass_process import ProcessError, _can_fork, measure_beside
from fusion.offline.image_results import measure_images
from fusion.offline.recording import read_recording
from fusion.offline.report.thumbnails import Thumbnails
from fusion.offline.run import fuse_recording
from fusion.offline.topics import choose_topics
from fusion.settings import Settings

SETTINGS = Settings()


@pytest.fixture(scope="module")
def faulty_bag(tmp_path_factory):
    """With a third of the images broken, which whoever reads the frames finds out."""
    folder = tmp_path_factory.mktemp("bag") / "faulty"
    drive = TinyDrive()
    with TinyBag(folder) as bag:
        fill(bag, drive)
        for t in drive.times(5.0):
            bag.bytes("/viz/pano/image/compressed", START_NS + round((t + 0.05) * 1e9), b"\xff\xd8 broken")
    return folder / "faulty.mcap"


@pytest.fixture
def recording(faulty_bag):
    with Bag(faulty_bag) as bag:
        choice = choose_topics(bag, SETTINGS.topics)
        yield lambda: read_recording(bag, choice, SETTINGS.imu, SETTINGS.compass.columns)


@pytest.fixture
def forking(monkeypatch):
    monkeypatch.setattr(compass_process, "_can_fork", lambda settings: True)


def test_another_process_finds_the_same(recording, monkeypatch):
    runs = []
    for fork in (False, True):
        monkeypatch.setattr(compass_process, "_can_fork", lambda settings, fork=fork: fork)
        one = recording()
        run = fuse_recording(one, SETTINGS)
        runs.append((repr(run.rows), repr(run.warnings), run.compass_counts, one.dropped, one.warnings))
    assert runs[0] == runs[1]
    assert sum(runs[0][3].values()) == 16  # the broken images
    assert runs[0][4]


def test_the_tilt_is_what_the_live_pipeline_would_know(recording):
    """Beside `GyroTrack.up_at`, a `TiltLog` that was given the samples up to the image."""
    from fusion.imu.tilt import TiltLog

    gyro, log, checked = recording().gyro, TiltLog(), 0
    for i, sample in enumerate(gyro.samples()):
        log.add(sample)
        if i % 10 == 5:
            t_ns = sample.t_ns + 3_000_000
            assert gyro.up_at(t_ns) == log.at(t_ns)
            checked += log.at(t_ns) is not None
    assert checked > 10
    last_ns = int(gyro.t_ns[-1])
    assert gyro.up_at(last_ns + 105_000_000) == log.at(last_ns + 105_000_000) is not None
    assert gyro.up_at(last_ns + 200_000_000) is log.at(last_ns + 200_000_000) is None


def test_pictures_come_back_from_it_and_what_is_no_bag_is_read_here(recording, forking):
    one, other = Thumbnails(recording()), Thumbnails(SimpleNamespace(frame_count=3))
    list(measure_beside(one, SETTINGS))
    assert len(one.pictures) == 31
    assert not other.is_separable


def killed(recording, settings):
    yield from list(measure_images(recording, settings))[:3]
    os.kill(os.getpid(), signal.SIGKILL)


def failing(recording, settings):
    yield from list(measure_images(recording, settings))[:3]
    raise BagError("no usable image")


def crashing(recording, settings):
    raise ZeroDivisionError
    yield


def test_a_killed_process_is_one_line_and_no_result(faulty_bag, tmp_path, forking, monkeypatch, capfd):
    monkeypatch.setattr(compass_process, "measure_images", killed)
    assert cli.main(["fuse", str(faulty_bag), "--out", str(tmp_path / "out")]) == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert "killed by signal 9" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("work", "error", "words"),
    [(failing, BagError, "no usable image"), (crashing, ProcessError, "ended with code 1")],
    ids=["known", "unknown"],
)
def test_errors_of_the_process_are_this_ones(recording, forking, monkeypatch, capfd, work, error, words):
    monkeypatch.setattr(compass_process, "measure_images", work)
    with pytest.raises(error, match=words):
        list(measure_beside(recording(), SETTINGS))
    assert ("ZeroDivisionError" in capfd.readouterr().err) == (work is crashing)


def test_a_run_that_stops_early_leaves_no_process(recording, forking):
    images = measure_beside(recording(), SETTINGS)
    next(images)
    assert multiprocessing.active_children()
    images.close()
    assert not multiprocessing.active_children()


def test_no_process_where_a_fork_is_not_safe_or_not_of_use(monkeypatch):
    monkeypatch.setattr(compass_process.sys, "platform", "linux")
    monkeypatch.setattr(compass_process.os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)
    monkeypatch.setattr(compass_process.threading, "active_count", lambda: 1)
    assert _can_fork(SETTINGS)
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as workers:
        assert not workers.submit(_can_fork, SETTINGS).result()
    monkeypatch.setattr(cv2, "getNumThreads", lambda: 2)
    assert not _can_fork(SETTINGS)
    monkeypatch.undo()
    monkeypatch.setattr(compass_process.os, "sched_getaffinity", lambda pid: {0}, raising=False)
    assert not _can_fork(SETTINGS)
