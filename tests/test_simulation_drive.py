"""Simulated drives: motion, sensors and frames against their models, determinism, and the cache of frames."""

import zipfile

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compass.errors import VisualCompassError
from fusion.simulation import EXPERIMENTS, Effects, ImuModel, PanoramaCamera, Surface, simulate
from fusion.simulation.effects import NO_EFFECTS, FrameEffects
from fusion.simulation.imu import read_imu
from fusion.simulation.robot import read_tracks
from fusion.simulation.trajectory import Ground, Trajectory, curve, spin, stand, straight

SMALL = PanoramaCamera(128, 64)
PERFECT = ImuModel(*[0.0] * 9)


def drive(*legs, **how):
    return Trajectory((stand(1.0), *legs, stand(1.0)), **how)


MIXED = drive(straight(2.0, 0.5), curve(90, 1.0, 0.4), spin(-200, 0.8), wobble=0.01, unsteady=0.15, wander=0.03)


# Motion


def test_yaw_is_the_integral_of_the_yaw_rate():
    t = np.arange(0.0, MIXED.duration, 1e-3)
    motion = MIXED.at(t)
    integrated = np.concatenate([[0.0], np.cumsum((motion.yaw_rate[1:] + motion.yaw_rate[:-1]) / 2e3)])
    # Trapezoidal rule at 1 kHz: dt^2 / 12 * (rate' at the ends, 0) plus rounding.
    assert np.abs(motion.yaw - motion.yaw[0] - integrated).max() < 1e-6


def test_total_turn_and_way_are_those_of_the_legs():
    end = MIXED.at(np.array([MIXED.duration]))
    assert np.rad2deg(end.yaw[0]) == pytest.approx(90.0 - 200.0, abs=1e-9)
    assert end.speed[0] == pytest.approx(0.0, abs=1e-12)
    assert end.yaw_rate[0] == pytest.approx(0.0, abs=1e-12)
    ahead = drive(straight(3.0, 0.5), start=(1.0, 2.0, np.pi / 2)).at(np.array([0.0, 100.0]))
    assert (ahead.x[1], ahead.y[1]) == pytest.approx((1.0, 5.0), abs=1e-6)


def test_bend_ends_where_the_circle_ends():
    end = drive(curve(180, 1.5, 0.4), ramp=1e-3).at(np.array([100.0]))
    # A ramp of 1 ms shifts the end by less than speed * ramp.
    assert (end.x[0], end.y[0]) == pytest.approx((0.0, 3.0), abs=4e-4)


def test_tilt_is_the_slope_of_the_ground():
    bumpy = drive(straight(3.0, 0.5), start=(0.3, -0.7, 0.8), ground=Ground(0.02, 6))
    now = bumpy.at(np.array([3.0]))
    step, left = 1e-4, (-np.sin(now.yaw), np.cos(now.yaw))

    def height(ahead, aside):
        x = now.x + ahead * np.cos(now.yaw) + aside * left[0]
        y = now.y + ahead * np.sin(now.yaw) + aside * left[1]
        return bumpy.ground.slope(x, y)[0][0]

    up = (height(step, 0) - height(-step, 0)) / (2 * step)
    raised = (height(0, step) - height(0, -step)) / (2 * step)
    assert abs(up) > 0.01  # there is a slope at all
    assert np.tan(now.pitch[0]) == pytest.approx(-up, rel=1e-5)  # nose down is positive
    # The left side's slope seen in the pitched frame: exact for Rz Ry Rx.
    assert np.tan(now.roll[0]) == pytest.approx(raised * np.cos(now.pitch[0]), rel=1e-5)


# Inertial unit


def test_rates_on_rough_ground_give_the_yaw_rate_back():
    bumpy = drive(straight(1.0, 0.5), curve(120, 1.0, 0.4), spin(90, 0.8), ground=Ground(0.03, 2))
    readings = read_imu(bumpy, PERFECT, np.random.default_rng(0), 0)
    motion = bumpy.at(np.array([reading.t_ns for reading in readings]) * 1e-9)
    _, wy, wz = np.array([reading.angular_velocity for reading in readings]).T
    yaw_rate = (wy * np.sin(motion.roll) + wz * np.cos(motion.roll)) / np.cos(motion.pitch)
    assert np.abs(motion.roll).max() > np.deg2rad(3)
    assert np.abs(yaw_rate - motion.yaw_rate).max() < 1e-9
    assert np.abs(wz - motion.yaw_rate).max() > 1e-3  # and without roll and pitch it would be wrong


def test_accelerometer_feels_gravity_at_rest_and_the_centre_in_a_bend():
    bend = drive(curve(360, 2.0, 0.5))
    readings = read_imu(bend, PERFECT, np.random.default_rng(0), 0)
    assert readings[10].linear_acceleration == pytest.approx((0.0, 0.0, 9.80665), abs=1e-6)
    # v^2 / r to the left; positions interpolated at 1 kHz leave 1 % in the second difference over 10 ms.
    assert readings[len(readings) // 2].linear_acceleration[1] == pytest.approx(0.5**2 / 2.0, rel=0.03)


def test_gyro_noise_and_bias_are_those_of_the_data_sheet():
    standing = drive(stand(18.0))
    rates = []
    for seed in range(40):
        readings = read_imu(standing, ImuModel(), np.random.default_rng(seed), 0)
        rates.append([reading.angular_velocity[2] for reading in readings])
    rates = np.rad2deg(rates)
    # White noise of density d sampled at 100 Hz deviates by 10 d; 2000 samples know it to 1.6 %.
    assert rates[0].std() == pytest.approx(0.1, rel=0.06)
    # 40 draws of 0.2 deg/s: their deviation is known to 11 %, taken three times.
    assert rates.mean(axis=1).std() == pytest.approx(0.2, rel=0.33)


def test_orientation_holds_roll_and_pitch_and_drifts_in_yaw():
    drive_ = simulate("rough_ground", seed=1)
    yaw, pitch, roll = Rotation.from_quat([reading.orientation for reading in drive_.imu]).as_euler("ZYX").T
    truth = drive_.truth
    t = np.array([reading.t_ns for reading in drive_.imu])
    true_pitch, true_roll = np.interp(t, truth.t_ns, truth.pitch), np.interp(t, truth.t_ns, truth.roll)
    for error in (pitch - true_pitch, roll - true_roll):
        assert np.rad2deg(error.std()) < 0.5  # 0.2 deg correlated over 5 s: few independent values in 35 s
        assert np.rad2deg(np.abs(error).max()) < 1.0
    assert abs(np.unwrap(yaw)[-1] - truth.yaw[-1]) > 1e-4


# Tracks


def test_tracks_claim_the_scale_of_the_ground_and_nothing_at_rest():
    even = Surface(scale=1.4, scale_spread=0.0, unsteady=0.0, slips=0.0)
    readings = read_tracks(drive(spin(360, 0.8), stand(3.0)), even, np.random.default_rng(0), 0)
    # One count of 0.5 mm on either track is 2.5e-3 rad; the mismatch of the tracks (0.3 % deviation) cancels in a spin.
    assert readings[-1].yaw == pytest.approx(1.4 * 2.0 * np.pi, abs=6e-3)
    assert all(reading.speed == 0.0 and reading.yaw_rate == 0.0 for reading in readings[-80:])


def test_track_pose_is_the_sum_of_its_twists():
    readings = simulate("square20", seed=2).odometry
    dt = np.diff([reading.t_ns for reading in readings]) * 1e-9
    rates = np.array([reading.yaw_rate for reading in readings])[1:]
    assert readings[-1].yaw == pytest.approx(np.sum(rates * dt), abs=1e-6)


def test_slipping_track_claims_turns_that_do_not_happen():
    slippery = Surface(scale=1.0, scale_spread=0.0, unsteady=0.0, slips=0.5)
    readings = read_tracks(drive(straight(10.0, 0.5)), slippery, np.random.default_rng(3), 0)
    assert max(abs(reading.yaw_rate) for reading in readings) > 0.1


# Experiments


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_robot_touches_nothing(name):
    experiment = EXPERIMENTS[name]
    motion = experiment.trajectory.at(np.arange(0.0, experiment.trajectory.duration, 0.2))
    world = experiment.world()
    assert world.clearance(motion.x, motion.y) > 0.35  # half the robot's width and a hand's breadth
    assert world.clearance(motion.x, motion.y, headroom=np.inf) > 0.15  # nor is the camera below anything
    for t, x, y in zip(motion.t, motion.x, motion.y, strict=True):
        for solid in world.crowd(t):
            middle = (solid.low[0] + solid.high[0]) / 2.0, (solid.low[1] + solid.high[1]) / 2.0
            assert np.hypot(middle[0] - x, middle[1] - y) > 0.6, f"somebody is run over at {t} s"


@pytest.mark.parametrize(
    ("name", "turn", "way"),
    [
        ("spin3_indoor", 1080, 0),
        ("spin5_yard", 1800, 0),
        ("forward6_passage", 0, 6),
        ("forward25_outdoor", 0, 25),
        ("free_race_passage", 360, 16),
        ("square20", 360, 20),
    ],
)
def test_experiment_turns_and_drives_as_in_the_paper(name, turn, way):
    truth = simulate(name).truth
    assert np.rad2deg(truth.yaw[-1]) == pytest.approx(turn, abs=1e-6)
    driven = np.sum(truth.speed[1:] * np.diff(truth.t_ns) * 1e-9)
    assert driven == pytest.approx(way, abs=1.0)  # small bends at the ends of the passage come on top


def test_truth_starts_at_zero_and_contains_every_frame():
    for name in EXPERIMENTS:
        drive_ = simulate(name)
        truth = drive_.truth
        assert (np.diff(truth.t_ns) > 0).all()
        assert truth.x[0] == truth.y[0] == truth.yaw[0] == 0.0
        assert np.isin(drive_.frame_truth.t_ns, truth.t_ns).all()
        assert np.array_equal(truth.yaw_at(drive_.frame_truth.t_ns), drive_.frame_truth.yaw)
        assert drive_.imu[0].t_ns <= drive_.frame_t_ns[0] <= drive_.frame_t_ns[-1] <= drive_.imu[-1].t_ns + 10_000_000


def test_images_are_stamped_late_and_stray_each_drive_in_its_own_way():
    late = []
    for seed in range(40):
        drive_ = simulate("spin5_yard", seed)
        seconds = 1e-9 * (drive_.frame_t_ns - drive_.frame_truth.t_ns)
        assert (np.diff(drive_.frame_t_ns) > 0).all()
        late.append((seconds.mean(), seconds.std()))
    delay, stray = np.array(late).T
    assert delay.min() > -1e-3
    assert delay.max() < 0.041
    assert delay.mean() == pytest.approx(0.02, abs=3 * 0.0116 / np.sqrt(40))
    assert 0.8e-5 < stray.min() < 1e-4
    assert 1e-3 < stray.max() < 3.3e-3
    assert np.array_equal(simulate("spin5_yard", 3).frame_t_ns, simulate("spin5_yard", 3).frame_t_ns)


def test_synthetic_pictures_are_stamped_when_they_are_exposed():
    drive_ = simulate("shifted", 1)
    assert np.array_equal(drive_.frame_t_ns, drive_.frame_truth.t_ns)


def test_shifted_pictures_are_whole_columns_apart():
    columns = simulate("shifted").frame_truth.yaw * 1024 / (2.0 * np.pi)
    assert np.abs(columns - np.rint(columns)).max() < 1e-6
    assert columns[-1] == pytest.approx(-256)


def test_shifted_pictures_move_as_the_robot_would_turn(tmp_path):
    drive_ = simulate("shifted", cache=tmp_path, camera=PanoramaCamera(1024, 64))
    first, last = drive_.frame(0), drive_.frame(len(drive_) - 1)
    assert np.abs(np.roll(first, -256, axis=1).astype(int) - last).max() <= 1  # rounding


def test_unknown_experiment_suggests_the_nearest():
    with pytest.raises(VisualCompassError, match="spin3_indoor"):
        simulate("spin3_indor")


def test_drive_does_not_tell_which_experiment_it_is():
    drive_ = simulate("weave")
    assert not any("weave" in repr(value) for value in (drive_.imu[0], drive_.odometry[0], drive_.truth))
    assert not hasattr(drive_, "name")


# Determinism and the cache


def few_frames(drive_):
    return [drive_.frame(index).tobytes() for index in (0, 5, len(drive_) - 1)]


def test_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path):
    first, second = (simulate("forward6_passage", 3, cache=tmp_path / "a", camera=SMALL) for _ in range(2))
    other = simulate("forward6_passage", 4, cache=tmp_path / "a", camera=SMALL)
    elsewhere = simulate("forward6_passage", 3, cache=tmp_path / "b", workers=1, camera=SMALL)
    assert first.imu == second.imu
    assert first.odometry == second.odometry
    assert few_frames(first) == few_frames(second) == few_frames(elsewhere)
    assert first.imu != other.imu
    assert first.odometry != other.odometry
    assert few_frames(first) != few_frames(other)
    assert np.array_equal(first.truth.yaw, other.truth.yaw)


def test_frames_are_rendered_once_for_the_seeds_of_a_world(tmp_path):
    calls = []
    for seed in (0, 1, 7):
        drive_ = simulate("forward6_passage", seed, cache=tmp_path, camera=SMALL)
        drive_.prepare(lambda done, count, seed=seed: calls.append((seed, done, count)))
    assert [call for call in calls if call[0] == 0][-1] == (0, 169, 169)
    assert not [call for call in calls if call[0] == 1]
    assert [call for call in calls if call[0] == 7]  # another world
    assert len(list(tmp_path.iterdir())) == 2


def test_frames_that_are_not_kept_are_the_same_and_leave_no_file(tmp_path):
    kept, anew = (
        simulate("shifted", 2, worlds="rubble", cache=tmp_path / str(k), camera=SMALL, keep=k) for k in (1, 0)
    )
    assert few_frames(kept) == few_frames(anew)
    assert (tmp_path / "1").exists()
    assert not (tmp_path / "0").exists()


def test_scenes_of_one_held_out_place_do_not_throw_each_other_out(tmp_path):
    for seed in (0, 1):
        simulate("shifted", seed, worlds="rubble", cache=tmp_path, camera=SMALL).prepare()
    assert len(list(tmp_path.iterdir())) == 2


def test_another_camera_is_another_cache_file(tmp_path):
    for camera in (SMALL, PanoramaCamera(64, 32)):
        assert simulate("shifted", cache=tmp_path, camera=camera).frame(0).shape == (camera.height, camera.width)


@pytest.mark.parametrize("damage", ["truncated", "scratched", "not an archive"])
def test_broken_cache_file_is_made_anew(tmp_path, damage):
    whole = few_frames(simulate("shifted", cache=tmp_path, camera=SMALL))
    (path,) = tmp_path.iterdir()
    data = bytearray(path.read_bytes())
    if damage == "truncated":
        data = data[: len(data) // 2]
    elif damage == "scratched":
        data[len(data) // 2] ^= 0xFF
    else:
        data = bytearray(b"no archive")
    path.write_bytes(data)
    assert few_frames(simulate("shifted", cache=tmp_path, camera=SMALL)) == whole
    assert zipfile.ZipFile(path).testzip() is None


def test_frames_are_kept_in_memory_where_nothing_can_be_written(tmp_path, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    drive_ = simulate("shifted", cache=blocked, camera=SMALL)
    assert drive_.frame(0).shape == (64, 128)
    assert "VISUAL_COMPASS_CACHE" in caplog.text


def test_cache_directory_is_the_users_and_can_be_moved(tmp_path, monkeypatch):
    monkeypatch.setenv("VISUAL_COMPASS_CACHE", str(tmp_path / "mine"))
    simulate("shifted", camera=SMALL).prepare()
    assert [path.suffix for path in (tmp_path / "mine").iterdir()] == [".zip"]


# What the camera adds


def grey_frames(effects, count=40, level=100, seed=0, rate=0.0):
    times = np.arange(count) / 10.0
    made = FrameEffects(effects, times, np.full(count, rate), seed)
    clean = np.full((64, 512), level, np.uint8)
    return np.array([made.apply(index, clean) for index in range(count)], np.float64)


def test_noise_has_the_deviation_asked_for():
    frames = grey_frames(Effects(noise=2.0, shot_noise=0.0, exposure=0, exposure_steps=0, vignette=0, body="none"))
    # Rounding adds 1/12; 1.3 million samples know the deviation to 0.06 %.
    assert frames.std() == pytest.approx(np.sqrt(4.0 + 1.0 / 12.0), rel=0.003)


def test_no_two_frames_share_noise_wherever_it_is_moved_to():
    effects = Effects(noise=2.0, shot_noise=0.0, exposure=0, exposure_steps=0, vignette=0, body="none")
    frames = grey_frames(effects, count=12).reshape(12, -1)
    frames -= frames.mean(axis=1, keepdims=True)
    spectra = np.fft.rfft(frames / np.linalg.norm(frames, axis=1, keepdims=True))
    for one in range(12):
        for other in range(one):
            # the greatest of 32768 correlations of deviation 1 / sqrt(32768): 66 pairs, one in 10^5 above 7.2
            assert np.abs(np.fft.irfft(spectra[one] * spectra[other].conj())).max() < 7.2 / np.sqrt(32768)


def test_exposure_changes_brightness_by_seed():
    brightness = [grey_frames(Effects(exposure=0.05, body="none"), seed=seed).mean(axis=(1, 2)) for seed in (0, 1)]
    assert np.ptp(brightness[0]) > 1.0
    assert not np.allclose(brightness[0], brightness[1], atol=0.5)


def test_dark_gap_is_dark_and_nothing_else():
    frames = grey_frames(Effects(dark=(1.0, 2.0), exposure_steps=0.0, body="none"))
    dark = frames.mean(axis=(1, 2)) < 5.0
    assert np.flatnonzero(dark).tolist() == list(range(10, 20))


def test_body_stands_still_below_the_region_of_interest():
    made = FrameEffects(Effects(noise=0, shot_noise=0, exposure=0, exposure_steps=0), np.arange(2.0), np.zeros(2), 0)
    dark, bright = (made.apply(0, np.full((512, 1024), level, np.uint8)).astype(int) for level in (50, 200))
    same = np.abs(dark - bright) < 20
    assert not same[:282].any()  # region of interest, to 0.55
    assert same[412:].all()  # the deck's edge at 0.3 m aside, 0.38 m below: 52 deg down


def test_no_effects_leave_the_picture_as_it_is():
    assert (grey_frames(NO_EFFECTS, count=3, rate=1.0) == 100.0).all()


def test_turning_smears_by_the_shutter_and_shifts_nothing():
    made = FrameEffects(Effects(0, 0, 0, 0, 0.01, 0, "none"), np.arange(2.0), np.array([0.0, 0.8]), 0)
    clean = np.zeros((4, 1024), np.uint8)
    clean[:, 500] = 240
    line = made.apply(1, clean)[0].astype(float)
    columns = np.arange(1024) - 500
    assert line @ columns == 0.0
    smear = 0.8 * 0.01 * 1024 / (2 * np.pi)
    # A box of that width has the variance smear^2 / 12; 8 bit rounding of two taps of 17 is within 3 %.
    assert (line @ columns**2) / line.sum() == pytest.approx(smear**2 / 12.0, rel=0.03)


def test_jpeg_frames_are_the_frames(tmp_path):
    drive_ = simulate("shifted", cache=tmp_path, camera=SMALL)
    stamps, files = zip(*drive_.jpeg_frames(), strict=True)
    assert list(stamps) == drive_.frame_t_ns.tolist()
    decoded = cv2.imdecode(np.frombuffer(files[7], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.abs(decoded.astype(float) - drive_.frame(7)).mean() < 3.0
