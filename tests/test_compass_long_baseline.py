"""The turn from a view some seconds ago, by corners that are found again to hundredths of a pixel."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, PHOTO_NAMES, START_NS, as_bytes, azimuths, photo, scene, seen_from, shifted

from compass import CompassConfig, CompassStatus, VisualCompass, wrap_angle
from compass.features.bearings import Tangents, undo
from compass.features.matching import Corners, follow_landmarks
from compass.features.motion import narrowing
from compass.features.patch_alignment import align
from compass.features.solver import ascend
from compass.images.strip import prepare_strip
from compass.methods.match import Search
from compass.tilt import GOOD_FOR_S
from fusion import FusionConfig, YawPipeline

WIDTH, HEIGHT = 1024, 512
PER_RAD = WIDTH / math.tau
EVERY = 9  # images between two looks back, at 10 Hz


def strip(image, t_ns):
    return prepare_strip(t_ns, as_bytes(image, 2.0, t_ns), CompassConfig())


def test_patches_are_found_again_moved_stretched_sheared_and_dimmed():
    before = scene(3, WIDTH, 256)
    at = np.random.default_rng(0).uniform((40, 40), (WIDTH - 40, 216), (60, 2))
    bend = np.array([[1.15, 0.08], [-0.05, 1.1]])  # from after to before, as cv2 asks for
    middle = np.array([WIDTH / 2, 128.0])
    from_after = np.column_stack([bend, middle - bend @ middle + (3.3, -1.7)])
    after = cv2.warpAffine(
        before, from_after, (WIDTH, 256), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    true = (at - from_after[:, 2]) @ np.linalg.inv(bend).T
    inside = np.all((true > 20) & (true < (WIDTH - 20, 236)), axis=1)
    start = true + np.random.default_rng(1).uniform(-1.0, 1.0, true.shape)
    found, likeness, _ = align(before, 0.7 * after + 20.0, at[inside], start[inside])
    off = np.hypot(*(found - true[inside]).T)
    assert inside.sum() > 40
    assert np.median(off) < 0.03
    assert np.mean((off < 0.1) & (likeness > 0.95)) > 0.9


def test_a_patch_that_is_not_there_is_not_alike():
    at = np.random.default_rng(0).uniform((40, 40), (WIDTH - 40, 216), (60, 2))
    likeness = align(scene(3, WIDTH, 256), scene(4, WIDTH, 256), at, at)[1]
    assert np.mean(likeness > 0.85) < 0.05


def test_covariance_of_a_patch_is_that_of_its_errors():
    rng = np.random.default_rng(7)
    picture = scene(3, WIDTH, 256)
    at = rng.uniform((40, 40), (WIDTH - 40, 216), (200, 2))
    errors, claimed = [], []
    for _ in range(6):
        noisy = picture + rng.normal(0.0, 4.0, picture.shape).astype(np.float32)
        found, _, covariance = align(picture, noisy, at, at)
        errors.append(found - at)
        claimed.append(covariance)
    error, covariance = np.concatenate(errors), np.concatenate(claimed)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    assert 1.5 < squared.mean() < 3.5  # 2 degrees of freedom, and what is not linear


def test_along_an_edge_a_patch_is_known_badly_and_it_says_so():
    across = cv2.GaussianBlur(np.where(np.arange(200) < 100, 60.0, 190.0)[None].repeat(100, 0), (0, 0), 1.0)
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, *across.shape))
    before, after = (across + one for one in noise)
    at = np.array([[100.0, 50.0]])
    covariance = align(before.astype(np.float32), after.astype(np.float32), at, at)[2][0]
    assert covariance[0, 0] < 0.01**2
    assert covariance[1, 1] > 30.0**2 * covariance[0, 0]


def test_what_is_badly_known_along_edges_does_not_turn_the_motion():
    """Edges on one side, found again too low: an honest covariance leaves the turn to the rest."""
    rng, turn, direction, count = np.random.default_rng(2), 0.3, 0.4, 200
    azimuth, elevation = rng.uniform(-math.pi, math.pi, count), rng.uniform(-0.5, 0.5, count)
    seen = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
    again = seen * rng.uniform(2.0, 6.0, count) - 0.5 * np.array([[math.cos(direction)], [math.sin(direction)], [0.0]])
    again = undo(turn, 0.0, 0.0).T @ again
    seen, again = (one / np.linalg.norm(one, axis=0) for one in (seen, again))
    edges = np.sin(azimuth - direction) > 0.5
    again[2] -= 3e-3 * np.abs(rng.normal(size=count)) * edges
    again /= np.linalg.norm(again, axis=0)
    mean = np.array([turn + 0.01, 0.0, 0.0, 0.0, 0.0])

    def turn_by(upwards):
        left, up = 1e-9 * np.ones(count), 1e-9 + upwards * edges
        covariance = np.stack([0.5 * (left + up), 0.5 * (left - up)]).astype(complex)
        corners = Corners(Tangents.at(seen), again, covariance, np.zeros((count, 2)), 1.0 / PER_RAD)
        fit = corners.motions(mean, 0.01)
        start = fit.only(fit.best)
        for _ in range(3):
            start = ascend(corners.problem(start.states[0], mean), start, narrowing(1.0 / PER_RAD, goes_on=True))
        return start.states[0, 0]

    alike, told = turn_by(0.0), turn_by(3e-3**2)
    assert abs(told - turn) < 0.1 * abs(alike - turn)
    assert abs(told - turn) < math.radians(0.01)


def past_walls(image, direction, left, right, step):
    """A panorama after a step (m) between two walls so far away."""
    on_the_left = np.sin(azimuths(WIDTH) - direction) > 0.0
    return seen_from(image, step, direction, np.where(on_the_left, left, right))


@pytest.mark.parametrize(("step", "left", "right"), [(0.0, 3.0, 3.0), (1.0, 3.0, 3.0), (0.3, 1.5, 4.0)])
def test_turn_of_photographs_is_right_to_a_hundredth_of_a_degree(step, left, right):
    errors = []
    for name in PHOTO_NAMES:
        before = strip(photo(name), 1)
        for seed in range(4):
            direction, turn = np.random.default_rng(seed).uniform(-math.pi, math.pi, 2)
            after = shifted(past_walls(photo(name), direction, left, right, step), turn * PER_RAD)
            match = follow_landmarks(before, strip(after, 2 + seed), Search(turn * PER_RAD + 0.3, 0.5, WIDTH / 2))
            assert match.status is CompassStatus.OK
            errors.append((wrap_angle(match.shift_px / PER_RAD - turn), match.variance_px2 / PER_RAD**2))
    error, variance = np.array(errors).T
    rms_deg = math.degrees(np.sqrt(np.mean(error**2)))
    print(f"RMS {rms_deg:.4f} deg, squared over variance {np.mean(error**2 / variance):.2f}")
    assert rms_deg < 0.015
    assert np.mean(error**2 / variance) < 2.0


def test_another_place_is_not_followed():
    match = follow_landmarks(
        strip(scene(1, WIDTH, HEIGHT), 1), strip(scene(2, WIDTH, HEIGHT), 2), Search(0.0, 0.5, 512.0)
    )
    assert match.status is CompassStatus.LOW_CONFIDENCE
    empty, later = (strip(np.full((HEIGHT, WIDTH), 90.0, np.float32), noise) for noise in (3, 4))
    assert follow_landmarks(empty, later, Search(0.0, 0.5, 512.0)).status is CompassStatus.LOW_CONFIDENCE


def drive(seconds, turn_px):
    """A camera that goes 0.1 m/s between two walls and turns by so many columns a second, 10 images a second."""
    place = scene(5, WIDTH, HEIGHT)
    for k in range(round(10 * seconds)):
        view = past_walls(place, 0.3, 2.0, 3.0, 0.01 * k)
        yield START_NS + k * FRAME_NS, as_bytes(shifted(view, 0.1 * k * turn_px), 2.0, k)


def looked_back(compass, images):
    """What looking back gave."""
    far = []
    for t_ns, image in images:
        compass.update(t_ns, image)
        far.append(compass.long_baseline())
    return far


def test_looking_back_is_seldom_and_its_references_are_ends():
    far = looked_back(VisualCompass(), drive(6.0, 20.0))
    given = [one for one in far if one]
    assert [k for k, one in enumerate(far) if one] == list(range(EVERY, 60, EVERY))
    ends = {START_NS} | {one.t_ns for one in given}
    assert all(
        one.long_baseline and one.t_ref_ns in ends and one.t_ns - one.t_ref_ns <= GOOD_FOR_S * 1e9 for one in given
    )
    assert len({one.t_ref_ns for one in given}) == 2  # a view is kept for some seconds
    for one in given:
        turn = 20.0 / PER_RAD * (one.t_ns - one.t_ref_ns) * 1e-9
        assert abs(one.yaw - turn) < math.radians(0.03)
        assert one.variance < math.radians(0.02) ** 2


def test_a_look_may_be_taken_later_while_images_go_on():
    images = list(drive(4.2, 20.0))
    at_once = looked_back(VisualCompass(), images)
    compass, waiting, later = VisualCompass(), None, []
    for k, (t_ns, image) in enumerate(images):
        compass.update(t_ns, image)
        if waiting and k % EVERY == 4:
            later.append(waiting())
            waiting = None
        waiting = waiting or compass.due_long_baseline()
    assert later == [one for one in at_once if one]


def test_a_look_that_ends_after_a_new_start_changes_nothing():
    compass, images = VisualCompass(), list(drive(3.0, 20.0))
    looked_back(compass, images[:EVERY])
    compass.update(*images[EVERY])
    look = compass.due_long_baseline()
    compass.reset()
    assert look().long_baseline
    far = looked_back(compass, images[EVERY + 1 : 2 * EVERY + 2])
    assert far[-1].t_ref_ns == images[EVERY + 1][0]


@pytest.mark.parametrize("fields", [{"long_baseline_interval": 0.0}, {"method": "sectors"}, {"method": "rows"}])
def test_nobody_looks_back_who_shall_not(fields):
    assert not any(looked_back(VisualCompass(CompassConfig(**fields)), drive(2.0, 20.0)))


def test_a_turn_that_the_increments_contradict_is_refused_and_the_view_left(monkeypatch):
    def misled(*views):
        match = follow_landmarks(*views)
        return replace(match, shift_px=match.shift_px + 2.0)

    compass, images = VisualCompass(), list(drive(4.0, 20.0))
    assert looked_back(compass, images[: EVERY + 1])[-1]
    monkeypatch.setattr("compass.features.long_baseline.follow_landmarks", misled)
    assert not any(looked_back(compass, images[EVERY + 1 : 2 * EVERY + 1]))
    monkeypatch.undo()
    far = looked_back(compass, images[2 * EVERY + 1 : 3 * EVERY + 1])
    assert far[-1].t_ref_ns == images[2 * EVERY][0]


def test_pipeline_fuses_both_and_knows_the_yaw_better_than_from_image_to_image():
    yaw = {}
    for every in (0.0, 0.9):
        # nobody else says when it turned
        pipeline = YawPipeline(
            CompassConfig(long_baseline_interval=every), FusionConfig(camera_delay_sigma=0.0, compass_timing=0.0)
        )
        for t_ns, image in drive(8.0, 15.0):
            pipeline.add_image(t_ns, image)
        estimate = pipeline.estimate()
        yaw[every] = abs(estimate.yaw - 15.0 / PER_RAD * 7.9), math.sqrt(estimate.yaw_variance)
        assert pipeline.compass.yaw == pytest.approx(15.0 / PER_RAD * 7.9, abs=math.radians(0.3))
    assert yaw[0.9][0] < math.radians(0.03)
    assert yaw[0.9][1] < 0.7 * yaw[0.0][1]
