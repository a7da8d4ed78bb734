"""Keyframes: while the view stays, the reference stays, and errors do not add up."""

import math

import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, START_NS, as_bytes, scene, show, turned

from compass import CompassConfig, CompassStatus, VisualCompass, wrap_angle

WIDTH, NOISE = 1024, 2.0
PER_PX = math.tau / WIDTH


@pytest.fixture(scope="module")
def panorama():
    return scene(1, WIDTH, 96)


def bound(image):
    """Cramer-Rao bound, rad, of a turn between two images of this noise."""
    region = image[24:53].astype(np.float64)  # 0.25 and 0.55 of 96 rows
    gradient = 0.5 * (np.roll(region, -1, axis=1) - np.roll(region, 1, axis=1))
    return math.sqrt(2.0 * (NOISE**2 + 1.0 / 12.0) / float((gradient**2).sum())) * PER_PX


def increments_of(compass, panorama, yaws, seed=0):
    frames = (as_bytes(turned(panorama, yaw), NOISE, seed + index) for index, yaw in enumerate(yaws))
    return [compass.update(START_NS + index * FRAME_NS, frame) for index, frame in enumerate(frames)]


@pytest.mark.parametrize("yaw", [0.0, math.radians(60), math.pi, math.radians(-120), math.pi - 1e-6, 1e-6 - math.pi])
def test_robot_that_stands_does_not_drift(panorama, yaw):
    compass = VisualCompass()
    given = increments_of(compass, panorama, [yaw] * 60)
    assert {increment.t_ref_ns for increment in given[1:]} == {START_NS}
    # each is one comparison with the first image, whose noise they share: 5 sigmas of 1.5 bounds, from first to last
    assert max(abs(increment.yaw) for increment in given[1:]) < 5.0 * 1.5 * bound(panorama)
    assert abs(compass.yaw) < 5.0 * 1.5 * bound(panorama)
    assert compass.yaw_variance == given[-1].variance


def test_turn_on_the_spot_keeps_its_reference_and_ends_where_it_began(panorama):
    there = np.linspace(0.0, 2.0 * math.tau, 60)
    yaws = np.concatenate([there, there[::-1]])
    compass = VisualCompass()
    given = increments_of(compass, panorama, yaws)
    assert {increment.t_ref_ns for increment in given[1:]} == {START_NS}
    for yaw, increment in zip(yaws[1:], given[1:], strict=True):
        assert abs(wrap_angle(increment.yaw - yaw)) < 5.0 * 1.5 * bound(panorama)
    assert compass.yaw == pytest.approx(0.0, abs=5.0 * 1.5 * bound(panorama))
    assert compass.yaw_variance == given[-1].variance  # of one comparison, after 119


def test_yaw_after_turns_on_the_spot_is_no_worse_than_after_one_frame(panorama):
    ends = []
    for seed in range(8):
        compass = VisualCompass()
        increments_of(compass, panorama, np.linspace(0.0, math.tau, 37), seed=1000 * seed)
        ends.append(compass.yaw - math.tau)
    rms = float(np.sqrt(np.mean(np.square(ends))))
    # 36 summed steps would err by sqrt(36) bounds; one comparison by 1.5 at most. chi-square of 8: rms < 1.6 sigma
    assert rms < 1.6 * 1.5 * bound(panorama)


def test_no_spread_allowed_compares_each_image_with_the_one_before(panorama):
    compass = VisualCompass(CompassConfig(keyframe_spread=0.0))
    given = increments_of(compass, panorama, np.linspace(0.0, 1.0, 12))
    assert [increment.t_ref_ns for increment in given[1:]] == [START_NS + i * FRAME_NS for i in range(11)]
    assert compass.yaw == pytest.approx(sum(increment.yaw for increment in given[1:]), abs=1e-12)
    assert compass.yaw_variance == pytest.approx(sum(increment.variance for increment in given[1:]), rel=1e-9)


@pytest.mark.parametrize("method", ["rows", "sectors"])
def test_method_that_knows_no_spread_compares_with_the_image_before(panorama, method):
    given = increments_of(VisualCompass(CompassConfig(method=method)), panorama, np.linspace(0.0, 1.0, 12))
    assert [increment.t_ref_ns for increment in given[1:]] == [START_NS + i * FRAME_NS for i in range(11)]


def driven(image, push_px):
    """The scene after a step forward: what is to the left moves left, to the right right, by push_px abeam."""
    width = image.shape[1]
    column = np.arange(width, dtype=np.float32)
    azimuth = -(column / width - 0.5) * math.tau
    source = np.tile(column + push_px * np.sin(azimuth), (image.shape[0], 1)).astype(np.float32)
    row = np.repeat(np.arange(image.shape[0], dtype=np.float32)[:, None], width, axis=1)
    return cv2.remap(image, source, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)


def test_reference_moves_to_the_last_good_image_when_the_robot_drives(panorama):
    compass = VisualCompass()
    frames = [as_bytes(driven(panorama, 1.5 * index), NOISE, index) for index in range(16)]
    given = [compass.update(START_NS + index * FRAME_NS, frame) for index, frame in enumerate(frames)]
    references = [increment.t_ref_ns for increment in given[1:]]
    assert references == sorted(references)  # never back
    assert 2 < len(set(references)) < 15  # moved, but not with each image
    for reference, increment in zip(references, given[1:], strict=True):
        assert reference in {START_NS, *(other.t_ns for other in given[1:])}
        assert reference < increment.t_ns
    # the last increment of each reference, one after the other, is the yaw
    last = {increment.t_ref_ns: increment for increment in given[1:]}
    chain = list(last.values())
    assert [one.t_ns for one in chain[:-1]] == [one.t_ref_ns for one in chain[1:]]
    assert compass.yaw == pytest.approx(sum(increment.yaw for increment in chain), abs=1e-12)
    assert compass.yaw_variance == pytest.approx(sum(increment.variance for increment in chain), rel=1e-9)


@pytest.mark.parametrize("dark_frames", [1, 5, 30])
@pytest.mark.parametrize("method", ["sectors", "corners"])
def test_dark_gap_is_bridged(panorama, method, dark_frames):
    compass = VisualCompass(CompassConfig(method=method))
    black = np.zeros((96, WIDTH), np.uint8)
    lit = [as_bytes(turned(panorama, yaw), NOISE, index) for index, yaw in enumerate((0.0, 0.1, 0.6, 0.7))]
    show(compass, *lit[:2], *[black] * dark_frames, *lit[2:])
    assert compass.counts == {
        CompassStatus.FIRST_FRAME: 1,
        CompassStatus.OK: 3,
        CompassStatus.NO_TEXTURE: dark_frames,
    }
    # up to three comparisons in a chain, 2.1 times the bound each for medians, and a few thousandths of a column
    error = 5.0 * math.sqrt(3.0) * 2.1 * bound(panorama) + 0.004 * PER_PX
    assert compass.yaw == pytest.approx(0.7, abs=error)


def test_increment_after_a_dark_gap_reaches_back_over_it(panorama):
    compass = VisualCompass()
    black = np.zeros((96, WIDTH), np.uint8)
    first, last = (as_bytes(turned(panorama, yaw), NOISE, index) for index, yaw in enumerate((0.0, 0.5)))
    increment = show(compass, first, black, black, last)
    assert (increment.t_ref_ns, increment.t_ns) == (START_NS, START_NS + 3 * FRAME_NS)
    assert increment.yaw == pytest.approx(0.5, abs=5.0 * 1.5 * bound(panorama))
