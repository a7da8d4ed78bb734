"""What `inspect` says of a bag, sound or faulty."""

import itertools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from reported_bags import Imu, Picture, changed, messages, write
from tiny_bags import START_NS, TinyBag

from compass import CompassConfig
from fusion.offline import first_minute
from fusion.offline.bag import BagError
from fusion.offline.inspect import draw_region, inspect_bag, timing
from fusion.settings import Settings


def cells(report: str, topic: str) -> dict[str, str]:
    """The table's line of a topic by the header above it."""
    lines = report.splitlines()
    edges = [0]
    for dashes in lines[1].split("  "):
        edges.append(edges[-1] + len(dashes) + 2)
    spans = list(itertools.pairwise(edges))
    line = next(line for line in lines if line.startswith(topic + " ")).ljust(edges[-1])
    return {lines[0].ljust(edges[-1])[a:b].strip(): line[a:b].strip() for a, b in spans}


def test_inspect_sound_bag_shows_rates_size_and_choice(tiny_bag):
    report = inspect_bag(tiny_bag, Settings())
    imu = cells(report, "/imu/data")
    assert (imu["type"], imu["count"], imu["Hz"], imu["longest gap s"]) == ("sensor_msgs/Imu", "301", "100.0", "0.010")
    assert imu["backward"] == imu["repeated"] == imu["zero stamps"] == ""
    assert cells(report, "/viz/pano/image/compressed")["Hz"] == "10.0"
    assert "/viz/pano/image/compressed: 256 x 128 compressed\n" in report
    assert "gyro: /imu/data, tracks: /odom, truth: /ground_truth/odom" in report


def test_inspect_faulty_stamps_are_counted(tmp_path):
    milliseconds = [0, 10, 20, 20, 15, 30, 530]
    with TinyBag(tmp_path / "b") as bag:
        for ms in milliseconds:
            bag.imu("/imu/data", START_NS + ms * 1_000_000, 0.0)
        bag.imu("/imu/data", 0, 0.0)
    imu = cells(inspect_bag(tmp_path / "b", Settings()), "/imu/data")
    assert (imu["longest gap s"], imu["backward"], imu["repeated"], imu["zero stamps"]) == ("0.500", "1", "1", "1")


def test_inspect_tells_what_would_stop_fuse(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.imu("/imu/a", START_NS, 0.0)
        bag.imu("/imu/b", START_NS, 0.0)
        bag.write("/chatter", bag.make("std_msgs/msg/String", data="no header, no stamp"))
    report = inspect_bag(tmp_path / "b", Settings())
    assert "fuse would stop" in report
    assert "--gyro-topic" in report
    assert cells(report, "/chatter")["Hz"] == ""


def test_inspect_narrow_and_unusable_images_are_remarked(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.image("/narrow", START_NS, np.zeros((48, 64), np.uint8))
        bag.image("/odd", START_NS, np.zeros((8, 16), np.uint8), "odd8")
    report = inspect_bag(tmp_path / "b", Settings())
    assert "/narrow: 64 x 48 mono8; not as wide as a full circle" in report
    assert "/odd: no usable image: encoding 'odd8' is unknown" in report


def test_inspect_preview_shows_the_region_bright_and_the_rest_dark(tiny_bag, tmp_path):
    inspect_bag(tiny_bag, Settings(), roi_preview=tmp_path / "roi.png")
    picture = cv2.imread(str(tmp_path / "roi.png"))
    assert picture.shape == (128, 256, 3)
    top, bottom = round(Settings().compass.roi_top * 128), round(Settings().compass.roi_bottom * 128)
    # Left of the labels and of the forward line, one row clear of the borders: one third of the brightness outside.
    inside, outside = picture[top + 2 : bottom - 2, :50].mean(), picture[bottom + 2 : 100, :50].mean()
    assert inside / outside == pytest.approx(3.0, abs=0.3)


def test_inspect_preview_draws_the_forward_column():
    grey = np.full((128, 256), 90, np.uint8)
    picture = draw_region(grey, CompassConfig(forward_column=0.25)).astype(int)
    coloured = np.flatnonzero(np.ptp(picture[100], axis=1) > 20)
    assert coloured.tolist() == [64]


def test_inspect_preview_without_images_is_refused(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.imu("/imu/data", START_NS, 0.0)
    with pytest.raises(BagError, match="--roi-preview needs a topic of images"):
        inspect_bag(tmp_path / "b", Settings(), roi_preview=tmp_path / "roi.png")
    assert not (tmp_path / "roi.png").exists()


def test_timing_single_message_has_no_rate():
    found = timing(np.array([START_NS]), np.array([START_NS + 5_000_000]))
    assert math.isnan(found.rate_hz)
    assert found.delay_s == pytest.approx(0.005)


# ---------------------------------------------------------------- what fuse would stumble over


def report_of(path, *topics: tuple[str, list[int]]) -> str:
    """Inspect a bag of topics with these stamps, ns."""
    with TinyBag(path) as bag:
        for name, stamps in topics:
            for t_ns in stamps:
                if name.startswith("/imu"):
                    bag.imu(name, t_ns, 0.0)
                else:
                    bag.odometry(name, t_ns, 0.0, 0.0)
    return inspect_bag(path, Settings())


def found(report: str) -> list[str]:
    return [line.removeprefix("problem: ") for line in report.splitlines() if line.startswith("problem: ")]


def every(ms: int, count: int = 50, start_ns: int = START_NS) -> list[int]:
    return [start_ns + i * ms * 10**6 for i in range(count)]


def test_inspect_sound_bag_has_no_problem(tiny_bag, tmp_path):
    assert found(inspect_bag(tiny_bag, Settings())) == []
    # sensors that start and stop at different times, all since power-up, are none either
    stamps = [("/imu/data", every(10, 50, 10**9)), ("/odom", every(10, 50, 10**9 + 4 * 10**8))]
    assert found(report_of(tmp_path / "b", *stamps)) == []


def test_inspect_stamps_since_power_up_beside_dates_are_told(tmp_path):
    report = report_of(tmp_path / "b", ("/imu/data", every(10, 50, 2128 * 10**9)), ("/odom", every(10)))
    (problem,) = found(report)
    assert "no time in common" in problem
    assert "/imu/data from 2128.0 to 2128.5 s (since power-up" in problem
    assert "/odom from 2023-11-14 22:13:20 to 2023-11-14 22:13:20" in problem


def test_inspect_topics_an_hour_apart_are_told_but_not_for_one_wrong_stamp(tmp_path):
    later = START_NS + 3600 * 10**9
    (problem,) = found(report_of(tmp_path / "a", ("/imu/data", every(10)), ("/odom", every(10, 50, later))))
    assert "no time in common" in problem
    (problem,) = found(report_of(tmp_path / "b", ("/imu/data", [*every(10), 5]), ("/odom", every(10, 60))))
    assert problem == "/imu/data: 1 stamps are more than a day from the others"
    # one stamp of the right time does not make two topics overlap
    wrong = [*every(10, 60, 2128 * 10**9), START_NS]
    assert any(
        "no time in common" in p for p in found(report_of(tmp_path / "c", ("/imu", wrong), ("/odom", every(10))))
    )


def test_inspect_stamps_never_set_or_repeated_are_told(tmp_path):
    report = report_of(tmp_path / "b", ("/imu/data", [0, 0, *every(10)]), ("/odom", [START_NS] * 20))
    assert found(report) == [
        "/imu/data: 2 stamps were never set; they are left out",
        "/odom: 19 of 20 stamps repeat the one before; they are no times of capture",
    ]


@pytest.mark.parametrize("recorded_ns", [0, -5, 2**63 - 1, 2**63 - 2, 2**64 - 5, -(2**63) + 7, 7_300_000_000 * 10**9])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_inspect_record_times_that_cannot_be_are_told(tmp_path, storage, recorded_ns):
    if (storage == "mcap" and recorded_ns < 0) or (storage == "sqlite3" and recorded_ns >= 2**63):
        pytest.skip("the format has no such number")
    with TinyBag(tmp_path / "b", storage=storage) as bag:
        for i in range(3):
            bag.recorded_ns = recorded_ns - 1000 if i == 1 else START_NS + 5_000_000
            bag.imu("/imu/data", START_NS, 0.0)
    report = inspect_bag(tmp_path / "b", Settings())
    assert cells(report, "/imu/data")["delay s"] == "0.005"
    assert any("/imu/data: 1 record times cannot be" in problem for problem in found(report))


def test_inspect_tells_the_faults_of_the_files(tmp_path):
    with TinyBag(tmp_path / "b") as bag:
        bag.imu("/imu/data", START_NS, 0.0)
    (tmp_path / "b" / "metadata.yaml").unlink()
    assert ["metadata.yaml is missing" in problem for problem in found(inspect_bag(tmp_path / "b", Settings()))] == [
        True
    ]


SHAPES = {
    "nothing wrong": (lambda m: m, ""),
    "mirrored": (lambda m: replace(m, pixels=m.pixels[:, ::-1]) if isinstance(m, Picture) else m, "images_mirrored"),
    "the circle twice": (
        lambda m: replace(m, pixels=np.hstack([m.pixels[:, :128]] * 2)) if isinstance(m, Picture) else m,
        "not_full_circle",
    ),
    "in deg/s": (
        lambda m: replace(m, rate=tuple(map(math.degrees, m.rate))) if isinstance(m, Imu) else m,
        "gyro_units",
    ),
    "in g": (
        lambda m: replace(m, force=tuple(x / 9.81 for x in m.force)) if isinstance(m, Imu) else m,
        "accelerometer_units",
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_inspect_names_what_fuse_would_find_in_the_first_minute(tmp_path, shape):
    change, code = SHAPES[shape]
    report = inspect_bag(write(tmp_path / "b", changed(messages(), change)), Settings())
    told = [line for line in report.splitlines() if line.startswith("problem: ")]
    assert any(f"[{code}, " in line for line in told) == bool(code), told
    assert bool(told) == bool(code)


def test_inspect_looks_no_longer_than_at_the_first_images(tmp_path, monkeypatch):
    monkeypatch.setattr(first_minute, "MOST_IMAGES", 10)  # of 1.2 s, in which nothing turns
    change, _ = SHAPES["mirrored"]
    assert "problem" not in inspect_bag(write(tmp_path / "b", changed(messages(), change)), Settings())
