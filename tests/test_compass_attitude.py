"""A camera that leans as it turns: its heading against rotation matrices composed by another library."""

import math
from itertools import pairwise

import numpy as np
import pytest
from panoramas import STARTS
from scipy.spatial.transform import Rotation

from compass.tilt import GOOD_FOR_S, Tilted

ROUNDING = 1e-12  # of a hundred products of 3 x 3 matrices, rad


def heading_of(attitude):
    """Yaw of roll, pitch and yaw about fixed axes."""
    return float(attitude.as_euler("ZYX")[0])


def scene_turned_about(x, y):
    """What the camera did when the scene rotated about its x and y: the opposite."""
    return Rotation.from_rotvec([-x, -y, 0.0])


def between(angle, other):
    """Difference of two angles on the circle, rad, without sign."""
    return abs(float(np.angle(np.exp(1j * (angle - other)))))


@pytest.mark.parametrize("turn", [0.0, 0.3, -2.0, 3.1, -3.1, *STARTS.values()])
def test_turn_without_tilt_is_the_change_of_heading(turn):
    leans, heading = Tilted().after(turn, (0.0, 0.0))
    assert between(heading, turn) < ROUNDING
    assert leans.matrix == pytest.approx(np.eye(3), abs=ROUNDING)


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
def test_heading_is_that_of_composed_rotations(start):
    rng = np.random.default_rng(1)
    truth, leans, yaw = Rotation.from_euler("z", start), Tilted(), start
    for turn, *tilt in zip(rng.uniform(-3.0, 3.0, 100), *np.deg2rad(rng.normal(0.0, 4.0, (2, 100))), strict=True):
        truth = truth * scene_turned_about(*tilt) * Rotation.from_euler("z", turn)
        leans, change = leans.after(turn, tuple(tilt))
        yaw += change
        assert between(yaw, heading_of(truth)) < ROUNDING
        # what is left without the heading is roll and pitch
        level = Rotation.from_euler("z", -heading_of(truth)) * truth
        assert leans.matrix == pytest.approx(level.as_matrix(), abs=ROUNDING)


@pytest.mark.parametrize(("about_x", "about_y"), [(0.05, 0.0), (0.0, 0.05), (-0.03, 0.04)])
def test_scene_rotates_against_the_camera(about_x, about_y):
    leans, heading = Tilted().after(0.0, (about_x, about_y))
    assert leans.matrix[2] == pytest.approx(scene_turned_about(about_x, about_y).as_matrix()[2], abs=ROUNDING)
    # a rotation about x and y alone turns by less than half the product of its angles
    assert abs(heading) <= 0.5 * abs(about_x * about_y) + 1e-6


@pytest.mark.parametrize("to_the_left", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("degrees", [1.0, 3.0, 10.0])
def test_axis_led_round_a_cone_comes_back_turned_by_the_area_it_enclosed(degrees, to_the_left):
    # the camera's z goes round the vertical without any turn about itself: parallel transport on the unit sphere,
    # which turns by the solid angle of the cone, 2 pi (1 - cos); 720 chords for a circle leave (pi / 720)^2 of it out
    steps, lean = 720, math.radians(degrees)
    around = to_the_left * np.linspace(0.0, math.tau, steps + 1)
    axes = np.stack(
        [math.sin(lean) * np.cos(around), math.sin(lean) * np.sin(around), np.full(steps + 1, math.cos(lean))]
    )
    path = [np.array([0.0, 0.0, 1.0]), *axes.T, np.array([0.0, 0.0, 1.0])]
    truth, leans, yaw = Rotation.identity(), Tilted(), 0.0
    for one, other in pairwise(path):
        axis = np.cross(one, other)
        turn = axis / np.linalg.norm(axis) * math.atan2(np.linalg.norm(axis), one @ other)
        x, y, z = truth.inv().apply(turn)
        assert abs(z) < ROUNDING  # no turn about its own axis
        truth = Rotation.from_rotvec(turn) * truth
        leans, change = leans.after(0.0, (-x, -y))
        yaw += change
    area = to_the_left * math.tau * (1.0 - math.cos(lean))
    assert leans.matrix == pytest.approx(np.eye(3), abs=1e-9)
    assert yaw == pytest.approx(area, rel=2.0 * (math.pi / steps) ** 2)


def test_path_out_and_back_encloses_nothing():
    tilts = np.deg2rad(np.random.default_rng(2).normal(0.0, 2.0, (20, 2)))
    leans, yaw = Tilted(), 0.0
    for x, y in [*tilts, *-tilts[::-1]]:
        leans, change = leans.after(0.0, (float(x), float(y)))
        yaw += change
    assert yaw == pytest.approx(0.0, abs=ROUNDING)


def test_tilt_after_a_turn_is_about_the_turned_axes():
    # nose down by rotating about +y, a quarter to the left, and the low side is now the right: up again about -x
    leans, heading = Tilted().after(math.pi / 2.0, (0.0, -0.1))
    assert heading == pytest.approx(math.pi / 2.0, abs=ROUNDING)
    level, _ = leans.after(0.0, (0.1, 0.0))
    assert level.matrix == pytest.approx(np.eye(3), abs=ROUNDING)


@pytest.mark.parametrize("seconds", [0.5, GOOD_FOR_S, 20.0])
def test_later_it_stands_level_again(seconds):
    leans, _ = Tilted().after(0.4, (0.08, -0.05))
    before, after = (Rotation.from_matrix(one.matrix).as_rotvec() for one in (leans, leans.later(seconds)))
    assert after == pytest.approx(before * math.exp(-seconds / GOOD_FOR_S), abs=ROUNDING)  # less of the same lean


@pytest.mark.parametrize("seconds", [0.0, -3.0])
def test_no_later_or_earlier_it_leans_as_it_did(seconds):
    leans, _ = Tilted().after(-0.7, (0.02, 0.06))
    assert leans.later(seconds).matrix == pytest.approx(leans.matrix, abs=ROUNDING)


def test_level_stays_level():
    assert Tilted().later(1.0).matrix == pytest.approx(np.eye(3), abs=ROUNDING)


def test_long_chain_of_leans_stays_a_rotation():
    rng, leans = np.random.default_rng(3), Tilted()
    for turn, x, y in rng.normal(0.0, [1.0, 0.02, 0.02], (2000, 3)):
        leans = leans.after(float(turn), (float(x), float(y)))[0].later(0.1)
    assert leans.matrix @ leans.matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(leans.matrix) == pytest.approx(1.0, abs=1e-12)
