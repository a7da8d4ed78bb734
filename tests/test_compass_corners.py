"""The method `corners` as the compass runs it: turns, drives, tilts, masks, refusals, and whether it is honest."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, as_bytes, azimuths, compare, scene, seen_from, shifted, show, tilted

from compass import CompassConfig, CompassStatus, VisualCompass
from compass.features.points import find_corners
from compass.flow.coarse_shift import coarse_shift
from compass.flow.pure_turn import pooled_turn
from compass.images.strip import prepare_strip
from compass.methods import corners as method
from fusion.imu.levelling import ImuConfig
from fusion.offline.simulated import SimulatedRecording
from fusion.simulation import simulate
from fusion.simulation.worlds import HELD_OUT_WORLDS

WIDTH = 1024
PER_PX = math.tau / WIDTH
NOISE = 2.0
WALLS = ((1.0, 3.0), (20.0, 0.7), (3.0, 3.0))
WAYS = (0.0, 0.7, math.pi)


def compass(method="corners", **settings):
    return VisualCompass(CompassConfig(method=method, **settings))


def sphere(seed):
    """A full-sphere panorama."""
    return scene(seed, WIDTH, WIDTH // 2)


def driven(image, step, direction, walls):
    """It after a step (m) past a wall on the left and one on the right, at these distances (m)."""
    on_the_left = np.sin(azimuths(WIDTH) - direction) > 0.0
    return seen_from(image, step, direction, np.where(on_the_left, *walls))


def drive_errors(step, turn_px=5.37, method="corners"):
    """Errors in columns and their squares over the claimed variances, of one step in any direction past any walls."""
    rows = []
    for seed, (direction, walls) in enumerate((d, w) for d in WAYS for w in WALLS):
        image = sphere(seed)
        now = shifted(driven(image, step, direction, walls), turn_px)
        increment = compare(compass(method), as_bytes(image, NOISE, 1), as_bytes(now, NOISE, 2))
        error = increment.yaw / PER_PX - turn_px
        rows.append((error, (error * PER_PX) ** 2 / increment.variance))
    return np.array(rows).T


@pytest.mark.parametrize("columns", [0.25, 12.6, 200.4])
def test_pure_turn_is_told_by_all_rows_pooled(columns):
    images = as_bytes(sphere(0), NOISE, 1), as_bytes(shifted(sphere(0), columns), NOISE, 2)
    found = compare(compass(), *images)
    peak, _ = pooled_turn(*(prepare_strip(0, image, CompassConfig()) for image in images), columns)
    assert found.yaw / PER_PX == pytest.approx(peak.shift_px, abs=1e-6)
    assert found.yaw / PER_PX == pytest.approx(columns, abs=0.01)


def test_what_moves_corners_by_more_than_their_patches_know_widens_all_rows(monkeypatch):
    images = as_bytes(sphere(0), NOISE, 1), as_bytes(shifted(sphere(0), 12.6), NOISE, 2)
    alone, variances = method._pure_turn, []
    for noise in (0.5, 1.0, 4.0):

        def louder(key, fit, current, match, noise=noise):
            return alone(key, replace(fit, noise=np.array([noise])), current, replace(match, variance_px2=1.0))

        monkeypatch.setattr(method, "_pure_turn", louder)
        variances.append(compare(compass(), *images).variance)
    assert variances[1:] == pytest.approx([variances[0], 4.0 * variances[0]], rel=1e-9)


@pytest.mark.parametrize("width", [302, 303, 513])
def test_images_of_any_width_turn(width):
    image = scene(3, width, width // 2)
    increment = compare(compass(), as_bytes(image, 1.0, 1), as_bytes(shifted(image, 4.25), 1.0, 2))
    assert increment.yaw * width / math.tau == pytest.approx(4.25, abs=0.05)


def test_pure_turn_is_found_where_bands_of_frequency_disagree():
    images = as_bytes(sphere(0), NOISE, 1), as_bytes(shifted(sphere(0), -3.3), NOISE, 2)
    assert compare(compass(), *images).yaw / PER_PX == pytest.approx(-3.3, abs=0.01)


def test_turn_of_identical_frames_has_full_confidence():
    increment = compare(compass(), as_bytes(sphere(1)), np.roll(as_bytes(sphere(1)), 7, axis=1))
    assert increment.confidence == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("step", [0.01, 0.03, 0.1])
def test_step_past_walls_is_no_turn_and_the_variance_is_honest(step):
    error, squared = drive_errors(step)
    # a track is good to some hundredths of a column, two hundred of them to some thousandths; walls end abruptly
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert 0.2 < squared.mean() < 4.0  # nine errors: chi-square's 99.9 % interval is 0.13 to 3.1


def test_step_past_walls_errs_by_less_than_with_the_papers_method():
    ours, papers = (np.sqrt(np.mean(drive_errors(0.03, method=method)[0] ** 2)) for method in ("corners", "rows"))
    assert ours < papers / 20.0


def test_drive_that_is_reversed_is_the_opposite_turn():
    image = sphere(2)
    now = shifted(driven(image, 0.03, 0.7, (1.0, 3.0)), 8.2)
    frames = as_bytes(image, NOISE, 1), as_bytes(now, NOISE, 2)
    there, back = (compare(compass(), *pair) for pair in (frames, frames[::-1]))
    assert abs(there.yaw + back.yaw) < 3.0 * math.sqrt(there.variance + back.variance)


def test_tilt_is_told_from_a_turn():
    image = sphere(3)
    now = tilted(driven(image, 0.03, 0.0, (1.0, 3.0)), 0.01, -0.02)
    increment = compare(compass(), as_bytes(image, NOISE, 1), as_bytes(shifted(now, 4.0), NOISE, 2))
    assert increment.tilt == pytest.approx((0.01, -0.02), abs=0.2 * PER_PX)
    assert increment.turn / PER_PX == pytest.approx(4.0, abs=0.06)


def test_long_drive_keeps_its_keyframe_and_does_not_drift():
    image, engine = sphere(4), compass()
    frames = [as_bytes(shifted(driven(image, 0.008 * k, 0.0, (1.5, 3.0)), 1.7 * k), NOISE, k) for k in range(20)]
    references = set()
    for k, frame in enumerate(frames):
        increment = engine.update(k * FRAME_NS, frame)
        if increment is not None:
            references.add(increment.t_ref_ns)
    assert engine.counts[CompassStatus.OK] == 19
    assert 2 <= len(references) <= 7  # parts of the view move apart by up to 1.3 columns an image
    assert engine.yaw / PER_PX == pytest.approx(1.7 * 19, abs=0.15)
    assert abs(engine.yaw - 1.7 * 19 * PER_PX) < 4.0 * math.sqrt(engine.yaw_variance)


def test_things_that_move_by_themselves_are_outliers():
    image = sphere(5)
    now = driven(image, 0.03, 0.0, (2.0, 3.0))
    for at in (100, 420, 700):  # three people of 80 columns, each its own way
        now[:, at : at + 80] = image[:, at + at // 50 - 8 : at + at // 50 + 72]
    increment = compare(compass(), as_bytes(image, NOISE, 1), as_bytes(shifted(now, 3.0), NOISE, 2))
    assert increment.yaw / PER_PX == pytest.approx(3.0, abs=0.1)


def test_exposure_does_not_matter():
    image = sphere(6)
    now = shifted(driven(image, 0.03, 0.7, (1.0, 3.0)), 2.5)
    plain, bright = (compare(compass(), as_bytes(image), as_bytes(one)) for one in (now, 0.6 * now + 20.0))
    assert abs(plain.yaw - bright.yaw) < 0.03 * PER_PX


def test_mast_that_a_mask_hides_does_not_matter(tmp_path):
    mask = np.zeros((WIDTH // 2, WIDTH), np.uint8)
    mask[:, 300:400] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    image = sphere(7).copy()
    now = shifted(driven(image, 0.05, 0.0, (1.0, 3.0)), 6.4)
    mast = np.random.default_rng(0).uniform(0, 255, (WIDTH // 2, 100))
    for one in (image, now):
        one[:, 300:400] = mast
    engine = compass(mask=str(tmp_path / "mask.png"))
    increment = compare(engine, as_bytes(image, NOISE, 1), as_bytes(now, NOISE, 2))
    assert increment.yaw / PER_PX == pytest.approx(6.4, abs=0.1)


def test_unrelated_places_give_no_increment():
    for seed in range(6):
        engine = compass()
        assert show(engine, as_bytes(sphere(seed), NOISE, 1), as_bytes(sphere(seed + 10), NOISE, 2)) is None
        assert engine.status is CompassStatus.LOW_CONFIDENCE


def test_image_that_shows_another_place_does_not_mislead_the_next():
    frames = [as_bytes(shifted(driven(sphere(14), 0.01 * k, 0.0, (1.0, 3.0)), 5.0 * k), NOISE, k) for k in range(6)]
    frames[3] = as_bytes(sphere(15), NOISE, 3)
    engine = compass()
    show(engine, *frames)
    assert engine.counts[CompassStatus.LOW_CONFIDENCE] == 1
    assert engine.status is CompassStatus.OK
    assert engine.yaw / PER_PX == pytest.approx(25.0, abs=0.1)


def test_wrong_peak_of_the_coarse_shift_does_not_mislead(monkeypatch):
    """What repeats itself has its highest peak elsewhere at times: 13 columns off, as beside parked cars."""
    frames = [as_bytes(shifted(driven(sphere(16), 0.01 * k, 0.0, (1.0, 3.0)), 0.5 * k), NOISE, k) for k in range(6)]
    engine, asked = compass(), []

    def misled(*arguments):
        asked.append(coarse_shift(*arguments))
        return replace(asked[-1], shift_px=asked[-1].shift_px + 13 * (len(asked) == 4))

    monkeypatch.setattr("compass.methods.corners.coarse_shift", misled)
    show(engine, *frames)
    assert engine.counts[CompassStatus.OK] == 5
    assert engine.yaw / PER_PX == pytest.approx(2.5, abs=0.1)


def test_pillars_that_look_alike_are_not_taken_for_each_other():
    """Beside a row of pillars the highest peak is 16 columns off in one image, where most corners fit to it."""
    drive = simulate("forward7_outdoor", 6, worlds=HELD_OUT_WORLDS)
    exposed_ns = drive.frame_truth.t_ns
    level = SimulatedRecording(drive, ImuConfig()).gyro.up_at
    engine = VisualCompass(CompassConfig(), lambda t_ns: level(int(exposed_ns[drive.frame_t_ns == t_ns][0])))
    errors = []
    for index, (t_ns, image) in enumerate(drive.frames()):
        engine.update(t_ns, image)
        errors.append(engine.yaw - drive.truth.yaw_at(exposed_ns[index]) + drive.truth.yaw_at(exposed_ns[0]))
        if index == 14:
            break
    assert np.abs(np.degrees(errors)).max() < 0.05


def test_place_that_looks_the_same_all_round_is_ambiguous():
    part = as_bytes(np.tile(scene(8, WIDTH // 4, WIDTH // 2), (1, 4)))
    engine = compass(max_yaw_rate=50.0)
    assert show(engine, part, np.roll(part, 5, axis=1)) is None
    assert engine.status is CompassStatus.AMBIGUOUS


@pytest.mark.parametrize("shape", [(512, 128), (8, 1024), (30, 1024)])
def test_image_too_small_for_corners_is_measured_all_the_same(shape):
    image = as_bytes(scene(9, shape[1], shape[0]), 1.0, 1)
    increment = compare(compass(roi_top=0.0, roi_bottom=1.0), image, np.roll(image, 4, axis=1))
    assert increment.yaw * shape[1] / math.tau == pytest.approx(4.0, abs=0.3)


def test_plain_walls_without_corners_are_measured_all_the_same():
    stripes = np.tile(scene(10, WIDTH, 1), (WIDTH // 2, 1))
    increment = compare(compass(), as_bytes(stripes, NOISE, 1), as_bytes(shifted(stripes, 5.5), NOISE, 2))
    assert increment.yaw / PER_PX == pytest.approx(5.5, abs=0.1)


def test_corners_on_one_side_only_are_not_believed(monkeypatch):
    """What is seen on one side only turns by as much as it is passed: sectors answer, and say how badly they know."""

    def to_the_right(picture):
        at = find_corners(picture)
        return at[at[:, 0] < 350]

    monkeypatch.setattr("compass.methods.corners.find_corners", to_the_right)
    engine = compass()
    frames = [as_bytes(driven(sphere(17), 0.02 * k, 0.0, (1.0, 3.0)), NOISE, k) for k in range(6)]
    show(engine, *frames)
    assert engine.yaw**2 < 9.0 * engine.yaw_variance
    assert math.sqrt(engine.yaw_variance) > 0.1 * PER_PX


def test_same_frames_give_the_same_yaw_to_the_last_bit():
    frames = [as_bytes(driven(sphere(11), 0.02 * k, 0.3, (1.0, 3.0)), NOISE, k) for k in range(6)]
    yaws = []
    for _ in range(2):
        engine = compass()
        show(engine, *frames)
        yaws.append(engine.yaw)
    assert yaws[0] == yaws[1]


def test_reset_forgets_what_was_tracked():
    frames = [as_bytes(driven(sphere(12), 0.02 * k, 0.3, (1.0, 3.0)), NOISE, k) for k in range(5)]
    fresh, used = compass(), compass()
    show(used, *frames[::-1])
    used.reset()
    show(used, *frames)
    show(fresh, *frames)
    assert used.yaw == fresh.yaw


@pytest.mark.parametrize("spread", [-1.0, 0.0])
def test_settings_say_how_long_a_keyframe_lasts(spread):
    engine = compass(keyframe_spread=spread)
    frames = [as_bytes(driven(sphere(13), 0.004 * k, 0.0, (1.0, 3.0)), NOISE, k) for k in range(4)]
    increment = show(engine, *frames, t_ns=0)
    assert increment.t_ref_ns == (0 if spread < 0.0 else 2 * FRAME_NS)


BARS = np.where(np.random.default_rng(0).random(512) > 0.5, 200, 50).astype(np.uint8)


@pytest.mark.parametrize(
    "row",
    [BARS, np.where(np.arange(512) // 40 == 3, 200, 60).astype(np.uint8), np.abs(np.arange(512) - 256).clip(0, 255)],
    ids=["bars", "one bar", "gradient"],
)
def test_image_without_any_corner_is_matched_by_its_rows(row):
    """Upright bars have edges and no corners: none to be cut out, and none to be counted."""
    compass = VisualCompass()
    for k in range(6):
        compass.update(10**18 + k * FRAME_NS, np.tile(np.roll(row, 3 * k).astype(np.uint8), (256, 1)))
        compass.long_baseline()
        assert compass.status is (CompassStatus.OK if k else CompassStatus.FIRST_FRAME)
    assert compass.yaw == pytest.approx(15 * math.tau / 512, abs=1e-3)


def test_what_is_lost_of_a_view_costs_no_answer():
    """Near walls leave a view at once, and what they hid comes in: what is left of it tells the turn all the same."""
    for seed in range(3):
        before, now = sphere(seed + 20), shifted(sphere(seed + 20), 6.4)
        for first in range(0, WIDTH, WIDTH // 4):
            now[:, first : first + WIDTH // 10] = sphere(seed + 30)[:, first : first + WIDTH // 10]
        engine = compass()
        increment = compare(engine, as_bytes(before, NOISE, 1), as_bytes(now, NOISE, 2))
        assert increment.yaw / PER_PX == pytest.approx(6.4, abs=0.05)
