"""Warnings of a run: in the rows, in the summary, on the screen, in the files and in the plot."""

import csv
import json
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tiny_bags import START_NS, TinyBag, TinyDrive, fill

from compass.config import CompassConfig
from fusion import GyroSample, Sensor, Warning, YawPipeline
from fusion.offline.bag import Bag
from fusion.offline.bands import LANES, shade_warnings
from fusion.offline.cli import main
from fusion.offline.evaluation.tracks import all_tracks
from fusion.offline.run import LONGEST_PREDICTION_NS, fuse_recording
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack
from fusion.offline.summary import MOST_LINES, warning_facts, warning_lines
from fusion.offline.warning_history import Warned, WarningHistory
from fusion.settings import Settings

SECOND = 1_000_000_000
NO_ODOMETRY = OdometryTrack(np.zeros(0, np.int64), *np.zeros((3, 0)))
NO_GYRO = GyroTrack.of([])


def warning(code="gyro_stuck", sensor="gyro", since_ns=START_NS, text="what, how much, what to do"):
    return Warning(code, sensor, since_ns, text)


def recording(gyro=NO_GYRO, frames=(), **more):
    """A recording from memory."""
    fields = {"warnings": (), "gyro": gyro, "odometry": NO_ODOMETRY, "truth": None} | more
    return SimpleNamespace(frame_count=len(frames), frames=lambda: frames, **fields)


def steady_gyro(seconds, rate=0.5):
    stamps = range(START_NS, START_NS + round(seconds * SECOND) + 1, SECOND // 100)
    return GyroTrack.of(GyroSample(t_ns, rate) for t_ns in stamps)


@pytest.fixture
def wrong(monkeypatch):
    """Let every offline pipeline say what a function of the seconds since `START_NS` returns."""

    def install(warnings_at):
        class Pipeline(YawPipeline):
            def __init__(self, *configs):
                super().__init__(*configs)
                self.warning_sources.append(self.say)

            def say(self):
                newest = self.fusion.estimate()
                return warnings_at((newest.t_ns - START_NS) / SECOND) if newest else []

        monkeypatch.setattr("fusion.YawPipeline", Pipeline)

    return install


# ---------------------------------------------------------------- history


def test_history_makes_spans_of_what_comes_and_goes():
    history = WarningHistory()
    for t_ns in range(10):
        stuck = [warning(since_ns=1, text=f"at {t_ns}")] if 3 <= t_ns < 5 or t_ns == 7 else []
        lost = [warning("turn_lost", "compass", 8)] if t_ns >= 8 else []
        assert history.note(t_ns, stuck + lost) == tuple(stuck + lost)
    assert history.finish([]) == [
        # the second time it began no earlier than the first time ended, whatever it says itself
        Warned(warning(since_ns=1, text="at 7"), ((1, 5), (5, 8)), False),
        Warned(warning("turn_lost", "compass", 8), ((8, 9),), True),
    ]


def test_history_waits_for_what_has_yet_to_begin_and_takes_a_foreign_clock_for_the_whole_run():
    history, later, foreign = WarningHistory(), warning("images_frozen", "compass", 5), warning(since_ns=10**12)
    active = [history.note(t_ns, [foreign, later]) for t_ns in range(3, 8)]
    assert active == [(), (), (later,), (later,), (later,)]
    assert {(one.warning.code, one.spans, one.lasting) for one in history.finish([foreign, later])} == {
        ("images_frozen", ((5, 7),), True),
        ("gyro_stuck", ((3, 7),), True),
    }


def test_history_takes_in_what_turns_up_at_the_end():
    history = WarningHistory()
    history.note(3, [])
    history.note(9, [])
    assert history.finish([warning("samples_lost", "compass", 4)])[0].spans == ((3, 9),)


# ---------------------------------------------------------------- rows


def test_rows_carry_what_is_wrong_at_their_time(wrong):
    wrong(lambda t: [warning(since_ns=START_NS + SECOND // 2)] if 1.0 <= t < 2.0 else [])
    run = fuse_recording(recording(steady_gyro(3.0)), Settings())
    seconds = (run.t_ns - START_NS) / SECOND
    assert [bool(row.warnings) for row in run.rows] == [1.0 <= t < 2.0 for t in seconds]
    (one,) = run.warnings
    assert one.spans[0][0] == START_NS + SECOND // 2  # before it was found out
    assert one.spans[0][1] == min(row.t_ns for row in run.rows if row.t_ns >= START_NS + 2 * SECOND)
    assert not one.lasting


def test_recordings_warnings_are_the_runs():
    known = [warning("clock_mismatch", "gyro", 7)]
    run = fuse_recording(recording(steady_gyro(1.0), warnings=known), Settings())
    assert [one.warning for one in run.warnings] == known
    assert warning_facts(run)[0]["since_s"] == 0.0
    assert warning_facts(run)[0]["until_s"] is None
    assert all(row.warnings == tuple(known) for row in run.rows)


def turning_frames(times, dark=(np.inf, np.inf)):
    drive = TinyDrive(seconds=60.0)
    black = np.zeros((128, 256), np.uint8)
    return [
        Frame(START_NS + round(t * SECOND), black if dark[0] <= t < dark[1] else drive.panorama(float(t)))
        for t in times
    ]


@pytest.mark.parametrize(("times", "seconds", "named"), [([0.5], 6.0, True), ([0.5], 2.0, False), ([], 6.0, False)])
def test_single_image_of_a_recording_that_goes_on_is_named(times, seconds, named):
    run = fuse_recording(recording(steady_gyro(seconds), turning_frames(times)), Settings())
    assert ("sensor_silent" in [one.warning.code for one in run.warnings]) is named


def test_rows_without_a_measurement_are_predicted_to_their_own_time():
    """Images only, two seconds of them dark: nobody knows how the robot turns."""
    frames = turning_frames(np.arange(0.0, 6.0, 0.1), dark=(2.95, 5.0))
    settings = Settings(compass=CompassConfig(columns=256))
    run = fuse_recording(recording(frames=frames), settings)
    fused = [row for row in run.rows if row.fused]
    assert all(row.fused.t_ns == row.t_ns for row in fused)
    dark = [row.fused for row in fused if 2.95 < (row.t_ns - START_NS) / SECOND < 5.0]
    sigmas = [one.yaw_variance**0.5 for one in dark]
    assert len(dark) >= 20
    # the process noise of the rate changes its model where a walk would exceed `initial_rate_sigma`: a step back of 4 %
    assert all(later > 0.95 * sooner for sooner, later in pairwise(sigmas))
    assert len(set(sigmas)) == len(dark)
    assert sigmas[-1] > 0.5  # rad; a turn of 0.5 rad/s went on for 2 s
    true = [TinyDrive(seconds=60.0).yaw((row.t_ns - START_NS) / SECOND) for row in fused]
    errors = [(row.fused.yaw - yaw) / row.fused.yaw_variance**0.5 for row, yaw in zip(fused, true, strict=True)]
    assert max(map(abs, errors[2:])) < 3.0


def test_rows_long_after_the_last_measurement_say_nothing():
    gyro, black = steady_gyro(1.0), np.zeros((128, 256), np.uint8)
    stamps = [START_NS + SECOND + LONGEST_PREDICTION_NS, START_NS + SECOND + LONGEST_PREDICTION_NS + 1]
    run = fuse_recording(recording(gyro, [Frame(t_ns, black) for t_ns in stamps]), Settings())
    assert [row.fused is not None for row in run.rows[-2:]] == [True, False]


def test_refused_samples_make_no_row():
    stamps = range(START_NS, START_NS + SECOND, SECOND // 100)
    nonsense = GyroTrack.of(GyroSample(t_ns, np.nan if t_ns > START_NS + SECOND // 2 else 0.1) for t_ns in stamps)
    run = fuse_recording(recording(nonsense), Settings())
    assert run.rows[-1].t_ns <= START_NS + SECOND // 2


# ---------------------------------------------------------------- fuse


@pytest.fixture
def fused(wrong, tmp_path, capsys, tiny_bag):
    def warnings_at(t):
        stuck = [warning(since_ns=START_NS + SECOND, text="gyro says\n0.1; replace it")] if 1.5 <= t < 2.5 else []
        return [warning("samples_lost", "compass", text="3 lost"), *stuck]

    wrong(warnings_at)
    assert main(["fuse", str(tiny_bag), "--out", str(tmp_path / "out")]) == 0
    return tmp_path / "out", capsys.readouterr().out


def test_fuse_tells_warnings_on_the_screen_and_in_the_summary(fused):
    out, screen = fused
    told = [line for line in screen.splitlines() if line.startswith("warning: ")]
    assert told == ["warning: gyro says 0.1; replace it [gyro_stuck, gyro]", "warning: 3 lost [samples_lost, compass]"]
    stuck, lost = json.loads((out / "summary.json").read_text())["warnings"]
    assert (stuck["code"], stuck["sensor"], stuck["text"]) == ("gyro_stuck", "gyro", "gyro says\n0.1; replace it")
    assert (stuck["since_ns"], stuck["since_s"]) == (START_NS + SECOND, 1.0)
    assert stuck["until_s"] == pytest.approx(2.5, abs=0.1)
    assert (lost["since_s"], lost["until_s"]) == (0.0, None)


def test_fuse_writes_warnings_into_rows_and_diagnostics(fused):
    out, _ = fused
    with (out / "yaw.csv").open() as file:
        codes = {round(float(row["t"]) - START_NS / SECOND, 3): row["warnings"] for row in csv.DictReader(file)}
    assert (codes[1.0], codes[2.0]) == ("samples_lost", "gyro_stuck samples_lost")
    with Bag(out / "result.mcap") as bag:
        statuses = [bag.deserialize(message).status[0] for message in bag.messages("/diagnostics")]
    assert [status.level for status in statuses] == [1] * len(statuses)
    texts = [status.message for status in statuses]
    assert "3 lost" in texts
    assert "gyro says\n0.1; replace it" in texts


def test_fuse_counts_what_the_gate_let_pass(fused):
    out, _ = fused
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary["gates"]) == {"gyro", "tracks", "compass"}
    judged = {sensor: sum(counts.values()) for sensor, counts in summary["gates"].items()}
    assert judged["gyro"] == next(one["count"] for one in summary["samples"] if one["outcome"] == "gyro: in order")
    assert summary["gates"]["gyro"]["accepted"] > 0.9 * judged["gyro"]


def test_screen_shows_a_handful_and_counts_the_rest():
    facts = [{"code": "gyro_stuck", "sensor": "gyro", "text": f"n {i}"} for i in range(MOST_LINES + 3)]
    lines = warning_lines(facts)
    assert lines[0] == "warning: n 0 [gyro_stuck, gyro]"
    assert lines[MOST_LINES:] == ["and 3 more in summary.json"]
    assert len(warning_lines(facts[:MOST_LINES])) == MOST_LINES


def mirrored(path, seconds=6.0):
    """A bag whose panoramas are mirrored: they turn the other way than gyro and tracks."""

    class Mirrored(TinyDrive):
        def panorama(self, t, seed=5):
            return np.ascontiguousarray(super().panorama(t, seed)[:, ::-1])

    with TinyBag(path) as bag:
        fill(bag, Mirrored(seconds=seconds))
    return path


def test_sensor_that_is_mostly_refused_is_named(tmp_path, capsys):
    assert main(["fuse", str(mirrored(tmp_path / "bag")), "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "compass" in {one["sensor"] for one in summary["warnings"]}
    gate = summary["gates"]["compass"]
    assert gate["rejected"] > gate["accepted"]
    assert "warning: " in capsys.readouterr().out


def test_evaluate_tells_warnings_of_a_bag(wrong, tiny_bag, capsys, tmp_path):
    wrong(lambda t: [warning(text="says 0.1")])
    assert main(["evaluate", str(tiny_bag), "--json", str(tmp_path / "all.json")]) == 0
    assert "warning: says 0.1 [gyro_stuck, gyro]" in capsys.readouterr().out
    assert json.loads((tmp_path / "all.json").read_text())["warnings"][str(tiny_bag)][0]["code"] == "gyro_stuck"


def test_evaluate_hands_on_what_the_recording_says():
    known = [warning("samples_lost", "compass")]
    tracks = all_tracks(recording(steady_gyro(1.0), warnings=known), Settings())
    assert [one.warning for one in tracks.run.warnings] == known


# ---------------------------------------------------------------- plot


def test_plot_shades_every_panel_and_keeps_labels_apart():
    figure = Figure(figsize=(11.0, 6.0))
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(2, 1, sharex=True)
    axes[0].plot([0.0, 10.0], [0.0, 500.0])
    axes[-1].set_xlim(0.0, 10.0)
    limits = [axis.get_ylim() for axis in axes]
    many = [Warned(warning(sensor=str(k)), ((SECOND * k, SECOND * (k + 1)),), False) for k in range(10)]
    shade_warnings(axes, many, 0)
    assert [axis.get_ylim() for axis in axes] == limits
    assert [len(axis.collections) for axis in axes] == [10, 10]
    canvas.draw()
    boxes = [text.get_window_extent() for text in axes[0].texts]
    assert 10 // 2 <= len(boxes) <= 10
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    panel = axes[0].get_window_extent()
    assert all(panel.x0 <= box.x0 and box.x1 <= panel.x1 for box in boxes)


def test_plot_of_too_many_warnings_leaves_out_labels_of_the_least_serious():
    axis = Figure().subplots()
    shade_warnings([axis], [Warned(warning(), ((0, SECOND),), False)] * (LANES + 5), 0)
    assert len(axis.texts) == LANES
    assert len(axis.collections) == LANES + 5


# ---------------------------------------------------------------- sensor_refused


def test_gates_of_sensors_that_gave_nothing_are_absent_from_the_run():
    assert set(fuse_recording(recording(steady_gyro(1.0)), Settings()).gates) == {Sensor.GYRO}
