"""The fused yaw of simple, exactly known motions."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from compass import YawIncrement, wrap_angle
from fusion import FusionConfig, GyroSample, OdometrySample, Sensor, YawFusion

SENSORS = ("gyro", "tracks", "compass")
SUBSETS = [tuple(s for i, s in enumerate(SENSORS) if mask >> i & 1) for mask in range(1, 8)]
STARTS = [math.radians(d) for d in (0.0, 60.0, 180.0, -120.0)] + [math.pi - 1e-9, -math.pi + 1e-9]


def turning(rate, seconds, sensors=SENSORS, bias=0.0, scale=1.0, pose=True):
    """Exact samples of a constant turn rate, in the order of their stamps."""
    samples = []
    if "gyro" in sensors:
        samples += [GyroSample(i * 10_000_000, rate + bias) for i in range(round(100 * seconds) + 1)]
    if "tracks" in sensors:
        stamps = [i * 20_000_000 for i in range(round(50 * seconds) + 1)]
        samples += [OdometrySample(t, scale * rate, 0.3, scale * rate * t * 1e-9 if pose else None) for t in stamps]
    if "compass" in sensors:
        step = float(wrap_angle(rate * 0.1))
        stamps = [i * 100_000_000 for i in range(round(10 * seconds) + 1)]
        samples += [YawIncrement(a, b, step, 1e-6, 0.9) for a, b in pairwise(stamps)]
    return sorted(samples, key=lambda sample: sample.t_ns)


def fused(samples, config=None):
    fusion = YawFusion(config)
    for sample in samples:
        fusion.add(sample)
    return fusion.estimate()


@pytest.mark.parametrize("sensors", SUBSETS, ids="+".join)
@pytest.mark.parametrize("start", STARTS)
def test_yaw_of_constant_turn_from_any_start(sensors, start):
    estimate = fused(turning(0.5, 10.0, sensors, pose=start < 1.0), FusionConfig(initial_yaw=start))
    # exact samples: what remains is the first sample's doubt whether the rate is rate, bias or scale
    assert abs(estimate.yaw - start - 5.0) < 4.0 * math.sqrt(estimate.yaw_variance)
    if "compass" in sensors:
        assert abs(estimate.yaw - start - 5.0) < 1e-3  # ten increments a second of 1e-3 rad noise each, noise-free
    assert -math.pi <= estimate.heading < math.pi
    assert math.isclose(math.cos(estimate.heading), math.cos(estimate.yaw), abs_tol=1e-9)


def test_estimate_before_first_sample_is_none():
    assert YawFusion().estimate() is None


@pytest.mark.parametrize("pose", [True, False])
def test_bias_and_scale_are_learned_with_compass(pose):
    estimate = fused(turning(0.5, 60.0, bias=0.01, scale=0.9, pose=pose))
    # 8e-5 rad last for 6 s, 60 steps: the sum of 600 wanders by 8e-5 * sqrt(2 * 60 * 600) = 0.0215 rad, white noise of
    # 1e-3 rad by 1e-3 * sqrt(600) = 0.0245 rad: in 60 s together a bias of 0.00054 rad/s. At a constant rate a gyro
    # scale that is off by 0.01 passes for a bias of 0.005 rad/s; and the bias at the end is off its mean by what it
    # walks, 2e-5 * sqrt(60 / 3) = 0.00009 rad/s.
    bound = math.hypot(0.00054, 0.005, 0.00009)
    assert abs(estimate.gyro_bias - 0.01) < 3.0 * math.sqrt(estimate.gyro_bias_variance) < 3.0 * bound
    assert abs(estimate.track_scale - 0.9) < 3.0 * math.sqrt(estimate.track_scale_variance) < 0.1


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (GyroSample(1, math.nan), "gyro: not finite"),
        (GyroSample(1, 0.0, variance=0.0), "gyro: variance not positive"),
        (GyroSample(-1, 0.0), "gyro: negative stamp"),
        (OdometrySample(1, 0.0, math.inf), "tracks: not finite"),
        (YawIncrement(0, 1, 0.1, -1.0, 0.5), "compass: variance not positive"),
        (YawIncrement(1, 1, 0.1, 1.0, 0.5), "compass: reference not before the image"),
    ],
)
def test_unusable_sample_is_refused_and_counted(sample, reason):
    fusion = YawFusion()
    assert not fusion.add(sample)
    assert fusion.counts == {reason: 1}
    assert fusion.estimate() is None


def test_foreign_object_raises_type_error():
    with pytest.raises(TypeError, match="ndarray is not a sample"):
        YawFusion().add(np.zeros(3))


@pytest.mark.parametrize("first", SENSORS)
def test_sensors_that_start_late_join(first):
    samples = turning(0.5, 10.0, (first,)) + [
        s for s in turning(0.5, 20.0, SENSORS) if s.t_ns > 10_000_000_000 or sensor_name(s) == first
    ]
    fusion = YawFusion()
    for sample in sorted(samples, key=lambda s: s.t_ns):
        fusion.add(sample)
    estimate = fusion.estimate()
    assert abs(estimate.yaw - 10.0) < 3.0 * math.sqrt(estimate.yaw_variance)
    assert all(report.rejected == 0 for report in fusion.reports().values())


def sensor_name(sample):
    return {GyroSample: "gyro", OdometrySample: "tracks", YawIncrement: "compass"}[type(sample)]


@pytest.mark.parametrize("silent", SENSORS)
def test_sensor_falling_silent_is_carried_by_the_rest(silent):
    samples = turning(0.5, 20.0, bias=0.01, scale=0.95)
    estimate = fused([s for s in samples if s.t_ns < 5_000_000_000 or sensor_name(s) != silent])
    # exact samples, so what is left is bias and scale not fully learned in 5 s: their sigmas say how much
    assert abs(estimate.yaw - 10.0) < 3.0 * math.sqrt(estimate.yaw_variance) < 0.5


def test_all_silent_grows_variance_and_first_increment_over_the_gap_restores_it():
    fusion = YawFusion()
    for sample in turning(0.3, 5.0):
        fusion.add(sample)
    known = fusion.estimate().yaw_variance
    # 4 s of nothing while the robot turns on by 1.2 rad, then the compass is back on its old reference
    for later in range(3):  # the first waits for the others to confirm its stamp
        yaw = 1.2 + 0.03 * later
        assert fusion.add(YawIncrement(5_000_000_000, 9_000_000_000 + later * 100_000_000, yaw, 1e-6, 0.9)) == (
            later > 1
        )
    estimate = fusion.estimate()
    assert estimate.yaw == pytest.approx(9.2 * 0.3, abs=0.01)
    # its own variance, and what of it lasts going along with that of the 25 steps before
    assert estimate.heading_variance < known + 1e-6 + 2.5e-5
    assert estimate.yaw_variance > 1.0  # nobody knows whether it turned round once more


def test_increment_on_unknown_reference_is_not_lost():
    fusion = YawFusion()
    for sample in turning(0.3, 10.0, ("gyro",)):
        fusion.add(sample)
    # a reference from long before the filter's memory: the first increment places it, the next measure against it
    fusion.add(YawIncrement(1_000, 10_000_000_000, -2.0, 1e-6, 0.9))
    yaw = fusion.estimate().yaw
    assert yaw == pytest.approx(3.0, abs=0.01)
    for i in range(1, 31):
        fusion.add(YawIncrement(1_000, 10_000_000_000 + i * 100_000_000, -2.0 + 0.03 * i, 1e-6, 0.9))
    estimate = fusion.estimate()
    assert estimate.yaw - yaw == pytest.approx(0.9, abs=0.003)  # noise of the two ends, 1e-3 rad each
    assert fusion.state.references_lost == 1


def test_outliers_are_gated():
    wild = {4_000_000_000: 1.0, 7_000_000_000: -0.4}
    samples = []
    for sample in turning(0.5, 10.0):
        if isinstance(sample, YawIncrement) and sample.t_ns in wild:
            sample = YawIncrement(sample.t_ref_ns, sample.t_ns, sample.yaw + wild[sample.t_ns], 1e-6, 0.9)
        samples.append(sample)
    fusion = YawFusion()
    for sample in samples:
        fusion.add(sample)
    # each by its gate; and the compass is left out until a window of half a second agrees, at 10 Hz
    assert 2 <= fusion.reports()[Sensor.COMPASS].rejected <= 2 * (1 + 10)
    assert abs(fusion.estimate().yaw - 5.0) < 1e-3


def test_compass_on_a_false_match_without_tracks_is_let_in_again():
    fusion = YawFusion()
    rng = np.random.default_rng(0)
    for i in range(2001):
        fusion.add(GyroSample(i * 10_000_000, 0.1 + 0.003 * rng.normal()))
        if i % 10 == 0 and i:
            flip = 1.0 if i > 500 else 0.0
            fusion.add(YawIncrement(0, i * 10_000_000, float(wrap_angle(1e-3 * i + flip)), 1e-6, 0.9))
    assert fusion.reports()[Sensor.COMPASS].rejected <= 12  # a window that contradicts, one that agrees, at 10 Hz
    estimate = fusion.estimate()
    assert estimate.yaw == pytest.approx(2.0, abs=0.02)
    assert 1.0 / 3.0 < math.sqrt(estimate.yaw_variance) < 1.0  # the gyro might have missed it, nobody can tell


def test_compass_on_a_false_match_is_let_in_again_without_turning_the_yaw():
    """A symmetric corridor: from 5 s on the compass compares with what lies behind, pi off."""
    fusion = YawFusion()
    for sample in turning(0.1, 20.0, ("gyro", "tracks")):
        fusion.add(sample)
        if sample.t_ns % 100_000_000 == 0 and isinstance(sample, OdometrySample) and sample.t_ns:
            flip = math.pi if sample.t_ns > 5_000_000_000 else 0.0
            yaw = float(wrap_angle(0.1e-9 * sample.t_ns + flip))
            fusion.add(YawIncrement(0, sample.t_ns, yaw, 1e-6, 0.9))
    report = fusion.reports()[Sensor.COMPASS]
    assert 1 <= report.rejected <= 20  # half a second until it is found, then a window of agreement, at 10 Hz
    assert report.accepted > 175
    assert fusion.estimate().yaw == pytest.approx(2.0, abs=0.02)


def reversing(before, after, within):
    """Gyro at 100 Hz and increments at 10 Hz of a turn (rad/s) that is reversed after 3 s; and the final yaw."""
    rng = np.random.default_rng(0)
    t = np.arange(6000) * 1e-3
    rate = np.interp(t, [0.0, 1.0, 1.2, 3.0, 3.0 + within, 6.0], [0.0, 0.0, before, before, after, after])
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * 1e-3])
    samples = [GyroSample(k * 10**6, float(rate[k] + 0.003 + 0.0025 * rng.normal())) for k in range(0, 6000, 10)]
    for a, b in pairwise(range(17, 6000, 100)):
        turn = yaw[b] - yaw[a] + 5e-5 * rng.normal()
        samples.append(YawIncrement(a * 10**6, b * 10**6, float(turn), 25e-10, 0.9))
    return sorted(samples, key=lambda sample: sample.t_ns), yaw[5990]


@pytest.mark.parametrize("ramp", [0.02, 0.05])
@pytest.mark.parametrize(
    ("before", "after", "within"), [(-0.37, 0.86, 0.1), (1.0, -1.0, 0.1), (1.0, -1.0, 0.05)], ids=str
)
def test_sudden_reversal_is_believed(before, after, within, ramp):
    """Were the gyro refused for long, the compass would seem wrong too: up to 16 deg were lost for good."""
    samples, yaw = reversing(before, after, within)
    fusion = YawFusion(FusionConfig(rate_ramp=ramp))
    for sample in samples:
        fusion.add(sample)
    # 60 increments of 5e-5 rad leave 0.02 deg; while two gyro samples are refused, 0.02 s at a rate that is wrong by
    # 1 rad/s make 1.1 deg, most of which the next increment takes back
    assert abs(fusion.estimate().yaw - yaw) < math.radians(0.5)
    reports = fusion.reports()
    assert reports[Sensor.GYRO].rejected <= 12  # of the 5 or 10 samples meanwhile; 8 to 12 over seeds
    assert reports[Sensor.COMPASS].rejected + reports[Sensor.COMPASS].recovered <= 2


@pytest.mark.parametrize("silent_s", [0.03, 0.3])
def test_turn_rate_is_as_free_as_without_a_gyro_once_that_is_silent(silent_s):
    config = FusionConfig(gate_probability=1.0 - 1e-12, rate_walk_factor=1.0, gyro_sigma_factor=1.0)
    last_ns = 5_000_000_000
    after = OdometrySample(last_ns + round(silent_s * 1e9), 0.0, 0.0)
    samples = [s for s in turning(0.5, 10.0, ("gyro",)) if s.t_ns <= last_ns]
    variances = []
    for walk in (config.watched_rate_walk, config.rate_walk):
        fusion = YawFusion(replace(config, watched_rate_walk=walk))
        for sample in [*samples, after]:
            fusion.add(sample)
        variances.append(fusion.estimate().yaw_rate_variance)
    ratio = math.sqrt(variances[0] / variances[1])
    if silent_s < 0.05:  # still watched
        assert ratio == pytest.approx(config.watched_rate_walk / config.rate_walk, rel=0.05)
    else:
        assert ratio == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("spike", [0.5, -5.0])
def test_single_spike_of_the_gyro_leaves_no_trace(spike):
    at_ns, samples = 5_010_000_000, turning(0.5, 10.0, ("gyro",))
    spiked = fused([GyroSample(at_ns, 0.5 + spike) if s.t_ns == at_ns else s for s in samples])
    without = fused([s for s in samples if s.t_ns != at_ns])
    assert spiked.yaw == pytest.approx(without.yaw, abs=1e-9)
    # two short steps instead of a long one; a spike believed for 10 ms would add (0.5 * 0.01)^2, a four hundredth
    assert spiked.yaw_variance == pytest.approx(without.yaw_variance, rel=1e-5)


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi - 1e-9, -2.0])
def test_set_yaw_keeps_the_turn_count(heading):
    fusion = YawFusion()
    for sample in turning(1.0, 20.0):
        fusion.add(sample)
    fusion.set_yaw(heading, 1e-4)
    estimate = fusion.estimate()
    assert abs(wrap_angle(estimate.yaw - heading)) < 1e-9
    assert abs(estimate.yaw - 20.0) <= math.pi + 1e-3
    assert estimate.yaw_variance == pytest.approx(1e-4)


def test_set_yaw_of_nan_raises():
    with pytest.raises(ValueError, match="finite"):
        YawFusion().set_yaw(math.nan, 1.0)


def test_reset_starts_anew():
    fusion = YawFusion(FusionConfig(initial_yaw=0.5))
    for sample in turning(1.0, 2.0):
        fusion.add(sample)
    fusion.reset()
    assert fusion.estimate() is None
    fusion.add(GyroSample(10, 0.0))
    assert fusion.estimate().yaw == pytest.approx(0.5)
