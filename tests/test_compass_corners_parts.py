"""What the method `corners` is made of: the density of a parallax, tangent planes, tracks, and the ascent."""

import math
from dataclasses import replace

import numpy as np
import pytest
from panoramas import as_bytes, scene, shifted
from scipy.stats import exponnorm

from compass import CompassConfig
from compass.agreement import AGREE
from compass.features.bearings import Projection, Tangents, undo
from compass.features.density import exponentially_modified
from compass.features.motion import Motion, parallax_score, yaw_variance
from compass.features.padded_strip import MARGIN, WINDOW, Picture
from compass.features.points import cut_patches, find_corners, sample
from compass.features.prior import precision_of
from compass.features.solver import MEANS_PX, Problem, Start, State, ascend, condition, even_shares
from compass.features.tracking import track
from compass.flow.correlation import TINY
from compass.images.strip import prepare_strip

PER_PX = math.tau / 1024


@pytest.mark.parametrize("ratio", [0.01, 0.3, 1.0, 5.0, 20.0])
def test_density_is_that_of_a_normal_plus_an_exponential(ratio):
    at = np.linspace(-6.0, 60.0, 2001)
    density, slope, bend = exponentially_modified(at, np.full_like(at, ratio))
    expected = exponnorm.pdf(at, 1.0 / ratio)
    seen = expected > 1e-200
    assert density[seen] / math.sqrt(math.tau) == pytest.approx(expected[seen], rel=1e-9)
    step = 1e-5
    above, below = (np.log(exponentially_modified(at[seen] + d, np.full(seen.sum(), ratio))[0]) for d in (step, -step))
    assert slope[seen] == pytest.approx((above - below) / (2 * step), abs=1e-5 * (1.0 + ratio))
    assert (bend >= 0.0).all()


def test_density_of_the_farthest_outliers_is_finite():
    density, slope, bend = exponentially_modified(np.array([-1e4, -50.0, 50.0, 1e4]), np.array([[1e-3], [60.0]]))
    for values in (density, slope, bend):
        assert np.isfinite(values).all()


def directions(count, seed=0):
    """(3, n) unit vectors, not farther up or down than 50 deg."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-math.pi, math.pi, count), rng.uniform(-0.2, 0.9, count)
    return np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def test_columns_and_rows_of_directions_are_those_they_were_made_of():
    projection = Projection(PER_PX, PER_PX, 512.0, 0.7)
    at = np.random.default_rng(0).uniform((0, 0), (1024, 150), (50, 2))
    assert projection.pixels(projection.directions(at)) == pytest.approx(at, abs=1e-9)


def test_turn_to_the_left_moves_what_is_ahead_to_the_right():
    projection = Projection(PER_PX, PER_PX, 512.0, 0.7)
    seen = undo(0.1, 0.0, 0.0).T @ np.array([[1.0], [0.0], [0.0]])
    assert projection.pixels(seen)[0, 0] == pytest.approx(511.5 + 0.1 / PER_PX)


def test_parallax_stays_on_a_straight_line_away_from_the_travel():
    ahead, travel = directions(40), np.array([math.cos(0.4), math.sin(0.4), 0.1])
    tangents = Tangents.at(ahead)
    line = travel @ tangents.axes
    for inverse in (0.01, 0.3):
        seen = ahead - inverse * travel[:, None]
        image = tangents.project(seen / np.linalg.norm(seen, axis=0))
        assert (image * line.conj()).imag == pytest.approx(np.zeros(40), abs=1e-12)
        assert ((image * line.conj()).real < 0.0).all()


def test_rotation_moves_directions_as_its_derivative_says():
    tangents, seen, step = Tangents.at(directions(40)), directions(40, seed=1), 1e-6
    for which, angles in enumerate(np.eye(3) * step):
        moved = tangents.project(undo(*angles) @ seen) - tangents.project(seen)
        assert moved / step == pytest.approx(tangents.rotating(seen)[which], abs=1e-5)


def picture(image, seed=0, noise=0.0):
    config = CompassConfig(roi_top=0.0, roi_bottom=1.0)
    return Picture(prepare_strip(0, as_bytes(image, noise, seed), config))


def test_interpolation_is_exact_for_cubics_and_does_not_know_whole_pixels():
    row, column = np.mgrid[0:40, 0:200].astype(np.float32)
    pixels = np.asarray(0.01 * column**2 + 0.2 * row + 0.001 * row * column, np.float32)
    at = np.array([[30.0, 20.0], [30.25, 20.0], [30.5, 19.75]], np.float32)
    middle = sample(pixels, at)[:, 60]
    x, y = (at + np.float32([64.0, 0.0])).T
    assert middle == pytest.approx(0.01 * x**2 + 0.2 * y + 0.001 * x * y, rel=1e-5)


@pytest.mark.parametrize("columns", [0.0, 0.25, 0.5, 3.75, -6.2])
def test_tracks_follow_parts_of_a_column(columns):
    image = scene(0, 1024, 128)
    before, now = picture(image, 1, 1.0), picture(shifted(image, columns), 2, 1.0)
    patches = cut_patches(before, find_corners(before))
    found = track(before, patches, now, patches.at + np.float32([round(columns), 0]))
    moved = found.at - patches.at[found.index]
    # bilinear or OpenCV's cubic interpolation would pull by 0.04 columns at a quarter of one
    assert np.median(moved[:, 0]) == pytest.approx(columns, abs=0.006)
    assert np.median(moved[:, 1]) == pytest.approx(0.0, abs=0.006)
    assert found.index.size > 0.9 * len(patches)


def test_tracks_go_round_the_circle():
    image = scene(1, 1024, 128)
    before, now = picture(image), picture(shifted(image, 500.0))
    patches = cut_patches(before, find_corners(before))
    found = track(before, patches, now, patches.at + np.float32([500.0, 0.0]))
    moved = (found.at[:, 0] - patches.at[found.index, 0]) % 1024
    assert found.index.size == len(patches)
    assert moved == pytest.approx(np.full(moved.size, 500.0), abs=0.05)


@pytest.mark.parametrize("width", [256, 301, 1024])
def test_farthest_track_is_cut_within_the_margin(width):
    soft, farthest = picture(scene(3, width, 64)).soft, MARGIN - WINDOW.side
    for column in (-farthest, width - 0.01 + farthest):
        cut = sample(soft, np.float32([[column, 30.0]]))
        # the picture goes on round the circle
        assert cut == pytest.approx(sample(soft, np.float32([[column % width, 30.0]])), abs=0.05)


def test_corners_are_spread_over_the_circle():
    at = find_corners(picture(scene(2, 1024, 128)))
    assert np.bincount((at[:, 0] // 128).astype(int), minlength=8).min() >= 20


SIGMA = 0.05 * PER_PX
TRUTH = np.array([0.02, 0.004, -0.003, 0.8, 0.02])


def synthetic(count=200, outliers=0.0, seed=0, pushed=True):
    """A problem whose answer is `TRUTH`: half of the corners far away, half near; noise of a twentieth of a column."""
    rng = np.random.default_rng(seed)
    ahead = directions(count, seed)
    travel = np.array(
        [math.cos(TRUTH[3]) * math.cos(TRUTH[4]), math.sin(TRUTH[3]) * math.cos(TRUTH[4]), math.sin(TRUTH[4])]
    )
    inverse = np.where(rng.random(count) < 0.5, 0.0, rng.exponential(0.02, count)) * pushed
    seen = ahead - inverse * travel[:, None]
    seen = undo(*TRUTH[:3]).T @ (seen / np.linalg.norm(seen, axis=0))
    tangents = Tangents.at(ahead)
    start = np.array([0.02, 0.0, 0.0, 0.0, 0.0])
    now = undo(*start[:3]) @ seen
    moved = tangents.project(now)
    moved = moved + SIGMA * (rng.normal(size=count) + 1j * rng.normal(size=count))
    wrong = rng.random(count) < outliers
    moved[wrong] += 10.0 * PER_PX * (rng.normal(size=wrong.sum()) + 1j * rng.normal(size=wrong.sum()))
    covariance = np.stack([np.full(count, SIGMA**2, complex), np.zeros(count, complex)])
    precision = np.array([0.0, 400.0, 400.0, 0.0, 200.0])
    return Problem(tangents, moved, tangents.rotating(now), start, covariance, start, precision, PER_PX, PER_PX)


@pytest.mark.parametrize("outliers", [0.0, 0.25])
def test_motion_of_synthetic_corners_is_found(outliers):
    for seed in range(5):
        motion = Motion.unknown()
        fit = motion.follow(synthetic(outliers=outliers, seed=seed))
        state = fit.states[0]
        assert motion.travels
        # of 200 corners with 0.05 columns each
        assert state[State.YAW] == pytest.approx(TRUTH[State.YAW], abs=0.03 * PER_PX)
        assert state[[State.TILT_X, State.TILT_Y]] == pytest.approx(TRUTH[1:3], abs=0.03 * PER_PX)
        assert math.remainder(state[State.DIRECTION] - TRUTH[3], math.tau) == pytest.approx(0.0, abs=0.1)
        assert fit.noise[0] == pytest.approx(0.6, abs=0.3)  # a t of 3 degrees of freedom is wider than its scale
        assert fit.inlier.mean() == pytest.approx(1.0 - outliers, abs=0.1)


def test_motion_that_goes_on_is_left_only_for_a_likelier_one():
    for seed in range(5):
        motion = Motion.unknown()
        motion.follow(synthetic(seed=seed))
        problem = synthetic(outliers=0.4, seed=seed)  # so many that all directions are tried anew
        problem.start[State.DIRECTION :] = motion.start.states[0, State.DIRECTION :]
        continued = motion._continued(problem)
        fit = motion.follow(problem)
        assert fit.inlier.mean() < AGREE
        assert fit.log_posterior[0] >= continued.log_posterior[0]
        assert fit.states[0, State.YAW] == pytest.approx(TRUTH[State.YAW], abs=0.05 * PER_PX)


def test_turn_without_travel_is_recognised():
    for seed in range(5):
        motion = Motion.unknown()
        fit = motion.follow(synthetic(seed=seed, pushed=False))
        assert not motion.travels
        assert fit.shares[0].size == 2
        assert fit.states[0, State.YAW] == pytest.approx(TRUTH[State.YAW], abs=0.02 * PER_PX)


def test_score_of_a_turn_is_small_and_of_a_drive_large():
    extra, start = np.zeros(6), Start(synthetic().start[None], even_shares(pushed=False), np.ones(1))
    for pushed, low, high in ((False, 0.0, 4.0), (True, 6.0, math.inf)):
        problem = synthetic(pushed=pushed)
        assert low < parallax_score(ascend(problem, start, extra, pushed=False), problem) < high


def test_slope_of_the_posterior_is_its_derivative():
    problem = synthetic(seed=3)
    alone = replace(
        problem.tangents, sector=np.arange(problem.moved.size)
    )  # neighbours share what lies along their lines
    problem = replace(problem, tangents=alone)
    shares, step = np.array([[0.4, 0.1, 0.2, 0.2, 0.1]]), 1e-7
    assert shares.shape[1] == MEANS_PX.size + 2
    state = TRUTH + np.array([1e-4, 2e-4, -1e-4, 0.05, 0.01])

    def at(change):
        return ascend(problem, Start((state + change)[None], shares, np.ones(1)), np.zeros(0))

    prior = problem.prior_precision * (state - problem.prior_mean)
    for which in range(5):
        change = step * np.eye(5)[which]
        numeric = (at(change).log_posterior[0] - at(-change).log_posterior[0]) / (2.0 * step)
        slope = at(0.0).slopes[0, which].sum() - prior[which]
        # the corners' own scales are hidden variables, which the slope holds and the difference does not: along only
        assert slope == pytest.approx(numeric, rel=0.2, abs=300.0)


def test_pictures_on_white_walls_are_as_many_distances():
    """Three pictures, ten corners each, while the camera swings 2 cm aside: three parallaxes, not thirty."""
    errors = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        azimuth = np.repeat(rng.uniform(0.0, math.tau) + np.array([0.0, 2.3, 4.2]), 10) + rng.uniform(-0.1, 0.1, 30)
        elevation = rng.uniform(0.05, 0.5, 30)
        level = np.cos(elevation)
        ahead = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        inverse = np.repeat(0.02 / rng.uniform(2.0, 4.0, 3), 10) * level  # of upright walls
        seen = ahead - inverse * np.array([0.0, 1.0, 0.0])[:, None]
        seen /= np.linalg.norm(seen, axis=0)
        tangents = Tangents.at(ahead)
        moved = tangents.project(seen) + 0.4 * SIGMA * (rng.normal(size=30) + 1j * rng.normal(size=30))
        covariance = np.stack([np.full(30, (0.4 * SIGMA) ** 2, complex), np.zeros(30, complex)])
        precision = np.array([0.0, 400.0, 400.0, 0.0, 400.0])
        problem = Problem(
            tangents, moved, tangents.rotating(seen), np.zeros(5), covariance, np.zeros(5), precision, PER_PX, PER_PX
        )
        motion = Motion.unknown()
        fit = motion.follow(problem)
        yaw = float(fit.states[0, State.YAW])
        errors.append(yaw)
        assert abs(yaw) < 4.0 * math.sqrt(yaw_variance(fit, tangents.sector, motion.travels))
    assert np.sqrt(np.mean(np.square(errors))) < 0.1 * PER_PX  # as thirty distances they push it by 0.24


def test_one_exact_corner_among_outliers_can_be_solved_for():
    """Without it an update of one corridor after a gap raised an error: a tenth of such matrices are singular."""
    told = np.random.default_rng(0).normal(size=(300, 5))
    precision = 1e12 * told[:, :, None] * told[:, None] + np.diag(precision_of() + TINY)
    condition(precision)
    assert np.isfinite(np.linalg.solve(precision, told[..., None])).all()


def test_noise_is_told_by_residuals_across():
    for factor in (0.25, 4.0):
        problem = synthetic(400, seed=4)
        problem.covariance[0] *= factor
        fit = Motion.unknown().follow(problem)
        assert fit.noise[0] * factor == pytest.approx(0.6, abs=0.3)
