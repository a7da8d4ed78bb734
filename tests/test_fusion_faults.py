"""Drives of a tracked robot whose sensors are biased, silent, slipping, stuck or misled."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robot_drive import HZ, RobotDrive, fuse, legs, robot_drive, sensed
from scipy.stats import chi2

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, Sensor, YawFusion
from fusion.checks.stillness import Stillness

DEG = math.radians(1.0)


@pytest.fixture(scope="module", params=[0.0, 0.1], ids=["in time", "100 ms late"])
def drive(request):
    """With images that are stamped when they were exposed, or later."""
    return robot_drive(camera_delay=request.param)


# Where the compass is sound and decides nothing: images that are late show the same in twice the time.
in_time = pytest.mark.parametrize("drive", [0.0], ids=["in time"], indirect=True)


def test_minutes_with_biased_gyro_stay_within_half_a_degree():
    drive = robot_drive(1, seconds=150.0, bias=0.5 * DEG, gyro_hz=50, track_hz=20)
    fusion, errors = fuse(drive)
    # the compass itself wanders by 5e-4 rad at each of 75 references: 0.25 deg
    assert np.abs(errors).max() < 0.5 * DEG
    estimate = fusion.estimate()
    assert abs(estimate.gyro_bias - 0.5 * DEG) < 4.0 * math.sqrt(estimate.gyro_bias_variance) < 0.001
    assert estimate.track_scale == pytest.approx(1.35, abs=0.05)
    assert errors[-1] ** 2 / estimate.yaw_variance < chi2.ppf(0.999, 1)


def test_compass_blackout_of_half_a_minute_leaves_less_than_a_degree(drive):
    fusion, errors = fuse(drive.changed(lambda s: None, YawIncrement, 20.0, 50.0))
    assert np.abs(errors).max() < 1.0 * DEG
    assert fusion.state.references_lost <= 1


def spinning(sample):
    """Tracks that spin against each other: half a rad/s claimed too much."""
    return replace(sample, yaw_rate=sample.yaw_rate + 0.5, yaw=sample.yaw + 0.5 * (sample.t_ns * 1e-9 - 15.0))


def stuck(sample):
    return replace(sample, yaw_rate=0.0, yaw=1.0)


@in_time
@pytest.mark.parametrize("fault", [spinning, stuck])
def test_total_slip_of_half_a_minute_leaves_less_than_a_degree(drive, fault):
    slipping = drive.changed(fault, OdometrySample, 15.0, 45.0)
    fusion, errors = fuse(slipping)
    assert np.abs(errors).max() < 1.0 * DEG
    assert fusion.reports()[Sensor.TRACKS].rejected > 5
    assert not fusion.estimate().slip  # over for longer than slip_recovery_time
    middle, _ = fuse(replace(slipping, samples=[s for s in slipping.samples if s.t_ns < 25_000_000_000]))
    assert middle.estimate().slip


@in_time
@pytest.mark.parametrize(
    ("name", "left_empty"),
    [
        ("pose", lambda s: replace(s, yaw=0.0)),
        ("twist", lambda s: replace(s, yaw_rate=0.0, speed=0.0)),
    ],
    ids=lambda p: p if isinstance(p, str) else "",
)
def test_driver_that_leaves_half_of_the_odometry_empty_is_understood(drive, name, left_empty):
    fusion, errors = fuse(drive.changed(left_empty, OdometrySample))
    estimate = fusion.estimate()
    assert estimate.track_scale == pytest.approx(1.35, abs=0.05)
    assert fusion.reports()[Sensor.TRACKS].rejected < 0.05 * fusion.reports()[Sensor.TRACKS].accepted
    without, _ = fuse(drive.changed(lambda s: None, YawIncrement, 25.0).changed(left_empty, OdometrySample))
    assert np.abs(errors).max() < 1.0 * DEG
    assert abs(drive.error(without.estimate())) < 1.0 * DEG


@pytest.mark.parametrize("since", [0.0, 20.0])
def test_silent_gyro_leaves_compass_and_tracks(drive, since):
    _, errors = fuse(drive.changed(lambda s: None, GyroSample, since))
    # between two images 0.1 s apart the turn rate may change by 0.3 rad/s: 0.9 deg; the compass takes it back, late
    # where its images come late: at 0.6 rad/s in the mean it sees 34 deg/s too little turned, if no gyro ever told
    assert np.sqrt(np.mean(errors**2)) < (0.5 + 30.0 * drive.camera_delay) * DEG


@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("stuck at zero", lambda s: replace(s, yaw_rate=0.0)),
        ("noise only", lambda s: replace(s, yaw_rate=0.003 * math.sin(1e-3 * s.t_ns))),
        ("bias jumped", lambda s: replace(s, yaw_rate=s.yaw_rate + 0.2)),
    ],
    ids=lambda p: p if isinstance(p, str) else "",
)
def test_broken_gyro_is_outvoted(drive, name, broken):
    fusion, errors = fuse(drive.changed(broken, GyroSample, 20.0))
    # until it is found the false rate of up to 1 rad/s is believed for half a second; without it as when it is silent
    assert np.abs(errors).max() < 30.0 * DEG
    late = max(3.0, 0.5 + 30.0 * drive.camera_delay) * DEG
    assert np.sqrt(np.mean(errors**2)) < late
    assert np.median(np.abs(errors[-50:])) < late
    assert fusion.reports()[Sensor.GYRO].rejected > 40


@pytest.mark.parametrize("seed", range(3))
def test_what_a_gyro_made_believe_until_it_was_outvoted_is_taken_back(seed):
    """Of seed 0 the robot had just stopped; it must not be held at the yaw it seemed to have by then."""
    jump_s, judged_s = 26.0, 0.8
    sick = robot_drive(seed, seconds=45.0).changed(lambda s: replace(s, yaw_rate=s.yaw_rate + 0.3), GyroSample, jump_s)
    fusion = YawFusion()
    for sample in sick.samples:
        fusion.add(sample)
        if sample.t_ns * 1e-9 > jump_s + judged_s:
            estimate = fusion.estimate()
            assert sick.error(estimate) ** 2 < 4.0**2 * estimate.yaw_variance


def test_large_bias_at_the_start_does_not_lock_the_compass_out(drive):
    fusion, errors = fuse(drive.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + 0.1), GyroSample))
    # until the first bend ends, at 5.0 s, nothing tells a gyro's scale that is off from images that are late
    assert np.abs(errors[51:]).max() < 1.0 * DEG
    assert fusion.estimate().gyro_bias == pytest.approx(0.103, abs=0.002)


def test_misled_compass_is_outvoted_by_gyro_and_tracks(drive):
    """A crowd walks round the robot: for 20 s every increment turns by 0.1 rad/s too much."""

    def misled(s):
        return replace(s, yaw=float(wrap_angle(s.yaw + 0.1e-9 * (s.t_ns - s.t_ref_ns))))

    fusion, errors = fuse(drive.changed(misled, YawIncrement, 20.0, 40.0))
    assert np.abs(errors).max() < 1.0 * DEG
    assert fusion.reports()[Sensor.COMPASS].rejected > 100
    assert fusion.estimate().gyro_bias == pytest.approx(0.003, abs=0.001)


def test_standstill_is_found_and_pins_the_bias():
    standing = robot_drive(2, seconds=30.0).changed(lambda s: None, YawIncrement)
    until = [s for s in standing.samples if s.t_ns < 2_000_000_000]  # the drive begins with two seconds of standing
    fusion, _ = fuse(replace(standing, samples=until))
    estimate = fusion.estimate()
    assert estimate.standstill
    # 200 samples of 0.003 rad/s, and a creep of 0.0005 rad/s that could not be seen
    assert abs(estimate.gyro_bias - 0.003) < 3.0 * math.hypot(0.003 / math.sqrt(200), 5e-4)
    assert math.sqrt(estimate.gyro_bias_variance) < 0.001
    turned_ns = 1e9 * standing.t[np.argmax(np.abs(standing.yaw) > 1.0 * DEG)]
    moving, _ = fuse(replace(standing, samples=[s for s in standing.samples if s.t_ns < turned_ns]))
    assert not moving.estimate().standstill


def test_robot_that_stood_is_not_known_to_stand_on_while_all_are_silent():
    """It may have turned meanwhile; held at a creep of 0.0005 rad/s, 10 s would cost 0.3 deg."""
    fusion = YawFusion()
    standing = [s for k in range(200) for s in (GyroSample(k * 10**7, 0.003), OdometrySample(k * 10**7 + 1, 0.0, 0.0))]
    for sample in standing:
        fusion.add(sample)
    assert fusion.estimate().standstill
    for sample in standing[:60]:
        fusion.add(replace(sample, t_ns=sample.t_ns + 12 * 10**9))
    assert math.sqrt(fusion.estimate().yaw_variance) > 1.0  # of up to 1 rad/s


def test_gyro_samples_before_standstill_was_found_count():
    rng = np.random.default_rng(5)
    samples = [GyroSample(i * 10**7, 0.004 + 0.003 * rng.normal()) for i in range(60)]
    samples += [OdometrySample(i * 25 * 10**6, 0.0, 0.0, 0.0) for i in range(24)]
    t = np.array([0.0, 1.0])
    fusion, _ = fuse(RobotDrive(t, 0.0 * t, sorted(samples, key=lambda s: s.t_ns)))
    estimate = fusion.estimate()
    assert estimate.standstill
    # all 60 samples and a creep of 0.0005 rad/s; those after the first half second alone would leave 1.1e-3
    assert math.sqrt(estimate.gyro_bias_variance) < 1.1 * math.hypot(0.003 / math.sqrt(60), 5e-4)
    assert abs(estimate.gyro_bias - 0.004) < 3.0 * math.sqrt(estimate.gyro_bias_variance)


@pytest.mark.parametrize("sensors", [(GyroSample, YawIncrement), (GyroSample, OdometrySample, YawIncrement)])
@pytest.mark.parametrize("rate_deg", [0.2, 1.0])
def test_slow_turn_is_not_swallowed_by_standstill(sensors, rate_deg):
    """A robot turns at a crawl for 30 s; its tracks have noise and a hidden dead zone: they say next to nothing."""
    rate, rng = rate_deg * DEG, np.random.default_rng(3)
    samples = [GyroSample(i * 10**7, rate + 0.005 + 0.003 * rng.normal()) for i in range(3000)]
    samples += [OdometrySample(i * 25 * 10**6, 0.0, 0.0, 0.0) for i in range(1200)]
    for i in range(1, 300):
        turn = rate * 0.1 * i + 5e-4 * rng.normal()
        samples.append(YawIncrement(0, i * 10**8, float(wrap_angle(turn)), 25e-8, 0.9))
    chosen = sorted((s for s in samples if isinstance(s, sensors)), key=lambda s: s.t_ns)
    t = np.arange(0.0, 31.0)
    fusion, errors = fuse(RobotDrive(t, rate * t, chosen))
    assert np.abs(errors).max() < 0.2 * DEG  # of 6 and 30 deg turned
    assert fusion.estimate().gyro_bias == pytest.approx(0.005, abs=0.001)


def test_noise_of_a_resting_gyro_is_taken_from_its_scatter():
    rng, claimed = np.random.default_rng(8), 0.0025

    def rested(sigma):
        stillness = Stillness(0)
        for i in range(100):
            stillness = stillness.with_gyro(i * 10**7, 0.004 + sigma * rng.normal(), claimed)
        return stillness

    # the scatter of 100 samples is known to 7 %
    assert rested(0.0017).gyro_noise(claimed) == pytest.approx(0.0017, rel=0.2)
    assert rested(0.0).gyro_noise(claimed) == 0.5 * claimed  # coarse steps are not silence
    assert rested(0.0017).with_gyro(10**9, 0.1, claimed).gyro_noise(claimed) == claimed


def hidden_start(seed, rate):
    """Gyro and compass of a robot that stands for 0.75 s and then turns, by `rate` (rad/s) from 0.95 s on; its yaw."""
    rng, t = np.random.default_rng(seed), np.arange(131) * 0.01
    rates = np.interp(t, [0.75, 0.95], [0.0, rate])
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1])) * 0.01])
    samples = [GyroSample(k * 10**7, float(w)) for k, w in enumerate(rates + 0.0025 * rng.normal(size=t.size))]
    for k in range(10, t.size, 10):
        sigma = 5e-6 + float(np.interp(t[k], [0.75, 1.15], [0.0, 2e-4]))  # at rest it sees best
        samples.append(YawIncrement(0, k * 10**7, float(yaw[k] + sigma * rng.normal()), sigma**2, 0.9))
    return sorted(samples, key=lambda sample: sample.t_ns), float(yaw[-1])


@pytest.mark.parametrize("rate", [0.006, 0.008, 0.01])
def test_start_that_hides_in_the_gyros_noise_is_within_the_sigma_without_tracks(rate):
    """What was turned before it showed was taken for bias and is missing in the yaw: 4 to 5 variances, unless known."""
    yaw_nees, bias_nees = [], []
    for seed in range(40):
        samples, yaw = hidden_start(seed, rate)
        fusion, stood = YawFusion(), False
        for sample in samples:
            fusion.add(sample)
            stood = stood or fusion.state.stillness.standing
        estimate = fusion.estimate()
        assert stood
        assert not estimate.standstill
        yaw_nees.append((estimate.yaw - yaw) ** 2 / estimate.yaw_variance)
        bias_nees.append(estimate.gyro_bias**2 / estimate.gyro_bias_variance)
    assert 0.4 < np.mean(yaw_nees) < 2.0
    assert 0.4 < np.mean(bias_nees) < 2.0


def test_gyro_alone_never_finds_standstill():
    rng = np.random.default_rng(6)
    rate = 0.5 * DEG  # slower than biases are: from the gyro alone nobody can tell
    samples = [GyroSample(i * 10**7, rate + 0.003 * rng.normal()) for i in range(1000)]
    t = np.array([0.0, 10.0])
    fusion, _ = fuse(RobotDrive(t, rate * t, samples))
    assert not fusion.estimate().standstill
    assert fusion.estimate().yaw == pytest.approx(rate * 9.99, rel=0.05)


def test_slow_turn_that_only_poses_tell_of_is_not_swallowed_by_standstill():
    rng = np.random.default_rng(7)
    rate = 0.3 * DEG
    samples = [GyroSample(i * 10**7, rate + 0.004 + 0.003 * rng.normal()) for i in range(2000)]
    samples += [OdometrySample(i * 25 * 10**6, 0.0, 0.0, rate * i * 0.025) for i in range(800)]
    t = np.array([0.0, 20.0])
    fusion, _ = fuse(RobotDrive(t, rate * t, sorted(samples, key=lambda s: s.t_ns)))
    assert not fusion.estimate().standstill
    estimate = fusion.estimate()
    assert abs(estimate.gyro_bias - 0.004) < 3.0 * math.sqrt(estimate.gyro_bias_variance)


def test_robot_that_stands_does_not_drift():
    rng = np.random.default_rng(4)
    samples = [GyroSample(i * 10**7, 0.004 + 0.003 * rng.normal()) for i in range(4000)]
    samples += [OdometrySample(i * 25 * 10**6, 0.0, 0.0, 0.0) for i in range(1600)]
    t = np.array([0.0, 50.0])
    _, errors = fuse(RobotDrive(t, 0.0 * t, sorted(samples, key=lambda s: s.t_ns)))
    assert abs(errors[-1] - errors[100]) < 0.03 * DEG  # gyro alone: 0.004 rad/s for 30 s, 7 deg


def with_stray_stamps(stray_s, rate, seed):
    """A robot that turns from the first moment on, and images nearly without error, each stamped a little wrongly."""
    rng = np.random.default_rng(seed)
    samples = [GyroSample(k * 2 * 10**7, float(rate + 0.003 + 0.0025 * rng.normal())) for k in range(1500)]
    samples += [
        OdometrySample(k * 4 * 10**7, 1.3 * rate, 0.0, float(wrap_angle(1.3 * rate * 0.04 * k))) for k in range(750)
    ]
    exposed = np.arange(900) / 30.0 + stray_s * rng.normal(size=900)
    for k in range(1, 900):
        since = (k - 1) // 100 * 100  # a keyframe holds for three seconds
        turn = float(wrap_angle(rate * (exposed[k] - exposed[since]) + 1e-5 * rng.normal()))
        samples.append(YawIncrement(since * 10**9 // 30, k * 10**9 // 30, turn, 1e-10, 0.99))
    return sorted(samples, key=lambda sample: sample.t_ns)


@pytest.mark.parametrize(("stray_s", "rate"), [(0.0, 1.0), (0.001, 0.4), (0.001, 1.0), (0.005, 0.4)])
def test_images_whose_stamps_stray_are_believed_as_far_as_they_may(stray_s, rate):
    """Taken for exact, one in two is refused and the others mislead: by up to 48 deg with 1 ms at 1 rad/s."""
    normalised = []
    for seed in range(3):
        fusion = YawFusion(FusionConfig(gyro_scale_sigma=0.001))  # at a constant rate it would pass for a bias
        for sample in with_stray_stamps(stray_s, rate, seed):
            fusion.add(sample)
            if isinstance(sample, YawIncrement) and sample.t_ns > 10**9:
                estimate = fusion.estimate()
                normalised.append((estimate.yaw - rate * sample.t_ns * 1e-9) ** 2 / estimate.yaw_variance)
        assert fusion.reports()[Sensor.COMPASS].rejected < 9  # one in a hundred, while the stray is being learnt
        # at 1 rad/s a scale off by one standard deviation is a bias of 0.001 rad/s
        assert fusion.estimate().gyro_bias == pytest.approx(0.003, abs=0.0015)
    assert np.mean(normalised) < 2.0


def test_copies_of_an_image_are_no_witness_of_standing():
    """The camera hangs as the robot starts; a driver that doubles images beside tracks that stand is no start."""

    def standing(*, tracks: bool) -> YawFusion:
        fusion, t_ns = YawFusion(), 0
        for k in range(1, 25):
            t_ns = 10**9 + k * 125_000_000
            unseen = 3.0 * 0.125 * max(k - 20, 0)  # at 3 rad/s
            fusion.add(YawIncrement(10**9, t_ns, 0.0, 1e-8 + unseen**2 / 3.0, 0.9))
            if tracks:
                fusion.add(OdometrySample(t_ns + 1, 0.0, 0.0, 0.0))
        return fusion

    assert math.sqrt(standing(tracks=False).estimate().yaw_variance) > math.radians(10.0)
    assert standing(tracks=True).estimate().standstill


@pytest.mark.parametrize("rate", [0.05, 0.5])
def test_robot_that_is_switched_on_while_it_is_carried_round_turns(rate):
    """Nor does it take so high a rate for a bias that tracks say zero, and then no less than the robot turns by itself.

    It was 34 deg off at 4 of sigma, and three turns at one.
    """
    rng, n = np.random.default_rng(49), 40 * HZ
    carried = np.where(np.arange(n) < 15 * HZ, rate, 0.0)
    drive = sensed(rng, *legs(rng, n), unseen=carried)
    fusion, errors = fuse(drive)
    assert np.abs(errors).max() < 1.0 * DEG
    estimate = fusion.estimate()
    assert errors[-1] ** 2 / estimate.yaw_variance < chi2.ppf(0.999, 1)
    assert estimate.gyro_bias == pytest.approx(0.003, abs=4.0 * math.sqrt(estimate.gyro_bias_variance))
