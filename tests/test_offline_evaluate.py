"""Scores, honesty and verdicts of an evaluation."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from tiny_bags import START_NS, TinyDrive
from tools.photo_drive import HUSKY

from compass import CompassConfig, YawIncrement
from compass.config import METHODS
from fusion import GyroSample
from fusion.offline import gps, scores
from fusion.offline.bag import Bag
from fusion.offline.cli import main
from fusion.offline.evaluation import command
from fusion.offline.evaluation.outcome import Outcome, increment_honesty
from fusion.offline.evaluation.summary import Summary, summarise_outcomes
from fusion.offline.evaluation.tables import full_table, short_table
from fusion.offline.evaluation.tracks import all_tracks
from fusion.offline.evaluation.verdicts import verdict_lines
from fusion.offline.recording import read_recording
from fusion.offline.run import fuse_recording
from fusion.offline.scores import COMPASS, FUSED, GYRO, TRACKS, Score, YawTrack
from fusion.offline.streams import Frame, GyroTrack, OdometryTrack, TruthTrack
from fusion.offline.summary import key_of, summarise
from fusion.offline.topics import choose_topics
from fusion.settings import Settings

SECOND = 1_000_000_000


def track(yaw, sigma=None, step_ns=SECOND, start_ns=START_NS) -> YawTrack:
    yaw = np.asarray(yaw, float)
    return YawTrack(start_ns + step_ns * np.arange(yaw.size), yaw, sigma)


def truth(yaw) -> TruthTrack:
    one = track(yaw)
    return TruthTrack(one.t_ns, one.yaw)


# ---------------------------------------------------------------- scores


def test_score_is_aligned_where_both_begin():
    """The truth starts at 7, the track two seconds later at 100: only what happens from there on counts."""
    found = scores.score(
        track([100.0, 101.5, 102.0], start_ns=START_NS + 2 * SECOND), truth([7.0, 7.5, 8.0, 9.0, 10.0])
    )
    # errors 0, 0.5, 0
    assert found == Score(final=pytest.approx(0.0), rms=pytest.approx(math.sqrt(0.25 / 3)), worst=pytest.approx(0.5))


def test_score_outside_the_truth_is_none():
    assert scores.score(track([0.0, 1.0], start_ns=START_NS + 100 * SECOND), truth([0.0, 1.0])) is None


def test_score_ignores_times_without_yaw():
    found = scores.score(track([0.0, math.nan, 2.1]), truth([0.0, 1.0, 2.0]))
    assert found.final == pytest.approx(0.1)


def test_truth_between_its_samples_is_linear_at_nanosecond_stamps():
    middle = np.array([START_NS + SECOND // 2])
    assert scores.yaw_at(truth([0.0, 1.0]), middle)[0] == pytest.approx(0.5, abs=1e-9)


def test_gyro_alone_is_the_trapezoid_and_skips_what_is_not_finite():
    for rates in ([0.0, 1.0, 1.0, 0.0], [1.0, 1.0, math.nan, 1.0]):
        gyro = GyroTrack.of(GyroSample(START_NS + i * SECOND, rate) for i, rate in enumerate(rates))
        assert scores.gyro_alone(gyro).yaw[-1] == pytest.approx(2.0)


def test_tracks_alone_is_the_pose_unwrapped_or_else_the_rate():
    t_ns = START_NS + SECOND * np.arange(4)
    zeros, rate = np.zeros(4), np.full(4, 0.5)
    wrapped = np.array([3.0, -3.0, -2.7, -2.4])
    assert np.ptp(scores.tracks_alone(OdometryTrack(t_ns, rate, zeros, wrapped)).yaw) == pytest.approx(math.tau - 5.4)
    assert scores.tracks_alone(OdometryTrack(t_ns, rate, zeros, zeros)).yaw[-1] == pytest.approx(1.5)
    assert scores.tracks_alone(OdometryTrack(t_ns, rate, zeros, zeros * math.nan)).yaw[-1] == pytest.approx(1.5)


def test_honesty_of_honest_increments_is_one():
    """2000 normal errors: the mean of chi-square(1) strays by sqrt(2 / 2000) = 0.032, the share in 95 % by 0.005."""
    rng = np.random.default_rng(3)
    variance = rng.uniform(1e-6, 1e-4, 2000)
    error = rng.normal(0.0, np.sqrt(variance))
    true = TruthTrack(START_NS + SECOND * np.arange(2001), 4.0 * np.arange(2001.0))  # by 4 rad a second: wraps
    increments = [
        YawIncrement(START_NS + i * SECOND, START_NS + (i + 1) * SECOND, math.remainder(4.0 + e, math.tau), v, 1.0)
        for i, (e, v) in enumerate(zip(error, variance, strict=True))
    ]
    honest = increment_honesty(increments, true)
    assert honest.ratio == pytest.approx(1.0, abs=3 * 0.032)
    assert honest.coverage == pytest.approx(0.95, abs=3 * 0.005)
    bold = increment_honesty([replace(one, variance=one.variance / 4) for one in increments], true)
    assert bold.ratio == pytest.approx(4 * honest.ratio)


# ---------------------------------------------------------------- tables and verdicts


def summary(final: float, rms: float = 1.0) -> Summary:
    return Summary(final, rms, 2.0 * rms, math.nan, math.nan, math.nan, math.nan, math.nan)


def test_verdicts_compare_where_the_paper_errs_and_with_the_best_single():
    summaries = {
        "a": {"rows": summary(20.0), "best": summary(1.0, 0.8), GYRO: summary(3.0, 2.0), FUSED: summary(0.1, 0.4)},
        "b": {"rows": summary(-4.0), "best": summary(-1.0, 0.5), TRACKS: summary(3.0, 0.2), FUSED: summary(0.1, 0.3)},
        "c": {"rows": summary(1.9), "best": summary(5.0, 1.0), FUSED: summary(0.1, 0.3)},
    }
    paper, fused = verdict_lines(summaries, "best")
    assert "(2 drives): 0.150 in the median, 0.250 at worst in b" in paper
    assert "below 1 in 2 of 3, 1.50 at worst in b" in fused


def test_best_single_sensor_is_the_compass_as_it_is_published():
    sources = {"best": summary(0.1, 0.2), COMPASS: summary(0.1, 0.5), GYRO: summary(3.0, 2.0), FUSED: summary(0.1, 0.4)}
    (fused,) = verdict_lines({"a": sources}, "best")
    assert "below 1 in 1 of 1, 0.80 at worst in a" in fused
    assert "informed when its images were exposed, and fused not: below 1 in 0 of 1, 2.00 at worst in a" in fused


class LateImages:
    """A robot that stands for a second, then turns by two columns an image; stamps are 50 ms late."""

    rate = 20.0 * math.tau / 256.0  # rad/s
    exposed = START_NS + np.arange(60) * SECOND // 10
    late = SECOND // 20
    t_ns = START_NS + np.arange(0, 7 * SECOND, SECOND // 20)
    truth = TruthTrack(t_ns, rate * np.clip((t_ns - START_NS) * 1e-9 - 1.0, 0.0, None))
    gyro = GyroTrack.of(())
    odometry = OdometryTrack(np.zeros(0, np.int64), *np.zeros((3, 0)))
    frame_count = exposed.size
    warnings = ()

    def frames(self):
        scene = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 256, (128, 256), np.uint8), (0, 0), 2.0)
        for i, t_ns in enumerate((self.exposed + self.late).tolist()):
            yield Frame(t_ns, np.roll(scene, 2 * max(i - 10, 0), axis=1))


def test_methods_err_by_exposures_and_what_is_published_by_stamps():
    drive = LateImages()
    exposed = dict(zip((drive.exposed + drive.late).tolist(), drive.exposed.tolist(), strict=True))
    tracks = all_tracks(drive, Settings(compass=CompassConfig(columns=256)), exposed_ns=exposed)
    found = {name: scores.score(tracks.yaws[name], drive.truth) for name in ("corners", COMPASS)}
    lag = 0.05 * drive.rate
    assert found["corners"].worst < 0.02 * lag
    assert found[COMPASS].final == pytest.approx(-lag, rel=0.02)
    claimed = [(increment.t_ref_ns, increment.t_ns) for increment in tracks.increments["corners"]]
    assert np.isin(claimed, drive.exposed).all()
    assert COMPASS not in all_tracks(drive, Settings()).yaws  # the same as the method's, by stamps


def test_summary_over_seeds_is_the_root_mean_square_and_the_worst():
    outcomes = [
        Outcome("a", seed, GYRO, Score(final, rms, worst), 2.0, 1.0)
        for seed, (final, rms, worst) in enumerate([(0.03, 0.01, 0.04), (-0.04, 0.02, 0.05)])
    ]
    one = summarise_outcomes(outcomes)["a"][GYRO]
    assert one.final == pytest.approx(math.degrees(math.hypot(0.03, 0.04) / math.sqrt(2)))
    assert one.rms == pytest.approx(math.degrees(math.hypot(0.01, 0.02) / math.sqrt(2)))
    assert one.worst == pytest.approx(math.degrees(0.05))
    assert one.per_m == pytest.approx(one.final / 2.0)
    alone = summarise_outcomes(outcomes[1:])["a"][GYRO]
    assert alone.final == pytest.approx(math.degrees(-0.04))  # the sign of a single drive is kept


def test_tables_show_the_published_figure_and_every_source():
    summaries = {"forward6_passage": {"rows": summary(-23.0), "corners": summary(0.5), FUSED: summary(0.1)}}
    long, short = full_table(summaries, "corners"), short_table(summaries, "corners", "final")
    for text in ("rows (paper's)", "corners (default)", "fused", "-23.00", "0.50", "0.10"):
        assert text in long
        assert text in short
    assert "6.59" in long.splitlines()[2]
    assert "6.59" in short.splitlines()[2]


# ---------------------------------------------------------------- the command


def test_evaluate_scores_a_users_bag_the_same_every_time(tiny_bag, tmp_path, capsys):
    texts = []
    for name in ("a.json", "b.json"):
        assert main(["evaluate", str(tiny_bag), "--json", str(tmp_path / name)]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1]
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    found = json.loads((tmp_path / "a.json").read_text())
    sources = found["summaries_deg"][str(tiny_bag)]
    assert set(sources) == {*METHODS, GYRO, TRACKS, FUSED}
    turned = math.degrees(float(TinyDrive().yaw(TinyDrive().seconds)))
    assert sources[TRACKS]["final"] == pytest.approx(0.2 * turned, abs=1e-6)  # they claim 1.2 of the turn
    assert abs(sources["sectors"]["final"]) < abs(sources[GYRO]["final"])
    assert found["outcomes_rad"][0]["turns"] == pytest.approx(turned / 360.0, abs=0.01)


def test_evaluate_bag_without_truth_names_the_option(tiny_bag, capsys):
    assert main(["evaluate", str(tiny_bag), "--truth-topic", "none"]) == 1
    assert "--truth-topic" in capsys.readouterr().err


def test_evaluate_unknown_experiment_names_the_nearest(capsys):
    assert main(["evaluate", "free_race_pasage"]) == 1
    assert "free_race_passage" in capsys.readouterr().err


def test_evaluate_unknown_worlds_names_those_there_are(capsys):
    assert main(["evaluate", "demo", "--worlds", "ruble"]) == 1
    error = capsys.readouterr().err
    assert "ruble" in error
    assert "held-out, " in error
    assert "rubble" in error


def test_evaluate_scores_the_methods_that_are_asked_for_and_the_configured_one(tiny_bag, tmp_path, capsys):
    path = tmp_path / "a.json"
    assert main(["evaluate", str(tiny_bag), "--methods", "rows", "--json", str(path)]) == 0
    sources = json.loads(path.read_text())["summaries_deg"][str(tiny_bag)]
    assert set(sources) == {"rows", "corners", GYRO, TRACKS, FUSED}
    assert main(["evaluate", str(tiny_bag), "--methods", "rowz"]) == 1
    assert "rowz" in capsys.readouterr().err


def test_evaluate_drives_in_held_out_worlds_unless_told_otherwise(monkeypatch, capsys):
    def outcomes(names, seeds, settings, workers, smooth, worlds, methods):
        held_out = worlds != "tuned"
        score = Score(0.01, 0.02, 0.03) if held_out else Score(0.0, 0.0, 0.0)
        return [
            Outcome(name, seed, FUSED, score, 2.0, 1.0, world="rubble" if held_out else "0", held_out=held_out)
            for name in names
            for seed in seeds
        ]

    monkeypatch.setattr(command, "evaluate_experiments", outcomes)
    lines = {}
    for worlds in ([], ["--worlds", "tuned"], ["--worlds", "all"]):
        assert main(["evaluate", "demo", "weave", "--seeds", "2", *worlds]) == 0
        text = capsys.readouterr().out
        lines[" ".join(worlds)] = [line.split() for line in text.splitlines() if line.startswith(("rubble", "own"))]
    rubble, own = ["rubble", "4", "1.15"], ["own", "place", "(tuned)", "4", "0.00"]
    assert lines == {"": [rubble], "--worlds tuned": [own], "--worlds all": [own, rubble]}


# ---------------------------------------------------------------- GPS


def drive_with_fixes(noise: float = 0.0):
    """600 s at 1 m/s, straight for 50 s and then a turn of 90 deg in 10 s; a fix twice a second."""
    t = np.arange(0.0, 600.0, 0.1)
    yaw = np.concatenate([[0.0], np.cumsum(0.1 * np.where(t[:-1] % 60.0 < 50.0, 0.0, math.pi / 20))])
    east, north = np.cumsum(0.1 * np.cos(yaw)), np.cumsum(0.1 * np.sin(yaw))
    t_ns = START_NS + np.round(t * 1e9).astype(np.int64)
    rng = np.random.default_rng(4)
    fixes = [t_ns[::5], *(place[::5] + rng.normal(0.0, noise, t[::5].size) for place in (east, north))]
    zeros = np.zeros(t.size)
    return YawTrack(t_ns, yaw), fixes, OdometryTrack(t_ns, zeros, zeros + 1.0, zeros)


@pytest.mark.parametrize("start_deg", [0.0, 60.0, 180.0, -120.0])
@pytest.mark.parametrize("slope", [0.0, 0.002, -0.001])
def test_gps_drift_is_found_whatever_the_start(slope, start_deg):
    yaw, fixes, odometry = drive_with_fixes()
    seconds = (yaw.t_ns - yaw.t_ns[0]) * 1e-9
    drifting = YawTrack(yaw.t_ns, yaw.yaw + math.radians(start_deg) + slope * seconds)
    found = gps.drift(drifting, gps.chords(*fixes, odometry))
    # The course of a chord and the mean yaw along it differ by nothing on the straight, the median's choice.
    assert found.slope == pytest.approx(slope, abs=1e-5)
    assert found.low <= found.slope <= found.high


def test_gps_drift_of_noisy_fixes_is_inside_its_interval():
    """0.3 m of noise on chords of 5 m is 0.085 rad each; over some 1000 overlapping ones the slope is still known."""
    yaw, fixes, odometry = drive_with_fixes(noise=0.3)
    found = gps.drift(
        YawTrack(yaw.t_ns, yaw.yaw + 1e-3 * (yaw.t_ns - yaw.t_ns[0]) * 1e-9), gps.chords(*fixes, odometry)
    )
    assert found.high - found.low < 1e-3
    assert abs(found.slope - 1e-3) < 2 * (found.high - found.low)


def test_gps_chords_need_forward_driving():
    _, fixes, odometry = drive_with_fixes()
    assert gps.chords(*fixes, odometry).course.size > 500
    backward = OdometryTrack(odometry.t_ns, odometry.yaw_rate, -odometry.speed, odometry.yaw)
    assert gps.chords(*fixes, backward).course.size == 0


def test_evaluate_husky_against_its_gps(capsys):
    """Fused drifts no more than the better of gyro and wheels."""
    if not HUSKY.exists():
        pytest.skip("needs ../shared/data/husky.bag")
    assert main(["evaluate", str(HUSKY)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if ".." in line]
    drifts = {line[:12].strip(): abs(float(line[12:].split()[0])) for line in lines}
    assert drifts[FUSED] <= min(drifts[GYRO], drifts[TRACKS])


def test_summary_gives_errors_in_degrees(tiny_bag):
    with Bag(tiny_bag) as bag:
        recording = read_recording(bag, choose_topics(bag, Settings().topics), Settings().imu, 256)
        run = fuse_recording(recording, Settings())
        summary = summarise(run, recording)["yaw"]
    for name, score in scores.scores(run).items():
        for key in ("final", "rms", "worst"):
            assert summary[key_of(name)][f"{key}_error_deg"] == pytest.approx(
                math.degrees(getattr(score, key)), abs=1e-3
            )
    # the gyro's bias of 0.01 rad/s over 3 s, 1.7 deg at the end: of a straight line the RMS is 1 / sqrt(3)
    gyro = summary[key_of(GYRO)]
    assert gyro["final_error_deg"] == pytest.approx(math.degrees(0.03), rel=1e-3)
    assert gyro["rms_error_deg"] == pytest.approx(math.degrees(0.03) / math.sqrt(3.0), rel=0.02)
