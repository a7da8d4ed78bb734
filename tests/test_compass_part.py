"""Cameras that see a part of the circle: exact where they only turn, never surer than they can be where they travel."""

from __future__ import annotations

import math

import camera_models as camera
import numpy as np
import pytest
from panoramas import FRAME_NS, START_NS, as_bytes, scene, seen_from, shifted

from compass import CompassConfig, VisualCompass
from compass.images.strip import prepare_strip

R = math.radians
WIDTH = 1024
VIEWS = [300.0, 200.0, 120.0, 90.0]  # deg


def seen(panorama, view, noise_seed):
    image = camera.cylinder(panorama.astype(np.uint8), round(WIDTH * view / 360), WIDTH // 2, R(view))
    return as_bytes(image.astype(np.float32), 2.0, noise_seed)


def shown(view, images):
    """The compass after images of a cylinder of this field of view."""
    compass = VisualCompass(CompassConfig(projection="cylinder", field_of_view_deg=view))
    increments = [compass.update(START_NS + k * FRAME_NS, image) for k, image in enumerate(images)]
    return compass, increments[1:]


@pytest.mark.parametrize(("view", "sign"), [(300.0, 1), (200.0, -1), (120.0, 1), (120.0, -1), (90.0, -1)])
def test_a_turn_by_more_than_the_field_of_view_is_exact(view, sign):
    """New keyframes come as old ones leave the view; whatever is unseen has no part in the turn."""
    panorama = scene(3, WIDTH, WIDTH // 2)
    step = 17  # of 1024 columns, 6 deg
    count = math.ceil(1.2 * view / 6.0)
    images = [seen(np.roll(panorama, sign * step * k, axis=1), view, k) for k in range(count)]
    compass, increments = shown(view, images)
    assert all(increments)
    off = compass.yaw - sign * step * (count - 1) * math.tau / WIDTH
    assert abs(off) < 4.0 * math.sqrt(compass.yaw_variance)
    assert abs(math.degrees(off)) < 0.2 * view / 90.0


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("direction", [90.0, -90.0])
def test_travel_sideways_past_things_equally_far_is_within_sigma(view, direction):
    """That looks like a turn, whoever looks: no variance but a large one is honest.

    For as long as one keyframe lasts: errors of several are alike, which is the filter's to know.
    """
    panorama = scene(5, WIDTH, WIDTH // 2)
    images = [seen(seen_from(panorama, 0.02 * k, R(direction), 2.0), view, k) for k in range(8)]
    compass, increments = shown(view, images)
    assert abs(compass.yaw) < 3.0 * math.sqrt(compass.yaw_variance)
    assert any(increments)


def test_columns_that_are_not_seen_have_no_corners():
    compass, _ = shown(120.0, [seen(shifted(scene(3, WIDTH, WIDTH // 2), 4.0 * k), 120.0, k) for k in range(4)])
    at = compass._method._keyframe.patches.at[:, 0] / WIDTH
    assert len(at) > 20
    assert (np.abs(at - 0.5) < 60 / 360).all()


def test_strip_of_a_part_has_the_means_and_the_texture_of_what_is_seen():
    panorama = scene(3, WIDTH, WIDTH // 2)
    config = CompassConfig(projection="cylinder", field_of_view_deg=120.0)
    strip = prepare_strip(0, seen(panorama, 120.0, 0), config)
    hidden = strip.seen.pixels == 0
    assert (strip.pixels[hidden] == 0).all()
    assert np.abs(strip.pixels.sum(axis=1) / strip.seen.counts[:, 0]).max() < 0.1
    whole = prepare_strip(0, as_bytes(panorama), CompassConfig())
    assert strip.texture == pytest.approx(whole.texture, rel=0.35)  # of a third of a scene


@pytest.mark.parametrize("view", [240.0, 200.0, 180.0])
def test_driving_ahead_is_no_surer_than_driving_sideways(view):
    """Where to is found together with the turn: it may be wrong as the turn is, and cannot vouch for it."""
    panorama = scene(6, WIDTH, WIDTH // 2)
    deviations = []
    for direction in (0.0, 90.0):
        images = [seen(seen_from(panorama, 0.02 * k, R(direction), 2.0), view, k) for k in range(5)]
        deviations.append(math.sqrt(shown(view, images)[0].yaw_variance))
    assert deviations[0] > 0.5 * deviations[1]
