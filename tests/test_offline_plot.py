"""Plots and scores of runs in which there is little or nothing to show: the results stand all the same."""

import dataclasses
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from tiny_bags import START_NS, TinyBag, TinyDrive

from fusion.offline import plot
from fusion.offline.cli import main
from fusion.offline.curves import thinned
from fusion.offline.earlier_results import ALWAYS, OPTIONAL
from fusion.offline.fuse_bag import fuse_bag
from fusion.offline.scores import COMPASS, FUSED, TRACKS, YawTrack, errors
from fusion.offline.streams import TruthTrack
from fusion.settings import Settings

DRIVE = TinyDrive(seconds=1.5, width=64)
NAN = math.nan
HOUR_NS = 3600 * 10**9

Write = Callable[[TinyBag, int, float, float], None]  # bag, stamp (ns), turn rate, yaw


def nothing(*_: Any) -> None:
    """Leave the topic out."""


def once(write: Write) -> Write:
    """Only the first message."""
    done: list[bool] = []

    def first(*arguments: Any) -> None:
        if not done:
            write(*arguments)
        done.append(True)

    return first


def imu(bag: TinyBag, t_ns: int, rate: float, _: float) -> None:
    bag.imu("/imu/data", t_ns, rate)


def odom(bag: TinyBag, t_ns: int, rate: float, yaw: float) -> None:
    bag.odometry("/odom", t_ns, yaw, rate)


def truth(bag: TinyBag, t_ns: int, rate: float, yaw: float) -> None:
    bag.odometry("/ground_truth/odom", t_ns, yaw, rate)


def image(bag: TinyBag, t_ns: int, _: float, __: float) -> None:
    bag.compressed("/pano/compressed", t_ns, DRIVE.panorama((t_ns - START_NS) * 1e-9))


def blank(bag: TinyBag, t_ns: int, _: float, __: float) -> None:
    bag.compressed("/pano/compressed", t_ns, np.zeros((32, 64), np.uint8))


def now_and_then(yaw: float, t_ns: int) -> float:
    return NAN if (t_ns // 10**8) % 3 == 0 else yaw


CASES: dict[str, tuple[dict[str, Write], bool]] = {  # what is written otherwise, and whether a source can be scored
    "gyro nan": ({"imu": lambda b, t, r, y: imu(b, t, NAN, y)}, True),
    "gyro infinite": ({"imu": lambda b, t, r, y: imu(b, t, math.inf, y)}, True),
    "gyro of 1e300": ({"imu": lambda b, t, r, y: imu(b, t, 1e300, y)}, True),
    "gyro nan, alone": (
        {"imu": lambda b, t, r, y: imu(b, t, NAN, y), "odom": nothing, "image": nothing, "truth": nothing},
        False,
    ),
    "gyro and tracks nan": (
        {
            "imu": lambda b, t, r, y: imu(b, t, NAN, y),
            "odom": lambda b, t, r, y: odom(b, t, NAN, NAN),
            "image": nothing,
        },
        True,
    ),
    "truth of another hour": ({"truth": lambda b, t, r, y: truth(b, t + HOUR_NS, r, y)}, False),
    "truth of one message": ({"truth": once(truth)}, False),
    "truth of one stamp": ({"truth": lambda b, t, r, y: truth(b, START_NS + 10**9, r, y)}, False),
    "truth nan": ({"truth": lambda b, t, r, y: truth(b, t, r, NAN)}, False),
    "truth nan at first": ({"truth": lambda b, t, r, y: truth(b, t, r, NAN if t < START_NS + 10**9 else y)}, True),
    "truth nan now and then": ({"truth": lambda b, t, r, y: truth(b, t, r, now_and_then(y, t))}, True),
    "one imu": ({"imu": once(imu), "odom": nothing, "image": nothing, "truth": nothing}, False),
    "one odometry": ({"imu": nothing, "odom": once(odom), "image": nothing, "truth": nothing}, False),
    "one image": ({"imu": nothing, "odom": nothing, "image": once(image), "truth": nothing}, False),
    "one of each": ({"imu": once(imu), "odom": once(odom), "image": once(image), "truth": once(truth)}, False),
    "blank images": ({"imu": nothing, "odom": nothing, "image": blank}, False),
    "blank images, no truth": ({"imu": nothing, "odom": nothing, "image": blank, "truth": nothing}, False),
}


NOTHING_MEASURED = ("gyro nan, alone", "gyro and tracks nan")  # and no image: there is nothing to show


def write_case(path: Path, **otherwise: Write) -> Path:
    writers = {"imu": imu, "odom": odom, "truth": truth, "image": image} | otherwise
    hertz = {"imu": 100.0, "odom": 20.0, "truth": 20.0, "image": 10.0}
    events = sorted((t, kind) for kind, rate in hertz.items() for t in DRIVE.times(rate))
    with TinyBag(path) as bag:
        for t, kind in events:
            writers[kind](bag, START_NS + round(t * 1e9), float(DRIVE.turn_rate(t)), float(DRIVE.yaw(t)))
    return path


@pytest.mark.parametrize("case", CASES)
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")  # the squares of 1e300
def test_fuse_and_evaluate_stand_where_there_is_little_to_show(tmp_path, case, capsys):
    otherwise, can_be_scored = CASES[case]
    path = write_case(tmp_path / "bag", **otherwise)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # matplotlib's complaints about empty legends and axes
        code = main(["fuse", str(path), "--out", str(tmp_path / "out"), "--smooth"])
    if case in NOTHING_MEASURED:
        assert code == 1
        assert "no sample was usable" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
        return
    assert code == 0
    written = {file.name for file in (tmp_path / "out").iterdir()}
    assert set(ALWAYS) <= written <= {*ALWAYS, *OPTIONAL}
    assert all((tmp_path / "out" / name).stat().st_size for name in written)
    assert cv2.imread(str(tmp_path / "out" / "yaw.png")).shape[0] > 300
    capsys.readouterr()
    assert main(["evaluate", str(path)]) == (0 if can_be_scored else 1)
    out, err = capsys.readouterr()
    assert (err.count("\n"), bool(out)) == ((0, True) if can_be_scored else (1, False))
    if can_be_scored:
        assert "final" in out


def axis_of(draw: Callable[..., None], *arguments: Any) -> Any:
    axis = Figure().subplots()
    draw(axis, *arguments)
    return axis


def times(count: int) -> np.ndarray:
    return START_NS + np.arange(count) * 10**8


def test_plot_of_a_sigma_that_diverges_keeps_to_the_yaw():
    t_ns = times(100)
    yaw = np.radians(np.linspace(0.0, 0.5, 100))
    for sigma in (np.geomspace(1e-3, 1e6, 100), np.full(100, 1e6), np.full(100, np.inf), np.full(100, NAN)):
        axis = axis_of(plot._deviations, {FUSED: YawTrack(t_ns, yaw, sigma)}, plot._Clock(START_NS))
        assert 0.5 <= axis.get_ylim()[1] <= 4.5 * 0.5
    narrow = axis_of(plot._deviations, {FUSED: YawTrack(t_ns, yaw, np.full(100, 0.01))}, plot._Clock(START_NS))
    assert narrow.get_ylim()[1] == pytest.approx(1.1 * math.degrees(0.02))  # the whole band


def test_plot_of_numbers_that_are_none_has_an_axis():
    t_ns = times(10)
    for value in (NAN, math.inf, 1e300, 0.0):
        tracks = {
            FUSED: YawTrack(t_ns, np.full(10, value), np.full(10, NAN)),
            COMPASS: YawTrack(t_ns, np.full(10, NAN)),
        }
        low, high = axis_of(plot._deviations, tracks, plot._Clock(START_NS)).get_ylim()
        assert -math.inf < low < high < math.inf
        band = t_ns, np.full(10, value), np.ones(10)
        low, high = axis_of(plot._learnt, plot._Clock(START_NS), band, "k", "x").get_ylim()
        assert -math.inf < low < high < math.inf


def test_plot_of_a_learnt_state_whose_sigma_grows_at_the_end_shows_the_state():
    sigma = np.concatenate([np.full(90, 0.1), np.geomspace(0.1, 1e6, 10)])
    for growing in (sigma, np.concatenate([np.full(40, 0.1), np.geomspace(0.1, 1e6, 60)])):
        band = times(100), np.ones(100), growing
        low, high = axis_of(plot._learnt, plot._Clock(START_NS), band, "k", "x").get_ylim()
        assert (low, high) == (pytest.approx(0.7, abs=1e-3), pytest.approx(1.3, abs=1e-3))


def test_plot_of_a_runaway_sensor_and_a_diverging_sigma_shows_the_good_ones():
    """Without truth the fused yaw is the line at zero: only the compass says how large the panel must be."""
    t_ns = times(100)
    tracks = {
        FUSED: YawTrack(t_ns, np.zeros(100), np.geomspace(1e-3, 1e6, 100)),
        COMPASS: YawTrack(t_ns, np.radians(np.linspace(0.0, 0.5, 100))),
        TRACKS: YawTrack(t_ns, np.radians(np.linspace(0.0, 400.0, 100))),
    }
    assert 0.5 <= axis_of(plot._deviations, tracks, plot._Clock(START_NS)).get_ylim()[1] <= 4.5 * 0.5


def test_plot_thinned_keeps_the_spike_of_one_sample():
    values = np.zeros(100_000)
    values[41_234], values[77_777] = 5.0, -3.0
    values[500:600] = NAN
    kept = thinned(values, 2000)
    assert kept.size <= 2000
    assert (np.diff(kept) > 0).all()
    assert (kept[0], kept[-1]) == (0, values.size - 1)
    assert {41_234, 77_777} <= set(kept.tolist())
    assert thinned(values[:7], 2000).tolist() == list(range(7))


@pytest.mark.parametrize("name", ["\u8d70\u884c\u8a18\u9332", "cost $5 and $a_b", "\ud55c\uad6d\uc5b4 \U0001f916"])
def test_plot_of_a_bag_with_a_foreign_name_complains_of_nothing(name, tmp_path):
    path = tmp_path / name
    write_case(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["fuse", str(path), "--out", str(tmp_path / "out")]) == 0
    assert cv2.imread(str(tmp_path / "out" / "yaw.png")).shape[0] > 300


def test_plot_cuts_no_legend_off(tmp_path, tiny_bag):
    """White at the margins: nothing reaches over the edge, however long a legend is."""
    run = fuse_bag(tiny_bag, tmp_path / "out", Settings()).run
    far = YawTrack(run.truth.t_ns, run.truth.yaw * 1e7 / np.abs(run.truth.yaw).max())
    plot.plot_run(dataclasses.replace(run, truth=TruthTrack(far.t_ns, far.yaw)), tmp_path / "yaw.png", "x")
    picture = cv2.imread(str(tmp_path / "yaw.png"))
    for edge in (picture[:3], picture[-3:], picture[:, :3], picture[:, -3:]):
        assert (edge == 255).all()


def test_plot_of_rows_without_any_usable_number_is_a_picture(tmp_path):
    fused = fuse_bag(write_case(tmp_path / "bag"), tmp_path / "out", Settings())
    run = fused.run
    for change in (
        {"yaw": NAN, "yaw_variance": NAN},
        {"yaw_variance": 1e30, "gyro_bias_variance": -1.0, "track_scale_variance": math.inf},
    ):
        run.rows = [dataclasses.replace(r, fused=r.fused and dataclasses.replace(r.fused, **change)) for r in run.rows]
        plot.plot_run(run, tmp_path / "x.png", "nothing")
        assert cv2.imread(str(tmp_path / "x.png")).shape[0] > 300


def test_errors_leave_out_what_the_truth_does_not_know():
    t_ns = times(6)
    known = TruthTrack(t_ns, np.array([NAN, 0.0, 0.1, NAN, 0.3, 0.4]))
    found = errors(YawTrack(t_ns, np.array([0.0, 0.0, 0.1, 0.2, 0.3, 0.5]), np.arange(6.0)), known)
    np.testing.assert_allclose(found.yaw, [0.0, 0.0, 0.0, 0.1], atol=1e-15)
    np.testing.assert_array_equal(found.t_ns, t_ns[[1, 2, 4, 5]])
    np.testing.assert_array_equal(found.sigma, [1.0, 2.0, 4.0, 5.0])
    assert errors(YawTrack(t_ns, np.zeros(6)), TruthTrack(t_ns, np.full(6, NAN))) is None
