"""Places that repeat themselves: after a gap no turn is claimed that another one explains about as well."""

import math

import numpy as np
import pytest
from panoramas import FRAME_NS, START_NS, as_bytes, scene, seen_from, shifted

from compass import CompassStatus, VisualCompass
from fusion.simulation import fittings, materials
from fusion.simulation.builder import Builder
from fusion.simulation.camera import PanoramaCamera
from fusion.simulation.painter import CameraPose
from fusion.simulation.surfaces import Ground
from fusion.simulation.world import Solid, World

WIDTH, HEIGHT = 1024, 512
PITCH = 2.1  # m between pillars
LIT = 8  # images before and after the gap
DARK = np.zeros((HEIGHT, WIDTH), np.float32)


def fed(before, gap, after, gap_s, noise=2.0):
    """A compass, and its increments once a gap is over in which `gap` is seen, an image, or nothing (None)."""
    compass, missed = VisualCompass(), round(gap_s * 1e9 / FRAME_NS)
    images = [before] * LIT + [gap] * missed + [after] * 2 * LIT
    given = [
        compass.update(START_NS + k * FRAME_NS, as_bytes(image, noise, min(k, LIT - 1) if image is gap else k))
        for k, image in enumerate(images)
        if image is not None
    ]
    return compass, given[-2 * LIT :]


def unknown(compass, increments, gap_s):
    """Whether no increment reaches across the gap, and the yaw's variance says that nobody knows what was turned."""
    across = [one for one in increments if one and one.t_ns - one.t_ref_ns > gap_s * 1e9]
    return not across and compass.lost_turns and math.sqrt(compass.yaw_variance) > gap_s


def room(folds, seed=1):
    """What is seen somewhat off the middle of a room that looks the same when turned by a part of the circle."""
    wall = scene(seed, WIDTH // folds, HEIGHT)
    return seen_from(np.tile(wall, folds), 0.25, 0.8, 1.5)


@pytest.mark.parametrize(
    ("folds", "turn_deg", "gap_s"),
    [(2, 0.0, 1.0), (2, 180.0, 8.0), (2, 37.0, 3.0), (4, 0.0, 3.0), (4, 90.0, 1.0), (4, 180.0, 3.0), (4, 37.0, 8.0)],
)
def test_room_that_looks_the_same_all_round_is_no_answer_after_the_dark(folds, turn_deg, gap_s):
    """A robot as far from another wall sees the very same picture."""
    place = room(folds)
    compass, increments = fed(place, DARK, shifted(place, turn_deg * WIDTH / 360.0), gap_s)
    assert unknown(compass, increments, gap_s)


@pytest.mark.parametrize("gap", ["frozen", "silent"])
def test_room_that_looks_the_same_all_round_is_no_answer_after_any_gap(gap):
    place = room(4)
    compass, increments = fed(place, place if gap == "frozen" else None, shifted(place, 100.0), 3.0)
    assert unknown(compass, increments, 2.9)


@pytest.mark.parametrize(("gap", "turn_deg"), [(DARK, 0.0), (DARK, 90.0), (None, 37.0)])
def test_place_that_does_not_repeat_itself_is_seen_again(gap, turn_deg):
    place = scene(3, WIDTH, HEIGHT)
    compass, increments = fed(place, gap, shifted(seen_from(place, 0.05, 0.8, 1.5), turn_deg * WIDTH / 360.0), 3.0)
    assert increments[0]
    assert compass.yaw == pytest.approx(math.radians(turn_deg), abs=math.radians(0.1))
    assert not compass.lost_turns


def test_images_that_come_slowly_are_no_gap():
    """Nothing is missing between them: a turn of a second is followed as before."""
    place = room(4)
    compass = VisualCompass()
    given = [compass.update(START_NS + k * 10**9, as_bytes(place, 2.0, k)) for k in range(6)]
    assert all(given[1:])


def grid_of_pillars(seed):
    """A hall with identical pillars in a square grid, whose walls repeat with them."""
    rng = np.random.default_rng(seed)
    b, half, height = Builder(rng), 2.5 * PITCH, 3.4
    shaft = b.skin(materials.concrete, 1.2, height)
    for x in np.arange(-2.0, 3.0) * PITCH:
        for y in np.arange(-2.0, 3.0) * PITCH:
            b.solids.append(Solid((x - 0.19, y - 0.19, 0.0), (x + 0.19, y + 0.19, height), shaft, None, round=True))
    bay = materials.plaster(rng, PITCH, height, b.density)
    fittings.window(bay, rng, b.density, 0.1)
    corners = (-half, -half), (half, -half), (half, half), (-half, half)
    for start, end in zip(corners, (*corners[1:], corners[0]), strict=True):
        b.wall(start, end, bay, height, repeat=PITCH)
    plain = np.full((256, 256), 90.0, np.float32)
    return World(tuple(b.solids), Ground(plain, PITCH), Ground(plain + 60.0, PITCH), height)


@pytest.mark.parametrize("seed", [1, 5, 23])
def test_another_bay_of_a_grid_of_pillars_is_not_taken_for_the_last_view(seed):
    """The robot turns by 90 deg in the dark, and stands in a bay as it stood in another one before.

    With the last two seeds nothing but look-alikes within a view tells.
    """
    world, camera = grid_of_pillars(seed), PanoramaCamera()
    x, y = np.random.default_rng(seed).uniform(0.35, 0.75, 2) * PITCH
    before = camera.render(world, CameraPose(x, y, 0.7, 0.0, 0.0, 0.0))
    after = camera.render(world, CameraPose(-y + 0.03, x, 0.7, math.pi / 2.0, 0.0, 0.0))
    compass, increments = fed(before, DARK, after, 3.0)
    assert unknown(compass, increments, 3.0)
    assert compass.counts[CompassStatus.AMBIGUOUS]
