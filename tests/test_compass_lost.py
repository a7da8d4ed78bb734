"""Turns that no image measured: they widen the variance of the accumulated yaw, by what may have been turned."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from panoramas import START_NS, as_bytes, scene, turned

from compass import CompassConfig, CompassStatus, VisualCompass

WIDTH = 512
RATE = 1.0  # rad/s that the camera turns by
HZ = 20.0
BOUND = CompassConfig().max_yaw_rate
PANORAMA = scene(1, WIDTH, 96)
ELSEWHERE = scene(2, WIDTH, 96)


def image(seconds, place=PANORAMA):
    return as_bytes(turned(place, RATE * seconds), 2.0, round(seconds * 1000))


def stamp(seconds):
    return START_NS + round(seconds * 1e9)


def drive(compass, start, end, seen=image, stamped=stamp):
    """Images from `start` to `end`, s; what was given."""
    return [compass.update(stamped(s), seen(s)) for s in np.arange(start, end, 1.0 / HZ)]


def black(seconds):
    return np.zeros((96, WIDTH), np.uint8)


def off(compass, seconds):
    """Error of the accumulated yaw, in its deviations."""
    return abs(compass.yaw - RATE * seconds) / math.sqrt(compass.yaw_variance)


@pytest.mark.parametrize("dark", [0.5, 2.0, 10.0])
def test_black_while_turning_is_bridged_where_the_place_is_seen_again(dark):
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    drive(compass, 1.0, 1.0 + dark, black)
    drive(compass, 1.0 + dark, 2.0 + dark)
    error = math.remainder(compass.yaw - RATE * (1.95 + dark), math.tau)  # whole turns are not counted in the dark
    assert abs(error) < 5.0 * math.sqrt(compass.yaw_variance)
    assert compass.lost_turns == []


@pytest.mark.parametrize("dark", [0.0, 0.5, 2.0, 10.0])
def test_another_place_after_a_gap_widens_the_variance_by_what_may_have_been_turned(dark):
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    drive(compass, 1.0, 1.0 + dark, black)
    drive(compass, 1.0 + dark, 4.0 + dark, lambda s: image(s, ELSEWHERE))
    (lost,) = compass.lost_turns
    assert lost.t_from_ns == stamp(0.95)
    gap = (lost.t_to_ns - lost.t_from_ns) * 1e-9
    assert dark + 1.0 < gap < dark + 1.3  # a second passes before the place is taken for another one
    assert lost.bound == pytest.approx(BOUND * gap)
    assert compass.yaw_variance == pytest.approx(lost.bound**2 / 3.0, rel=1e-3)
    assert off(compass, 3.95 + dark) < math.sqrt(3.0)


@pytest.mark.parametrize("dark", [0.0, 2.0])
def test_turn_that_is_badly_known_is_given_before_it_is_lost_unless_images_are_missing(monkeypatch, dark):
    compare = VisualCompass._compare

    def badly(compass, keyframe, strip):
        match = compare(compass, keyframe, strip)
        return replace(match, variance_px2=4.0, status=CompassStatus.LOW_CONFIDENCE, badly_known=True)

    compass = VisualCompass(CompassConfig(find_again=False))
    drive(compass, 0.0, 1.0)
    before = compass.yaw_variance
    drive(compass, 1.0, 1.0 + dark, black)
    monkeypatch.setattr(VisualCompass, "_compare", badly)
    given = [one for one in drive(compass, 1.0 + dark, 3.5 + dark) if one is not None]
    if dark:
        assert compass.lost_turns  # another bay may look the same
        return
    assert compass.lost_turns == []
    assert [round((one.t_ns - one.t_ref_ns) * 1e-9, 2) for one in given[1:]] == [1.05]
    assert compass.yaw_variance - before == pytest.approx(2 * 4.0 * (math.tau / WIDTH) ** 2, rel=0.01)
    assert abs(compass.yaw - RATE * (given[-1].t_ns - START_NS) * 1e-9) < 0.01


def test_changed_size_while_turning_loses_the_turn_between_two_images():
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    drive(compass, 1.0, 2.0, lambda s: cv2.resize(image(s), (2 * WIDTH, 192), interpolation=cv2.INTER_CUBIC))
    assert [(one.t_from_ns, one.t_to_ns) for one in compass.lost_turns] == [(stamp(0.95), stamp(1.0))]
    assert compass.yaw_variance == pytest.approx((BOUND / HZ) ** 2 / 3.0, rel=1e-3)
    assert off(compass, 1.95) < math.sqrt(3.0)


def test_two_sizes_in_turn_lose_one_turn_that_grows():
    compass = VisualCompass()
    for index, s in enumerate(np.arange(0.0, 1.0, 1.0 / HZ)):
        compass.update(stamp(s), image(s)[:, : WIDTH // 2] if index % 2 else image(s))
    (lost,) = compass.lost_turns
    assert lost.bound == pytest.approx(BOUND * 0.95)
    assert compass.yaw_variance == pytest.approx(lost.variance)
    assert off(compass, 0.95) < math.sqrt(3.0)


def test_clock_that_jumps_back_by_less_than_it_takes_to_believe_it_is_bridged_by_what_is_seen():
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    drive(compass, 1.0, 2.0, stamped=lambda s: stamp(s - 0.4))
    assert compass.counts[CompassStatus.BACKWARD_STAMP] == 8
    assert compass.lost_turns == []
    assert off(compass, 1.95) < 5.0


@pytest.mark.parametrize("back", [3600.0, 5.0])
def test_clock_that_jumps_back_leaves_any_heading_possible(back):
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    drive(compass, 1.0, 2.0, stamped=lambda s: stamp(s - back))
    assert compass.counts[CompassStatus.BACKWARD_STAMP] > 0
    assert compass.lost_turns
    assert compass.yaw_variance >= math.pi**2 / 3.0
    assert off(compass, 1.95) < math.sqrt(3.0)


def test_single_stamp_far_ahead_loses_no_more_than_the_images_left_out():
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    compass.update(stamp(4000.0), image(1.0))
    drive(compass, 1.05, 3.0)
    (lost,) = compass.lost_turns
    assert lost.t_from_ns == stamp(0.95)
    assert lost.bound == pytest.approx(BOUND * (lost.t_to_ns - lost.t_from_ns) * 1e-9)
    assert lost.bound < BOUND * 0.65
    assert off(compass, 2.95) < math.sqrt(3.0)


@pytest.mark.parametrize("frozen", [0.1, 0.4, 2.0])
def test_frozen_camera_claims_no_standstill_while_it_turns(frozen):
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    hung = image(0.95)
    for s in np.arange(1.0, 1.0 + frozen, 1.0 / HZ):
        increment = compass.update(stamp(s), hung)
        if increment is None:
            assert compass.status is CompassStatus.FROZEN
            continue
        turned_unseen = RATE * (s - 0.95)
        assert increment.variance >= turned_unseen**2 / 3.0
        assert off(compass, s) < math.sqrt(3.0)
    drive(compass, 1.0 + frozen, 2.0 + frozen)
    assert off(compass, 1.95 + frozen) < 5.0
    assert compass.yaw_variance < math.radians(0.1) ** 2  # seen again: all is known
    assert compass.lost_turns == []


def test_each_frame_twice_costs_nothing_at_the_images_themselves():
    once, twice = VisualCompass(), VisualCompass()
    drive(once, 0.0, 2.0)
    for s in np.arange(0.0, 2.0, 1.0 / HZ):
        fresh = twice.update(stamp(s), image(s))
        assert fresh is None or fresh.variance < math.radians(0.1) ** 2
        copy = twice.update(stamp(s + 0.5 / HZ), image(s))
        assert copy.variance >= (BOUND * 0.5 / HZ) ** 2 / 3.0
    assert twice.yaw == once.yaw
    assert twice.counts[CompassStatus.FROZEN] == 0


def test_copy_of_an_image_is_never_a_reference():
    compass = VisualCompass(CompassConfig(keyframe_spread=0.0))  # the reference moves with every image
    originals = set()
    for s in np.arange(0.0, 1.0, 1.0 / HZ):
        originals.add(stamp(s))
        for t_ns in (stamp(s), stamp(s + 0.5 / HZ)):
            increment = compass.update(t_ns, image(s))
            assert increment is None or increment.t_ref_ns in originals
    assert off(compass, 0.95) < 5.0


def test_thirty_black_images_at_the_start_lose_nothing():
    compass = VisualCompass()
    drive(compass, 0.0, 1.5, black)
    assert compass.counts == {CompassStatus.NO_TEXTURE: 30}
    drive(compass, 1.5, 2.5)
    assert compass.status is CompassStatus.OK
    assert compass.lost_turns == []
    assert compass.yaw == pytest.approx(RATE * 0.95, abs=1e-3)


def test_copies_of_the_first_good_image_after_darkness_are_copies_not_frozen():
    compass = VisualCompass()
    drive(compass, 0.0, 1.0, black)
    compass.update(stamp(1.0), image(1.0))
    increment = compass.update(stamp(1.05), image(1.0))
    assert compass.status is CompassStatus.OK
    assert increment.yaw == 0.0
    assert increment.variance >= (BOUND * 0.05) ** 2 / 3.0


def test_reset_forgets_what_was_lost():
    compass = VisualCompass()
    drive(compass, 0.0, 1.0)
    drive(compass, 1.0, 4.0, lambda s: image(s, ELSEWHERE))
    compass.reset()
    assert (compass.yaw_variance, compass.lost_turns, compass.history.images) == (0.0, [], 0)
