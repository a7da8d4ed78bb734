"""What `inspect` says of a bag, sound or faulty."""

import itertools
import math

import cv2
import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag

from compass import CompassConfig
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
