"""Gaps in which nobody measures: the sigma covers what a robot may do in them, full turns included."""

import itertools
import math

import numpy as np
import pytest

from compass import YawIncrement
from fusion import GyroSample, OdometrySample, YawFusion
from fusion.checks.turn_count import TurnCount

BEFORE, AFTER = 6.0, 3.0  # s, of samples on either side of a gap


def heard(rates, gap, sensors):
    """Samples of a robot that turns at one rate, falls silent for a while and goes on at another; and its yaw."""
    rng, end = np.random.default_rng(0), BEFORE + gap + AFTER

    def yaw(t):
        return rates[0] * min(t, BEFORE) + rates[1] * max(t - BEFORE, 0.0)

    def stamps(hertz):
        return [i / hertz for i in range(int(hertz * end)) if not BEFORE < i / hertz < BEFORE + gap]

    samples = []
    if "gyro" in sensors:
        samples += [GyroSample(int(t * 1e9), rates[t > BEFORE] + 0.003 * rng.normal()) for t in stamps(50)]
    if "tracks" in sensors:
        claims = [(t, 1.3 * rates[t > BEFORE], 1.3 * yaw(t) if "poses" in sensors else None) for t in stamps(20)]
        samples += [OdometrySample(int(t * 1e9), rate, 0.3, pose) for t, rate, pose in claims]
    if "compass" in sensors:
        times = stamps(15)
        for since, until in itertools.pairwise(times):
            turn = (yaw(until) - yaw(since) + math.pi) % math.tau - math.pi + 5e-4 * rng.normal()
            samples.append(YawIncrement(int(since * 1e9), int(until * 1e9), turn, 25e-8, 0.9))
    return sorted(samples, key=lambda sample: sample.t_ns), yaw


@pytest.mark.parametrize("gap", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("rates", [(2.1, 0.0), (1.0, 0.0), (0.5, -0.5), (0.0, 1.0), (0.5, 0.5)])
@pytest.mark.parametrize(
    "sensors",
    [
        ("gyro", "tracks", "compass"),
        ("gyro", "tracks", "poses", "compass"),
        ("gyro", "tracks", "poses"),
        ("tracks", "poses"),
        ("tracks", "poses", "compass"),
        ("compass",),
    ],
)
def test_yaw_is_within_three_sigma_after_a_gap(sensors, rates, gap):
    samples, yaw = heard(rates, gap, sensors)
    fusion, worst, worst_heading = YawFusion(), 0.0, 0.0
    for sample in samples:
        fusion.add(sample)
        estimate = fusion.estimate()
        if estimate and estimate.t_ns > BEFORE * 1e9:
            error = estimate.yaw - yaw(estimate.t_ns * 1e-9)
            worst = max(worst, abs(error) / math.sqrt(estimate.yaw_variance))
            wrapped = abs((error + math.pi) % math.tau - math.pi)
            worst_heading = max(worst_heading, wrapped / math.sqrt(estimate.heading_variance))
    assert worst < 3.0
    assert worst_heading < 3.0
    lost = [warning for warning in estimate.warnings if warning.code == "turn_lost"]
    assert fusion.warnings() == list(estimate.warnings)
    assert lost or gap < 8.0 or "compass" not in sensors
    assert not lost or gap > 1.0
    if "compass" in sensors:
        assert estimate.heading_variance < math.radians(6.0) ** 2


@pytest.mark.parametrize(("sigma", "expected"), [(0.5, 0.0), (100.0, 100.0**2)])
def test_full_turns_are_as_open_as_the_prediction_was(sigma, expected):
    count = TurnCount().after(1, 0.1, sigma**2)
    assert count.variance == pytest.approx(expected, rel=0.1)
    assert (count.since_ns is None) == (expected == 0.0)


def test_the_nearer_of_two_turns_is_the_likelier():
    """Of an innovation of half a turn, two turns are as likely."""
    even = TurnCount().after(1, math.pi - 1e-9, 1.2)
    assert even.variance == pytest.approx(0.5 * math.tau**2, rel=1e-3)


@pytest.mark.parametrize("pauses", [(3.0,), (3.0, 0.6), (0.6, 3.0)])
def test_pauses_between_two_images_are_counted_together(pauses):
    """The robot stops at once in the first; of the gyro, at 10 Hz, there are some samples between.

    From standstill, as that then shows, it hardly turns round within 3 s.
    """
    fusion, t, turned = YawFusion(), 0.0, 0.0
    for _ in range(50):
        t += 0.1
        turned += 0.21
        fusion.add(GyroSample(int(t * 1e9), 2.1))
        fusion.add(YawIncrement(int((t - 0.1) * 1e9), int(t * 1e9), 0.21, 25e-8, 0.9))
    last = t
    for pause in pauses:
        t += pause
        for _ in range(3):
            t += 0.1
            fusion.add(GyroSample(int(t * 1e9), 0.0))
    for _ in range(3):
        fusion.add(YawIncrement(int(last * 1e9), int(t * 1e9), 0.0, 25e-8, 0.9))
        t += 0.1
        fusion.add(GyroSample(int(t * 1e9), 0.0))
    estimate = fusion.estimate()
    assert abs(estimate.yaw - turned) < 3.0 * math.sqrt(estimate.yaw_variance)
    assert ("turn_lost" in {warning.code for warning in estimate.warnings}) == (pauses[0] == 3.0)


def test_turns_that_a_gyro_counts_are_not_open():
    """However wrong it is for a moment: its spikes open the variance between two images."""
    samples, _ = heard((0.5, 0.5), 0.5, ("gyro", "tracks", "compass"))
    fusion = YawFusion()
    for i, sample in enumerate(samples):
        spike = isinstance(sample, GyroSample) and i % 97 == 0
        fusion.add(GyroSample(sample.t_ns, 9.0) if spike else sample)
    assert fusion.estimate().turn_count_variance == 0.0
