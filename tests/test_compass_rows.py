"""The paper's method against the paper's formulas, written out."""

import math

import numpy as np
import pytest
from panoramas import as_bytes, compare, scene

from compass import CompassConfig, VisualCompass
from compass.flow.correlation import correlate_rows
from compass.images.strip import prepare_strip
from compass.methods.match import Search
from compass.methods.row_correlation import match_rows

WHOLE = CompassConfig(method="rows", roi_top=0.0, roi_bottom=1.0)
ANYWHERE = Search(0.0, math.inf, 0.0)
# float32 keeps 24 bits: sums of up to 256 products of size <= 1, and the FFT's log2(n) steps, err by < 1e-5
FLOAT32 = 1e-5


def coefficient(x, y):
    """Equation 2; a row without texture matches nothing."""
    x, y = x - x.mean(), y - y.mean()
    energy = math.sqrt(float(x @ x) * float(y @ y))
    return float(x @ y) / energy if energy else 0.0


def paper_coefficients(reference, current):
    """Equation 2 of each row for each shift: the reference is moved right by np.roll."""
    reference, current = reference.astype(np.float64), current.astype(np.float64)
    return np.array(
        [
            [coefficient(np.roll(before, shift), now) for shift in range(before.size)]
            for before, now in zip(reference, current, strict=True)
        ]
    )


def paper_angle(reference, current):
    """Section 2: the shift of each row's largest coefficient, eq. 1, averaged with the coefficients as weights."""
    coefficients = paper_coefficients(reference, current)
    columns = reference.shape[1]
    angles, weights = [], []
    for row in coefficients:
        shift = int(row.argmax())
        angles.append((shift if shift < columns / 2 else shift - columns) * 360.0 / columns)
        weights.append(row[shift])
    return float(np.dot(angles, weights) / np.sum(weights))


def noise(seed, rows, columns):
    return np.random.default_rng(seed).integers(0, 256, (rows, columns), dtype=np.uint8)


@pytest.mark.parametrize("columns", [16, 17, 101, 128, 255])
def test_coefficients_of_every_row_and_shift_are_those_of_equation_2(columns):
    reference, current = noise(1, 5, columns), noise(2, 5, columns)
    current[0] = np.roll(reference[0], 3)  # a perfect match
    current[1] = 255 - np.roll(reference[1], 5)  # its negative
    computed = correlate_rows(prepare_strip(0, reference, WHOLE), prepare_strip(1, current, WHOLE))
    np.testing.assert_allclose(computed, paper_coefficients(reference, current), rtol=0.0, atol=FLOAT32)
    assert computed[0].argmax() == 3
    assert computed[0, 3] == pytest.approx(1.0, abs=FLOAT32)
    assert computed[1, 5] == pytest.approx(-1.0, abs=FLOAT32)


@pytest.mark.parametrize("flat", ["reference", "current", "both"])
def test_flat_rows_have_no_coefficients_and_leave_the_others_alone(flat):
    reference, current = noise(3, 4, 64), noise(4, 4, 64)
    if flat != "current":
        reference[1] = 77
    if flat != "reference":
        current[1] = 200
    computed = correlate_rows(prepare_strip(0, reference, WHOLE), prepare_strip(1, current, WHOLE))
    assert not computed[1].any()
    np.testing.assert_allclose(computed, paper_coefficients(reference, current), rtol=0.0, atol=FLOAT32)


@pytest.mark.parametrize("columns", [96, 97])
@pytest.mark.parametrize("shift", [-31, -1, 0, 1, 12, 40])
def test_rows_give_the_papers_angle_where_rows_disagree(columns, shift):
    reference = scene(5, columns, 12)
    current = np.stack([np.roll(row, shift + index % 3) for index, row in enumerate(reference)])
    current += np.random.default_rng(6).normal(0.0, 4.0, current.shape)
    reference, current = as_bytes(reference), as_bytes(current)
    match = match_rows(prepare_strip(0, reference, WHOLE), prepare_strip(1, current, WHOLE), ANYWHERE)
    # weights err by FLOAT32, shifts differ by 2 columns: the average by less than 2 columns' 1e-5
    assert match.shift_px * 360.0 / columns == pytest.approx(paper_angle(reference, current), abs=360 / columns * 2e-5)
    assert abs(match.shift_px - (shift + 1)) < 1.0


def test_rows_through_the_compass_give_the_papers_angle():
    reference, current = as_bytes(scene(7, 120, 40)), as_bytes(np.roll(scene(7, 120, 40), 9, axis=1), noise=6.0)
    compass = VisualCompass(CompassConfig(method="rows", roi_top=0.25, roi_bottom=0.75))
    increment = compare(compass, reference, current)
    region = slice(10, 30)  # 0.25 and 0.75 of 40 rows
    assert math.degrees(increment.yaw) == pytest.approx(paper_angle(reference[region], current[region]), abs=1e-4)


def test_rows_average_across_half_a_turn_stays_there():
    # rows at +half and just beyond it: naively averaged, 179 and -179 deg give 0
    reference = scene(8, 120, 8)
    current = np.stack([np.roll(row, 59 + 2 * (index % 2)) for index, row in enumerate(reference)])
    reference, current = as_bytes(reference), as_bytes(current)
    match = match_rows(prepare_strip(0, reference, WHOLE), prepare_strip(1, current, WHOLE), ANYWHERE)
    assert abs(match.shift_px) == pytest.approx(60.0, abs=0.1)  # weights differ by the rounding to 8 bits, < 1 %


def test_rows_all_flat_match_nothing():
    flat = prepare_strip(0, np.full((6, 64), 90, np.uint8), WHOLE)
    match = match_rows(flat, flat, ANYWHERE)
    assert match.confidence == 0.0
    assert match.variance_px2 == math.inf


def test_rows_confidence_is_the_weighted_coefficient():
    reference, current = noise(9, 30, 128), noise(10, 30, 128)
    current = (0.6 * reference + 0.4 * current).astype(np.uint8)
    match = match_rows(prepare_strip(0, reference, WHOLE), prepare_strip(1, current, WHOLE), ANYWHERE)
    best = paper_coefficients(reference, current).max(axis=1)
    assert match.confidence == pytest.approx(float(best @ best / best.sum()), abs=FLOAT32)
