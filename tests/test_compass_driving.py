"""What the compass promises while it is driven: past walls, tilted, with an IMU and without, horizon and crowd."""

import math
from functools import cache

import numpy as np
import pytest
from panoramas import (
    PHOTO_NAMES,
    as_bytes,
    azimuths,
    compare,
    photo,
    scene,
    seen_from,
    shifted,
    show,
    slanting,
    tilted,
)
from scipy.spatial.transform import Rotation

from compass import CompassConfig, CompassStatus, VisualCompass
from compass.tilt import tilt_between

WIDTH, HEIGHT, NOISE = 1024, 512, 2.0
PER_RAD = WIDTH / math.tau
LEVEL = (0.0, 0.0, 1.0)
WAYS = {"forward": 0.0, "backward": math.pi, "aslant": 0.7}
TILTS = {"pitch": (0.0, 1.0), "roll": (1.0, 0.0), "both": (0.6, 0.8)}


@cache
def panorama(seed=1):
    return scene(seed, WIDTH, HEIGHT)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def walls(left, right, direction):
    """Distance at each azimuth to two long walls along the way, at most 6 m."""
    across = np.sin(azimuths(WIDTH) - direction)
    return np.minimum(np.where(across > 0.0, left, right) / np.maximum(np.abs(across), 1e-3), 6.0)


@cache
def driven(method, direction, left, right, degrees=0.0):
    """Errors, columns, of a step of 3 cm past walls with a turn of 5.37 columns and a tilt."""
    errors = []
    for seed in (1, 2):
        after = seen_from(panorama(seed), 0.03, direction, walls(left, right, direction))
        after = shifted(tilted(after, *np.deg2rad([0.6 * degrees, 0.8 * degrees])), 5.37)
        compass = VisualCompass(CompassConfig(method=method))
        increment = compare(compass, as_bytes(panorama(seed), NOISE, seed), as_bytes(after, NOISE, 100 + seed))
        errors.append(increment.yaw * PER_RAD - 5.37)
    return np.array(errors)


@pytest.mark.parametrize("direction", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize(("left", "right"), [(1.0, 3.0), (20.0, 0.7), (3.0, 3.0)])
def test_driving_past_walls_turns_the_default_far_less_than_the_papers_method(left, right, direction):
    error, paper = (rms(driven(method, direction, left, right)) for method in (CompassConfig().method, "rows"))
    print(f"{error:.3f} columns, by rows {paper:.3f}")
    assert error < 0.05  # of a column, half of what a single sector knows
    assert error < max(paper / 5.0, 0.02)


@pytest.mark.parametrize("direction", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize(("degrees", "limit_px"), [(0.3, 0.05), (1.0, 0.15)])
def test_tilt_while_driving_hardly_changes_the_turn(direction, degrees, limit_px):
    # a degree moves the upper edge of the region by 2.8 columns, to either side: a twentieth of it may remain
    level, leaning = (driven(CompassConfig().method, direction, 1.0, 3.0, angle) for angle in (0.0, degrees))
    assert np.abs(leaning - level).max() < limit_px


@pytest.mark.parametrize("about", TILTS)
@pytest.mark.parametrize("degrees", [0.1, 0.3, 1.0])
def test_tilt_hardly_changes_a_turn(degrees, about):
    # at 45 deg, the upper edge, a tilt moves columns by as much as it lifts the horizon: a twentieth of that may remain
    limit_px = 0.05 * math.radians(degrees) * PER_RAD
    for seed in (1, 2):
        after = shifted(tilted(panorama(seed), *np.deg2rad(degrees) * np.array(TILTS[about])), 5.37)
        increment = compare(VisualCompass(), as_bytes(panorama(seed), NOISE, 1), as_bytes(after, NOISE, 2))
        assert abs(increment.yaw * PER_RAD - 5.37) < limit_px


@pytest.mark.parametrize("step", [0.03, 0.06])
def test_driving_beside_a_slanting_wall_does_not_turn_the_compass(step):
    slant = slanting(panorama())
    distance = np.minimum(1.0 / np.maximum(np.abs(np.sin(azimuths(WIDTH))), 1e-3), 6.0)
    after = shifted(seen_from(slant, step, 0.0, distance), 5.37)
    increment = compare(VisualCompass(), as_bytes(slant, NOISE, 1), as_bytes(after, NOISE, 2))
    assert increment.yaw * PER_RAD == pytest.approx(5.37, abs=0.08)


@pytest.mark.parametrize("direction", [0.0, math.pi], ids=["forward", "backward"])
def test_drive_along_the_axis_of_a_symmetric_view_does_not_turn(direction):
    # ahead is the edge between two columns: azimuths half a column off turn this by 0.005 to 0.012 columns, one way
    distance = 1.0 / (1.0 + 0.5 * np.abs(np.sin(azimuths(WIDTH))))
    turns = []
    for seed in range(3):
        view = scene(seed, WIDTH, HEIGHT)
        view = 127.5 + 0.7 * (view + view[:, ::-1] - 255.0)
        after = seen_from(view, 6.0 * math.tau / WIDTH, direction, distance)
        turns.append(compare(VisualCompass(), as_bytes(view), as_bytes(after)).yaw * PER_RAD)
    assert np.abs(turns).max() < 0.004


def past_walls_and_somebody(seed, columns):
    """Increment of a step with a turn of 5.37 columns; somebody so wide on the left walks ahead."""
    before = panorama(seed).copy()
    after = shifted(seen_from(before, 0.03, 0.0, 1.0 / (1.0 + 0.5 * np.cos(2.0 * azimuths(WIDTH)))), 5.37)
    somebody = scene(100 + seed, WIDTH, HEIGHT)[:, 300 : 300 + columns]
    before[:, 300 : 300 + columns] = somebody
    after[:, 312 : 312 + columns] = somebody  # to the right, where nothing is pushed that stands there
    return compare(VisualCompass(), as_bytes(before, NOISE, 1), as_bytes(after, NOISE, 2))


def test_somebody_who_walks_through_does_not_turn_the_compass():
    empty, seen = ([past_walls_and_somebody(seed, columns) for seed in range(1, 9)] for columns in (0, 90))
    variance = np.array([increment.variance for increment in seen])
    error = np.array([increment.yaw for increment in seen]) - 5.37 / PER_RAD
    widened = np.median([one.variance / other.variance for one, other in zip(seen, empty, strict=True)])
    print(f"{rms(error) * PER_RAD:.3f} columns, err2/var {np.mean(error**2 / variance):.2f}, widened {widened:.1f}")
    assert np.abs(error / np.sqrt(variance)).max() < 3.0
    assert rms(error) * PER_RAD < 0.03
    assert widened > 1.0


def on_other_rows(image, above, below):
    """The image with so many rows added (or cut off, where negative), and settings that look at the same pixels."""
    upper, lower = (np.full((max(rows, 0), WIDTH), 128, np.uint8) for rows in (above, below))
    kept = image[max(-above, 0) : HEIGHT - max(-below, 0)]
    height = HEIGHT + above + below
    top, bottom = round(0.25 * HEIGHT), round(0.55 * HEIGHT)
    config = CompassConfig(
        roi_top=(top + above) / height, roi_bottom=(bottom + above) / height, horizon_row=(HEIGHT / 2 + above) / height
    )
    return np.vstack([upper, kept, lower]), config


@pytest.mark.parametrize(("above", "below"), [(-100, 0), (-100, -150), (60, 0), (0, 90), (-40, 200)])
def test_horizon_elsewhere_in_the_image_gives_the_same_turn(above, below):
    after = shifted(tilted(seen_from(panorama(), 2.0 / PER_RAD, 0.7, 1.0), *np.deg2rad([0.2, -0.1])), 3.3)
    before, now = as_bytes(panorama(), NOISE, 1), as_bytes(after, NOISE, 2)
    (other_before, config), (other_now, _) = (on_other_rows(image, above, below) for image in (before, now))
    turns = [
        compare(VisualCompass(settings), *pair).yaw
        for settings, pair in ((None, (before, now)), (config, (other_before, other_now)))
    ]
    # the same rows of the same pixels: what differs is the rounding of a fraction
    assert turns[0] == pytest.approx(turns[1], abs=1e-7)


# ---------------------------------------------------------------- an IMU that tells how the camera leans


def up_of(attitude):
    return tuple(attitude.inv().apply([0.0, 0.0, 1.0]).tolist())


def camera_after(before, tilt, turn):
    """Attitude of a camera whose scene rotated by `tilt` before it turned."""
    return before * Rotation.from_rotvec([-tilt[0], -tilt[1], 0.0]) * Rotation.from_rotvec([0.0, 0.0, turn])


@pytest.mark.parametrize("seed", range(20))
def test_tilt_is_the_one_that_brings_one_vertical_over_the_other(seed):
    rng = np.random.default_rng(seed)
    before = Rotation.from_euler("ZYX", rng.uniform([-3.0, -0.6, -0.6], [3.0, 0.6, 0.6]))
    tilt, turn = rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0)
    found = tilt_between(up_of(before), up_of(camera_after(before, tilt, turn)), turn)
    assert found == pytest.approx(tilt, abs=1e-12)


def test_turn_on_a_slope_is_no_tilt():
    slope = Rotation.from_euler("y", 20.0, degrees=True)
    for turn in (0.0, 0.5, -2.0, 3.1):
        found = tilt_between(up_of(slope), up_of(slope * Rotation.from_euler("z", turn)), turn)
        assert found == pytest.approx((0.0, 0.0), abs=1e-12)


def swaying(before, seed, told):
    """Increment of a camera that drove past things, turned and tilted, and the true turn, rad."""
    rng = np.random.default_rng(seed)
    tilt, turn_px = np.deg2rad(rng.uniform(-3.0, 3.0, 2)), rng.uniform(-30.0, 30.0)
    far = 1.0 / (0.6 + 0.4 * np.cos(2.0 * azimuths(WIDTH) - rng.uniform(0.0, 6.0)))
    now = shifted(tilted(seen_from(before, 0.02, 0.0, far), *tilt), turn_px)
    up = up_of(camera_after(Rotation.identity(), tilt, turn_px / PER_RAD))
    compass = VisualCompass(CompassConfig(), (lambda t_ns: up if t_ns else LEVEL) if told else None)
    compass.update(0, as_bytes(before, 2.0, seed))
    return compass.update(10**8, as_bytes(now, 2.0, seed + 100)), turn_px / PER_RAD


def photographs(seed):
    return photo(PHOTO_NAMES[seed % len(PHOTO_NAMES)])


@pytest.mark.parametrize(("told", "more"), [(True, 1.0), (False, 1.5)], ids=["told by an IMU", "untold"])
@pytest.mark.parametrize(("pictures", "largest_px"), [(panorama, 0.08), (photographs, 0.1)])
def test_camera_that_tilts_sees_its_turn(pictures, largest_px, told, more):
    errors, variances = [], []
    for seed in range(12):
        increment, turn = swaying(pictures(seed), seed, told)
        errors.append(increment.turn - turn)
        variances.append(increment.variance)
    print(f"{rms(errors) * PER_RAD:.3f} columns, err2/var {np.mean(np.square(errors) / variances):.2f}")
    assert rms(errors) * PER_RAD < more * largest_px
    assert np.mean(np.square(errors) / variances) < 3.0  # they allow for an IMU's errors, and here it has none


@pytest.mark.parametrize("degrees", [2.0, 10.0])
def test_imu_that_errs_does_no_harm(degrees):
    """The view itself tells that it has not tilted so."""
    wrong = up_of(Rotation.from_euler("y", degrees, degrees=True))
    image = scene(0, WIDTH, HEIGHT)
    images = as_bytes(image, 1.0, 1), as_bytes(shifted(seen_from(image, 0.02, 0.0, 1.5), 12.3), 1.0, 2)
    turns = []
    for at in (lambda t_ns: None, lambda t_ns: wrong if t_ns else LEVEL):
        compass = VisualCompass(CompassConfig(), at)
        compass.update(0, images[0])
        turns.append(compass.update(10**8, images[1]).turn)
    assert turns[0] == pytest.approx(12.3 / PER_RAD, abs=0.03 / PER_RAD)
    assert turns[1] == pytest.approx(turns[0], abs=0.01 / PER_RAD)


@pytest.mark.parametrize("up", [None, LEVEL, up_of(Rotation.from_euler("y", 0.1))], ids=["unknown", "level", "pitched"])
def test_nothing_in_common_is_no_turn_whatever_the_imu_tells(up):
    compass = VisualCompass(CompassConfig(), lambda t_ns: LEVEL if t_ns < 10**9 else up)
    assert show(compass, as_bytes(panorama(3)), as_bytes(panorama(13)), t_ns=10**9 - 10**8) is None
    assert compass.status is CompassStatus.LOW_CONFIDENCE
