"""The correlation's maximum between the columns."""

from itertools import pairwise

import numpy as np
import pytest
import scipy.fft
from panoramas import as_bytes, scene, shifted

from compass import CompassConfig, CompassStatus
from compass.flow.coarse_shift import coarse_shift
from compass.flow.correlation import continuous_peak, pooled_spectrum, signed
from compass.flow.pure_turn import pooled_turn, turn_variance
from compass.images.strip import Strip, prepare_strip
from compass.methods.match import Search

WHOLE = CompassConfig(roi_top=0.0, roi_bottom=1.0)


def strip_of(pixels):
    pixels = np.asarray(pixels, np.float32)
    pixels = pixels - pixels.mean(axis=1, keepdims=True)
    return Strip(0, pixels, float(pixels.std()))


def peak_between(reference, current):
    spectrum = pooled_spectrum(reference, current)
    values = scipy.fft.irfft(spectrum, reference.columns)
    return continuous_peak(spectrum, reference.columns, float(values.argmax()))


@pytest.mark.parametrize("columns", [63, 64, 255, 1024])
@pytest.mark.parametrize("shift", [-7.5, -0.49, 0.0, 0.01, 0.25, 0.5, 3.7, 20.123])
def test_continuous_peak_is_exact_for_band_limited_circles(columns, shift):
    original = scene(1, columns, 8)
    peak = peak_between(strip_of(original), strip_of(shifted(original, shift)))
    # float32 pixels of up to 100 grey values err by 4e-6 each, gradients are about 10 per column: 1e-6 columns;
    # Newton stops below 1e-6; the float32 cross-spectrum adds log2(n) roundings. Together well under 1e-4.
    assert float(signed(peak.shift_px - shift, columns)) == pytest.approx(0.0, abs=1e-4)
    assert peak.value == pytest.approx(1.0, abs=1e-4)


def test_curvature_is_the_second_derivative_of_the_correlation():
    # of a row cos(k x) against itself the correlation is cos(k s), with second derivative -k^2 at 0
    columns, waves = 128, 5
    row = np.cos(2.0 * np.pi * waves * np.arange(columns) / columns)
    peak = peak_between(strip_of(row[None]), strip_of(row[None]))
    assert peak.curvature == pytest.approx(-((2.0 * np.pi * waves / columns) ** 2), rel=1e-5)
    assert peak.value == pytest.approx(1.0, rel=1e-5)


def test_newton_stays_at_a_sample_that_is_no_maximum():
    columns = 64
    row = np.cos(2.0 * np.pi * np.arange(columns) / columns)
    spectrum = pooled_spectrum(strip_of(row[None]), strip_of(row[None]))
    assert continuous_peak(spectrum, columns, 32.0).shift_px == 32.0  # the correlation's minimum


@pytest.mark.parametrize("gain", [0.1, 1.0, 30.0])
def test_pooled_correlation_of_a_match_is_one_at_any_contrast(gain):
    original = scene(2, 100, 6)
    peak = peak_between(strip_of(original), strip_of(gain * original))
    assert peak.value == pytest.approx(1.0, abs=1e-5)


def parabola_peak(values):
    """Three-point parabola through the largest sample and its neighbours."""
    best = int(values.argmax())
    left, mid, right = values[best - 1], values[best], values[(best + 1) % values.size]
    return best + 0.5 * (left - right) / (left - 2.0 * mid + right)


def test_three_turns_lose_least_with_the_continuous_peak():
    columns, step_deg = 1024, 5.0
    step = step_deg * columns / 360.0  # 14.22 columns: never a whole one
    original = scene(3, columns, 24)
    frames = [prepare_strip(i, as_bytes(shifted(original, i * step)), WHOLE) for i in range(73)]  # one turn
    lost = {"whole": 0.0, "parabola": 0.0, "continuous": 0.0}
    for before, now in pairwise(frames):
        values = scipy.fft.irfft(pooled_spectrum(before, now), columns)
        found = {
            "whole": float(values.argmax()),
            "parabola": parabola_peak(values),
            "continuous": peak_between(before, now).shift_px,
        }
        for name, shift in found.items():
            lost[name] += 3 * (step - shift) * 360.0 / columns  # three times the same frames
    # 14 instead of 14.22 columns, 216 times
    assert lost["whole"] == pytest.approx(216 * (step - 14.0) * 360.0 / columns, abs=0.01)
    # a parabola through samples of a peak that is none errs by a hundredth of a column: 216 * 0.01 * 0.35 deg = 0.8
    assert 0.1 < abs(lost["parabola"]) < 2.0
    # Rounding to 8 bits is noise of sigma 0.29. What frame i errs by, the steps to it and from it share with opposite
    # signs; the sum keeps the first and the last frame's: one comparison's bound, three times, and three sigmas of it.
    gradient = np.diff(original, axis=1, append=original[:, :1])
    bound = np.sqrt(1.0 / 12.0 * 2.0 / float((gradient**2).sum())) * 360.0 / columns
    assert abs(lost["continuous"]) < 3.0 * 3.0 * bound


def test_signed_brings_shifts_to_the_half_open_half_circle():
    assert signed([0, 5, 49.5, 50, 99, -50, 150], 100).tolist() == [0, 5, 49.5, -50, -1, -50, -50]
    assert signed([50, 51], 101).tolist() == [50, -50]


def coarse(peaks, search):
    """Coarse shift where the correlation has these peaks, one column wide: column -> height."""
    values = np.zeros(1024, np.float32)
    for column, height in peaks.items():
        values[column] = height
    return coarse_shift(scipy.fft.rfft(values), 1024, search)


ANYWHERE, NEAR = Search(0.0, 512.0, 512.0), Search(0.0, 100.0, 512.0)


@pytest.mark.parametrize(("rival", "ambiguous"), [(0.4, False), (0.9, False), (0.99, True), (0.999, True)])
def test_another_peak_is_as_likely_only_where_it_is_as_high_but_for_noise(rival, ambiguous):
    """Measured: rivals reach 0.39 where nothing repeats itself; where something does they are within noise of 1."""
    status = coarse({10: 1.0, 500: rival}, ANYWHERE).status
    assert status is (CompassStatus.AMBIGUOUS if ambiguous else CompassStatus.OK)


@pytest.mark.parametrize(("apart", "ambiguous"), [(30, False), (120, True)])
def test_a_peak_beside_the_highest_is_its_shoulder_and_no_rival(apart, ambiguous):
    """A doorway spans some ten degrees of the circle, and so does its peak; none spans 42."""
    status = coarse({10: 1.0, 10 + apart: 0.99}, ANYWHERE).status
    assert status is (CompassStatus.AMBIGUOUS if ambiguous else CompassStatus.OK)


@pytest.mark.parametrize(("within", "shift"), [(0.3, 300), (0.8, 20)])
def test_a_peak_beyond_reach_wins_only_where_it_is_much_higher(within, shift):
    """`max_yaw_rate` is a guess of the robot: what matches far better beyond it has turned further."""
    assert coarse({20: within, 300: 1.0}, NEAR).shift_px == shift


def test_a_rival_beyond_reach_is_none():
    assert coarse({20: 1.0, 300: 0.99}, NEAR).status is CompassStatus.OK


@pytest.mark.parametrize("amplitude", [-0.1, 0.1])
def test_the_finest_wave_of_an_even_circle_does_not_move_the_peak(amplitude):
    """Sampled twice a period it has no phase, so it tells nothing; counted, it would draw the peak to whole columns."""
    before = scene(4, 64, 16)
    spectrum = pooled_spectrum(strip_of(before), strip_of(shifted(before, 3.3)))
    with_wave = spectrum.copy()
    with_wave[-1] += amplitude * np.abs(spectrum).max()
    assert continuous_peak(with_wave, 64, 3.0).shift_px == continuous_peak(spectrum, 64, 3.0).shift_px


def test_variance_claimed_of_a_turn_is_never_below_the_cramer_rao_bound():
    """No unbiased estimate beats 2 sigma^2 / sum of squared gradients; the noise is told by 8192 pixels to 1.6 %."""
    image, sigma, rng = scene(6, 256, 32), 1.0, np.random.default_rng(0)
    gradient = np.fft.irfft(np.fft.rfft(image, axis=1) * 2j * np.pi * np.fft.rfftfreq(256), 256, axis=1)
    bound = 2.0 * sigma**2 / float((gradient**2).sum())
    claimed, errors = [], []
    for shift in rng.uniform(-10.0, 10.0, 100):
        one, other = (strip_of(view + rng.normal(0.0, sigma, view.shape)) for view in (image, shifted(image, shift)))
        peak, spectrum = pooled_turn(one, other, round(shift))
        claimed.append(turn_variance(peak, spectrum, one))
        errors.append(peak.shift_px - shift)
    assert min(claimed) > 0.9 * bound
    # and is as near to it as chi-square of 100 allows, three of its deviations
    assert np.mean(np.square(errors)) == pytest.approx(bound, rel=3.0 * np.sqrt(2.0 / 100.0))
