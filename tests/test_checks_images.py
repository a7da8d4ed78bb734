"""Warnings about images and their stamps: each named with its numbers, none where all is well."""

import numpy as np
import pytest
from panoramas import START_NS, as_bytes, scene, turned

from compass import VisualCompass
from fusion.checks.images import image_warnings

WIDTH = 512
PANORAMA, ELSEWHERE = scene(1, WIDTH, 96), scene(2, WIDTH, 96)
SECOND = 10**9
STEP_NS = SECOND // 10


def lit(index, place=PANORAMA):
    return as_bytes(turned(place, 0.03 * index), 2.0, index)


def black(index):
    return np.zeros((96, WIDTH), np.uint8)


def watched(images, stamps=None):
    compass = VisualCompass()
    for index, image in enumerate(images):
        compass.update(START_NS + index * STEP_NS if stamps is None else stamps[index], image)
    return image_warnings(compass)


def only(warnings, code):
    (warning,) = warnings
    assert (warning.code, warning.sensor) == (code, "compass")
    return warning


def test_good_images_give_no_warning():
    assert watched([lit(i) for i in range(40)]) == []
    assert image_warnings(VisualCompass()) == []


def test_lost_turn_is_told_with_time_and_bound():
    warning = only(watched([lit(i, PANORAMA if i < 10 else ELSEWHERE) for i in range(40)]), "turn_lost")
    assert warning.since_ns == START_NS + 9 * STEP_NS
    assert "1.2 s without a usable image" in warning.text  # found to be another place after more than a second
    assert "up to 206 deg" in warning.text  # 3 rad/s for 1.2 s


def test_clock_that_goes_back_is_told():
    stamps = [START_NS + (i if i < 20 else i - 100) * STEP_NS for i in range(40)]
    lost, refused = watched([lit(i) for i in range(40)], stamps)
    assert (lost.code, refused.code) == ("turn_lost", "stamps_not_increasing")
    assert "went back by 9 s" in lost.text
    assert lost.since_ns == START_NS - 71 * STEP_NS  # the first image that was believed again
    assert "10 of 40 images" in refused.text
    assert "by up to 9.9 s" in refused.text
    assert refused.since_ns == START_NS - 80 * STEP_NS


def test_frozen_camera_is_told_while_it_lasts():
    frames = [lit(min(i, 10)) for i in range(30)]
    warning = only(watched(frames), "images_frozen")
    assert warning.since_ns == START_NS + 10 * STEP_NS
    assert "1.9 s" in warning.text
    assert watched([*frames, lit(11)]) == []


@pytest.mark.parametrize("grey", [0, 255])
def test_empty_images_are_told_while_they_last(grey):
    empty = [np.full((96, WIDTH), grey, np.uint8)] * 30
    warning = only(watched(empty), "images_empty")
    assert warning.since_ns == START_NS
    assert "100 %" in warning.text
    warning = only(watched([*[lit(i) for i in range(20)], *empty]), "images_empty")
    assert warning.since_ns == START_NS + 20 * STEP_NS
    assert watched([*empty, *[lit(i) for i in range(20)]]) == []


def test_single_dark_images_are_no_fault():
    assert watched([black(i) if i % 10 == 5 else lit(i) for i in range(60)]) == []


@pytest.mark.parametrize("stamp", [0, START_NS])
def test_one_stamp_for_all_images_is_told(stamp):
    warning = only(watched([lit(i) for i in range(30)], [stamp] * 30), "stamps_not_increasing")
    assert warning.since_ns == stamp
    assert "all 30 images" in warning.text


def test_stamps_cut_to_whole_seconds_are_told():
    stamps = [START_NS + i // 10 * SECOND for i in range(60)]
    warning = only(watched([lit(i) for i in range(60)], stamps), "stamps_not_increasing")
    assert "whole seconds" in warning.text
    assert "54 of 60 images (90 %)" in warning.text
    assert warning.since_ns == START_NS


def test_whole_seconds_of_a_slow_camera_are_no_fault():
    assert watched([lit(i) for i in range(30)], [START_NS + i * SECOND for i in range(30)]) == []


def test_repeated_stamps_are_counted():
    stamps = [START_NS + i // 2 * STEP_NS for i in range(40)]
    warning = only(watched([lit(i) for i in range(40)], stamps), "stamps_not_increasing")
    assert "20 of 40 images (50 %)" in warning.text
    assert "20 repeat;" in warning.text


def test_message_delivered_twice_is_no_fault():
    stamps = [START_NS + (i if i < 20 else i - 1) * STEP_NS for i in range(40)]
    assert watched([lit(i) for i in range(40)], stamps) == []


def test_half_a_circle_is_told():
    frames = [np.repeat(as_bytes(turned(PANORAMA, 0.05 * i), 2.0, i)[:, : WIDTH // 2], 2, axis=1) for i in range(100)]
    warning = only(watched(frames), "not_full_circle")
    assert "do not join" in warning.text
    assert warning.since_ns == START_NS


def test_the_same_images_give_the_same_warnings():
    frames = [lit(i) if i % 3 else black(i) for i in range(40)]
    assert watched(frames) == watched(frames)
