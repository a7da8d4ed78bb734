"""The compass in a process of its own: the same results, and what happens when either process ends."""

import dataclasses
import heapq
import os
import signal
import subprocess
import sys
import time
from itertools import islice
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

from compass import CompassConfig, CompassStatus, ConfigError, ImageError, register_method
from compass.methods.registry import find_method
from fusion import FusionConfig, GyroSample, Warning, YawPipeline
from fusion.offline import compass_process, fuse, fuse_bag
from fusion.offline.cli import main
from fusion.offline.compass_process import MOST_AHEAD, CompassProcess, can_have_process
from fusion.offline.decode import NICER, decode_ahead
from fusion.offline.image_results import ImageResults
from fusion.offline.run import fuse_recording
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack
from fusion.settings import Settings

STEP_NS = 33_333_333
NO_ODOMETRY = OdometryTrack(np.zeros(0, np.int64), *np.zeros((3, 0)))


class FaultyRecording:
    """A tilted robot whose camera repeats, darkens, changes its size, and stamps backward; more is wrong at each."""

    def __init__(self, count: int = 60) -> None:
        stamps = range(START_NS, START_NS + count * STEP_NS, 5_000_000)
        samples = (GyroSample(t_ns, 0.5, up=upright((t_ns - START_NS) * 1e-9), cross_rate=0.01) for t_ns in stamps)
        self.gyro = GyroTrack.of(samples)
        self.odometry, self.truth, self.frame_count = NO_ODOMETRY, None, count
        self.warnings: list[Warning] = []

    def frames(self):
        drive = TinyDrive(seconds=10.0)
        for i in range(self.frame_count):
            image = drive.panorama(i * STEP_NS * 1e-9)
            if i == 10:
                image = drive.panorama((i - 1) * STEP_NS * 1e-9)
            elif 20 <= i < 24:
                image = np.zeros_like(image)
            elif i >= 40:
                image = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)  # more than the places hold until then
            if i % 7 == 3:
                self.warnings = [*self.warnings, Warning("samples_lost", "recording", START_NS, f"{i} lost")]
            if i % 2:
                yield Frame(START_NS + i * STEP_NS - (2 * STEP_NS if i == 31 else 0), image)
            else:
                yield Frame(START_NS + i * STEP_NS, np.dstack([image, image, image]), "rgb8")


def upright(t):
    """The vertical in the frame of a robot that sways, a unit vector."""
    x, y = 0.1 * float(np.sin(3.0 * t)), -0.05
    return x, y, float(np.sqrt(1.0 - x**2 - y**2))


def still(images):
    frames = [Frame(START_NS + i * STEP_NS, image) for i, image in enumerate(images)]
    return SimpleNamespace(
        gyro=GyroTrack.of([]),
        odometry=NO_ODOMETRY,
        truth=None,
        frame_count=len(frames),
        warnings=[],
        frames=lambda: frames,
    )


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory):
    """Panoramas enough for a process, each so small that they take no time."""
    path = tmp_path_factory.mktemp("long") / "bag"
    with TinyBag(path) as bag:
        fill(bag, TinyDrive(seconds=0.1 * compass_process.WORTH_IT, width=128))
    return path / "bag.mcap"


@pytest.fixture
def started(monkeypatch):
    """The processes that are started from here on."""
    found, start = [], CompassProcess.__enter__

    def noted(self):
        found.append(start(self))
        return found[-1]

    monkeypatch.setattr(CompassProcess, "__enter__", noted)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    return found


# ---------------------------------------------------------------- the same results


def test_run_with_two_processes_is_the_same_to_the_bit():
    here = fuse_recording(FaultyRecording(), Settings())
    with CompassProcess(Settings().compass) as process:
        recording = FaultyRecording()
        elsewhere = fuse_recording(recording, Settings(), results=ImageResults(recording, Settings(), process.measure))
    assert len({row.warnings for row in here.rows}) > 8
    assert here.compass_counts[CompassStatus.SIZE_CHANGED] == here.compass_counts[CompassStatus.BACKWARD_STAMP] == 1
    for name in ("rows", "compass_counts", "mount", "fusion_counts", "gates", "warnings"):
        assert repr(getattr(elsewhere, name)) == repr(getattr(here, name)), name


@pytest.mark.parametrize("delay", [0.0, 0.07, -0.02])
def test_looks_are_what_the_pipeline_sees_that_is_given_all_by_its_stamp(delay):
    settings = dataclasses.replace(Settings(), fusion=FusionConfig(camera_delay=delay))
    recording, pipeline = FaultyRecording(30), YawPipeline(fusion_config=settings.fusion)
    expected = []
    for event in heapq.merge(recording.gyro.samples(), recording.frames(), key=attrgetter("t_ns")):
        if isinstance(event, Frame):
            increment = pipeline.add_image(event.t_ns, event.image, event.encoding)
            expected.append((increment, pipeline.compass.status, pipeline.compass.yaw_variance))
        else:
            pipeline.add(event)
    results = ImageResults(recording, settings)
    assert [(result.increment, result.status, result.yaw_variance) for result in results] == expected
    assert results.counts == pipeline.compass.counts


@pytest.mark.parametrize("images", [0, 1, MOST_AHEAD, 40])
def test_looks_that_began_early_are_the_same(images):
    recording, busy = FaultyRecording(images), iter([True] * 25)
    plain = list(ImageResults(recording, Settings()))
    with CompassProcess(Settings().compass) as process:
        results = ImageResults(recording, Settings(), process.measure)
        results.measure_ahead_while(lambda: next(busy, False))
        assert list(results) == plain
    assert sum(results.counts.values()) == images


def test_panoramas_are_not_read_far_ahead():
    read = []
    frames = ((read.append(one), (one, None))[1] for one in FaultyRecording(60).frames())
    with CompassProcess(CompassConfig()) as process:
        for taken, _ in enumerate(islice(process.measure(frames), 30), start=1):
            assert len(read) <= taken + MOST_AHEAD


def test_commands_results_are_the_same_bytes_with_one_process_and_with_two(long_bag, tmp_path, started):
    assert main(["-q", "fuse", str(long_bag), "--out", str(tmp_path / "two")]) == 0
    assert len(started) == 1
    fuse_bag.fuse_bag(long_bag, tmp_path / "one", Settings(), two_processes=False)
    names = {path.name for path in (tmp_path / "one").iterdir()}
    assert names == {path.name for path in (tmp_path / "two").iterdir()}
    for name in names:
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes(), name


# ---------------------------------------------------------------- when


def test_many_bags_have_one_process_each(long_bag, tmp_path, started):
    from fusion.offline.bag_task import FUSED, BagTask, run_task
    from fusion.offline.topics import TopicRequest

    task = BagTask(str(long_bag), tmp_path / "out", Settings(), TopicRequest(), False, (), False, False)
    assert run_task(task, lambda part: None).status == FUSED
    assert started == []


def test_process_only_where_it_pays_and_knows_the_method(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    assert can_have_process(CompassConfig(), 200)
    assert can_have_process(CompassConfig(method="row_correlation"), 200)
    assert not can_have_process(CompassConfig(), 199)
    register_method("mine_of_two_processes", find_method("rows")[1].make())
    assert not can_have_process(CompassConfig(method="mine_of_two_processes"), 200)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert not can_have_process(CompassConfig(), 200)
    monkeypatch.delattr(os, "memfd_create")
    assert not can_have_process(CompassConfig(), 200)


def test_script_without_a_guard_is_not_run_again(long_bag, tmp_path):
    code = f"from fusion.offline import fuse; print('once'); print(len(fuse({str(long_bag)!r}).columns['t']) > 0)"
    (tmp_path / "script.py").write_text(code)
    for command in (["-c", code], [str(tmp_path / "script.py")]):
        done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=True, env=with_path())
        assert done.stdout.split() == ["once", "True"]


def test_library_has_two_processes(long_bag, started):
    assert fuse(long_bag).details.compass_counts[CompassStatus.OK] >= 100
    assert len(started) == 1


# ---------------------------------------------------------------- ends


def test_error_of_the_compass_is_raised_here():
    image = TinyDrive().panorama(0.0)
    with CompassProcess(CompassConfig()) as process, pytest.raises(ImageError, match="4, 4, 4"):
        list(ImageResults(still([image, np.zeros((4, 4, 4, 4), np.uint8)]), Settings(), process.measure))
    config = dataclasses.replace(CompassConfig(), mask="/none/mask.png")
    with CompassProcess(config) as process, pytest.raises(ConfigError, match=r"/none/mask\.png"):
        list(ImageResults(still([image]), Settings(), process.measure))


def test_process_that_is_killed_is_one_line(long_bag, tmp_path, capsys, monkeypatch, started):
    send = CompassProcess._send

    def kill_at_the_tenth(self, *frame):
        send(self, *frame)
        if self._sent == 10:
            self._process.kill()

    monkeypatch.setattr(CompassProcess, "_send", kill_at_the_tenth)
    assert main(["fuse", str(long_bag), "--out", str(tmp_path / "out")]) == 1
    err = capsys.readouterr().err
    assert err == "visual-compass: the compass's process was ended by SIGKILL; was memory short?\n"
    assert list(tmp_path.iterdir()) == []


def test_process_ends_with_the_run_however_that_ends():
    def fail(part):
        if part > 0.5:
            raise ZeroDivisionError

    recording, settings = FaultyRecording(), Settings()
    with pytest.raises(ZeroDivisionError), CompassProcess(settings.compass) as process:
        fuse_recording(recording, settings, fail, ImageResults(recording, settings, process.measure))
    assert process._process.poll() == -signal.SIGKILL


@pytest.mark.skipif(sys.platform != "linux", reason="threads have nice values of their own on Linux only")
def test_decoding_gives_way_and_nothing_else_does():
    def nice_value(_=None):
        return os.getpriority(os.PRIO_PROCESS, 0)  # of the thread that asks

    usual = nice_value()
    assert set(decode_ahead(range(9), nice_value)) == {min(usual + NICER, 19)}
    assert nice_value() == usual


def test_process_ends_by_itself_when_the_other_is_gone():
    process = CompassProcess(CompassConfig())
    with process:
        next(process.measure((frame, None) for frame in FaultyRecording().frames()))
        process._connection.close()  # as the kernel does for one that is killed
        assert process._process.wait(60) == 0


def test_interrupted_run_leaves_neither_files_nor_processes(long_bag, tmp_path):
    """Ctrl-C reaches both processes; the one that is run decides."""
    code = (
        "import sys, time, fusion.offline.fuse_bag, fusion.offline.compass_process as p;"
        "from fusion.offline.cli import main;"
        "p.CompassProcess._receive = lambda self: (print(self._process.pid, flush=True), time.sleep(600));"
        "sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, "fuse", str(long_bag), "--out", str(tmp_path / "out")]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen(command, env=with_path(), **pipes) as process:
        child = int(process.stdout.readline())
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (130, "visual-compass: interrupted, nothing was written\n")
    assert list(tmp_path.iterdir()) == []
    deadline = time.monotonic() + 60.0
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not Path(f"/proc/{child}").exists()


def with_path() -> dict[str, str]:
    root = str(Path(__file__).parents[1])
    return dict(os.environ, PYTHONPATH=os.pathsep.join([root, os.environ.get("PYTHONPATH", "")]))
