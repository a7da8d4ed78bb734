"""The compass as its users meet it: images in, turns out, from every start."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from panoramas import FRAME_NS, START_NS, STARTS, as_bytes, compare, scene, shifted, show, turned

from compass import CompassConfig, CompassStatus, VisualCompass, wrap_angle

METHODS = ("rows", "sectors", "corners")
WIDTH = 1024
PER_PX = math.tau / WIDTH
# Noiseless frames rolled by whole columns hold the very same numbers: what remains is float32's rounding in sums over
# 29 rows and the interpolation of a peak that is symmetric. A thousandth of a column is far above both.
EXACT = 1e-3 * PER_PX


@pytest.fixture(params=METHODS)
def method(request):
    return request.param


@pytest.fixture(params=STARTS.values(), ids=STARTS)
def start(request):
    return request.param


@cache
def panorama(start=0.0, seed=1):
    """A drawn scene as it looks from a robot that stands at `start` rad."""
    return turned(scene(seed, WIDTH, 96), start)


def rounding_sigma(image, top=0.25, bottom=0.55, noise=0.0):
    """Cramer-Rao bound, rad, of the turn between two images with the noise of rounding to 8 bits and of a camera."""
    region = image[round(top * image.shape[0]) : round(bottom * image.shape[0])].astype(np.float64)
    gradient = np.gradient(np.pad(region, ((0, 0), (1, 1)), mode="wrap"), axis=1)[:, 1:-1]
    return math.sqrt(2.0 * (noise**2 + 1.0 / 12.0) / float((gradient**2).sum())) * math.tau / image.shape[1]


def tolerance(method, image, noise=0.0):
    """Five sigmas of a turn by a part of a column: whole columns of rows, the bound else (2.1 times it for medians).

    The bound is passed by a half where sectors alone speak; their interpolation errs by a few thousandths of a column.
    """
    if method == "rows":
        return 0.5 * PER_PX
    return 5.0 * 2.1 * rounding_sigma(image, noise=noise) + 0.004 * PER_PX


def test_scene_moving_right_is_a_turn_to_the_left(method, start):
    compass = VisualCompass(CompassConfig(method=method))
    image = as_bytes(panorama(start))
    assert compare(compass, image, np.roll(image, 16, axis=1)).yaw == pytest.approx(16 * PER_PX, abs=EXACT)
    assert compass.yaw == pytest.approx(math.radians(5.625), abs=EXACT)
    assert compare(compass, image, np.roll(image, -16, axis=1)).yaw == pytest.approx(-16 * PER_PX, abs=EXACT)
    assert compass.yaw == pytest.approx(-math.radians(5.625), abs=EXACT)


@pytest.mark.parametrize("columns", [-14.222, -0.5, -0.03, 0.03, 0.25, 0.5, 7.77, 33.333])
def test_turn_by_part_of_a_column(method, start, columns):
    image = panorama(start)
    yaw = compare(VisualCompass(CompassConfig(method=method)), as_bytes(image), as_bytes(shifted(image, columns))).yaw
    assert yaw == pytest.approx(columns * PER_PX, abs=tolerance(method, image))


def test_three_turns_count_1080_degrees_and_back_0(method, start):
    steps = 24  # 15 deg a frame, 42.67 columns
    circle = [as_bytes(turned(panorama(start), index * math.tau / steps)) for index in range(steps)]
    frames = [*circle * 3, circle[0]]
    compass = VisualCompass(CompassConfig(method=method))
    show(compass, *frames)
    # rows have whole columns: each of 72 frames errs by up to half a one, and whole turns by what the rows disagree
    error = 72 * 0.5 * PER_PX if method == "rows" else tolerance(method, panorama(start))
    assert compass.counts == {CompassStatus.FIRST_FRAME: 1, CompassStatus.OK: 72}
    assert compass.yaw == pytest.approx(3 * math.tau, abs=error)
    show(compass, *reversed(frames), t_ns=START_NS + 100 * FRAME_NS)
    assert compass.yaw == pytest.approx(0.0, abs=error)


def test_increment_is_the_turn_between_its_stamps(method, start):
    rng = np.random.default_rng(2)
    yaws = np.concatenate([[0.0], np.cumsum(rng.uniform(-0.2, 0.25, 40))])
    compass = VisualCompass(CompassConfig(method=method))
    truth = {}
    for index, yaw in enumerate(yaws):
        t_ns = START_NS + index * FRAME_NS
        truth[t_ns] = yaw
        increment = compass.update(t_ns, as_bytes(turned(panorama(start), yaw)))
        if index == 0:
            continue
        assert increment.t_ns == t_ns
        error = wrap_angle(increment.yaw - (yaw - truth[increment.t_ref_ns]))
        assert abs(error) < tolerance(method, panorama(start)) + (EXACT if method == "rows" else 0.0)
        assert -math.pi <= increment.yaw < math.pi
        assert increment.variance > 0.0
        assert 0.9 < increment.confidence <= 1.0
    # errors of at most half a column each in 40 steps for rows; a keyframe's otherwise
    drift = 40 * 0.5 * PER_PX if method == "rows" else 6 * tolerance(method, panorama(start))
    assert compass.yaw == pytest.approx(yaws[-1], abs=drift)


@pytest.mark.parametrize("degrees", [90.0, -90.0, 135.0, 180.0])
def test_big_turn_between_frames_is_found_despite_max_yaw_rate(method, start, degrees):
    image = as_bytes(panorama(start))  # 0.1 s apart: 3 rad/s expects at most 17 deg
    columns = round(degrees / 360.0 * WIDTH)
    increment = compare(VisualCompass(CompassConfig(method=method)), image, np.roll(image, columns, axis=1))
    assert wrap_angle(increment.yaw - columns * PER_PX) == pytest.approx(0.0, abs=EXACT)


@pytest.mark.parametrize("degrees", [-20.0, 0.0, 31.0])
def test_scene_alike_front_and_back_follows_the_turn_within_reach(start, degrees):
    half = turned(scene(3, WIDTH // 2, 96), 2.0 * start)
    image = np.tile(half, (1, 2))
    columns = round(degrees / 360.0 * WIDTH)
    for method in ("sectors", "corners"):
        compass = VisualCompass(CompassConfig(method=method))
        show(compass, as_bytes(image), np.roll(as_bytes(image), columns, axis=1), every_ns=2 * FRAME_NS)
        assert compass.yaw == pytest.approx(columns * PER_PX, abs=EXACT)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(columns=st.integers(-48, 48), seed=st.integers(0, 3), origin=st.integers(0, WIDTH - 1))
def test_rolled_by_whole_columns_is_those_columns(columns, seed, origin):
    image = np.roll(as_bytes(panorama(seed=seed)), origin, axis=1)
    for method in METHODS:
        increment = compare(VisualCompass(CompassConfig(method=method)), image, np.roll(image, columns, axis=1))
        assert increment.yaw == pytest.approx(columns * PER_PX, abs=EXACT)
        assert increment.confidence == pytest.approx(1.0, abs=1e-5)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(columns=st.floats(-45, 45), noise=st.floats(0.0, 8.0), seed=st.integers(0, 1000))
def test_frames_reversed_turn_back(columns, noise, seed):
    image = panorama()
    before, now = as_bytes(image, noise, seed), as_bytes(shifted(image, columns), noise, seed + 1)
    for method in METHODS:
        compass = VisualCompass(CompassConfig(method=method))
        there, back = compare(compass, before, now), compare(compass, now, before)
        # The same noise both ways: only the places of the sectors' windows differ, by the shift.
        assert there.yaw == pytest.approx(-back.yaw, abs=tolerance(method, image, noise))
        if method == "rows":
            assert there.yaw == pytest.approx(-back.yaw, abs=EXACT)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(columns=st.floats(-45, 45), gain=st.integers(1, 6), offset=st.integers(0, 10_000), which=st.booleans())
def test_brightness_and_contrast_do_not_matter(columns, gain, offset, which):
    # whole gains of 16-bit images round nothing: the same answer but for float32
    before, now = (np.rint(image * 36.0).astype(np.uint16) for image in (panorama(), shifted(panorama(), columns)))
    brighter = [gain * before + offset, now] if which else [before, gain * now + offset]
    assert max(image.max() for image in brighter) < 65_000  # 215 * 36 * 6 + 10000
    for method in METHODS:
        compass = VisualCompass(CompassConfig(method=method))
        plain, changed = compare(compass, before, now), compare(compass, *brighter)
        assert changed.yaw == pytest.approx(plain.yaw, abs=EXACT)
        assert changed.confidence == pytest.approx(plain.confidence, abs=1e-4)


@pytest.mark.parametrize(("gain", "offset"), [(0.4, 0.0), (0.4, 150.0), (1.15, 0.0), (1.0, -35.0)])
def test_exposure_change_of_a_byte_image_costs_only_its_rounding(method, start, gain, offset):
    image = panorama(start)
    exposed = gain * shifted(image, 10.3) + offset
    yaw = compare(VisualCompass(CompassConfig(method=method)), as_bytes(image), as_bytes(exposed)).yaw
    assert yaw == pytest.approx(10.3 * PER_PX, abs=tolerance(method, image, noise=0.29 / gain))


def test_region_of_interest_is_what_is_looked_at(method):
    # the middle turns, above and below stand still
    still, moving = scene(4, WIDTH, 100), scene(5, WIDTH, 100)
    before, now = still.copy(), still.copy()
    before[40:70], now[40:70] = moving[40:70], np.roll(moving, 20, axis=1)[40:70]
    before, now = as_bytes(before), as_bytes(now)
    inside = VisualCompass(CompassConfig(method=method, roi_top=0.4, roi_bottom=0.7))
    assert compare(inside, before, now).yaw == pytest.approx(20 * PER_PX, abs=EXACT)
    for top, bottom in ((0.0, 0.4), (0.7, 1.0)):
        outside = VisualCompass(CompassConfig(method=method, roi_top=top, roi_bottom=bottom))
        assert compare(outside, before, now).yaw == pytest.approx(0.0, abs=EXACT)


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_forward_column_turns_with_the_camera(quarter):
    # a camera mounted turned by a quarter, and told so, sees the same turn
    image = panorama()
    before, now = as_bytes(image, 2.0, 1), as_bytes(shifted(image, 12.4), 2.0, 2)
    mounted = [np.roll(frame, quarter * WIDTH // 4, axis=1) for frame in (before, now)]
    config = CompassConfig(method="corners", forward_column=(0.5 + quarter / 4) % 1.0)
    plain = compare(VisualCompass(CompassConfig(method="corners")), before, now)
    told = compare(VisualCompass(config), *mounted)
    assert told.yaw == pytest.approx(plain.yaw, abs=EXACT)
    assert told.variance == pytest.approx(plain.variance, rel=1e-2)


@pytest.mark.parametrize("rows", [1, 7, 16, 160])
@pytest.mark.parametrize("columns", [256, 500, 1024, 4096])
def test_any_strip_size_measures_the_turn(method, rows, columns):
    image = panorama()
    compass = VisualCompass(CompassConfig(method=method, rows=rows, columns=columns))
    yaw = compare(compass, as_bytes(image), as_bytes(shifted(image, 16.0))).yaw
    # fewer columns than the image has: what is finer than they are folds back, by less than a fiftieth of one
    step = math.tau / min(columns, WIDTH)
    assert yaw == pytest.approx(16.0 * PER_PX, abs=step * (0.51 if method == "rows" else 0.02))


def test_same_frames_give_the_same_bits(method):
    rng = np.random.default_rng(6)
    frames = [as_bytes(turned(panorama(), yaw), 3.0, index) for index, yaw in enumerate(rng.uniform(-0.1, 0.1, 12))]
    runs = []
    for _ in range(2):
        compass = VisualCompass(CompassConfig(method=method))
        runs.append([compass.update(START_NS + i * FRAME_NS, frame.copy()) for i, frame in enumerate(frames)])
        runs[-1].append((compass.yaw, compass.yaw_variance))
    assert runs[0] == runs[1]


def test_image_given_stays_as_it_was_and_may_be_overwritten_after(method):
    image = as_bytes(panorama())
    frame, kept = image.copy(), image.copy()
    compass = VisualCompass(CompassConfig(method=method))
    compass.update(START_NS, frame)
    np.testing.assert_array_equal(frame, kept)
    frame[:] = np.roll(image, 10, axis=1)  # a driver that reuses its buffer
    assert compass.update(START_NS + FRAME_NS, frame).yaw == pytest.approx(10 * PER_PX, abs=EXACT)


def test_reset_forgets_yaw_and_images_but_not_counts(method):
    compass = VisualCompass(CompassConfig(method=method))
    image = as_bytes(panorama())
    show(compass, image, np.roll(image, 10, axis=1))
    compass.reset()
    assert (compass.yaw, compass.yaw_variance, compass.status) == (0.0, 0.0, CompassStatus.NOT_STARTED)
    assert compass.update(0, image) is None  # an earlier stamp is no matter after a reset
    assert compass.status is CompassStatus.FIRST_FRAME
    assert compass.counts == {CompassStatus.FIRST_FRAME: 2, CompassStatus.OK: 1}
