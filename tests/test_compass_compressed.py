"""Compressed images: JPEG moves fine detail towards its blocks, by far more than noise; the variance says so."""

import math

import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, PHOTO_NAMES, START_NS, as_bytes, needs_two_places, photo, scene, shifted

from compass import VisualCompass, wrap_angle

PER_PX = math.tau / 1024


def compressed(image, quality, seed):
    pixels = as_bytes(image, 2.0, seed)
    return cv2.imdecode(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE)


def nees_of(image, quality, columns, seed=0):
    """Squared errors in variances of turns by so many columns from one keyframe."""
    compass, result = VisualCompass(), []
    compass.update(START_NS, compressed(image, quality, seed))
    for index, shift in enumerate(columns, start=1):
        frame = compressed(shifted(image, shift), quality, seed + index)
        increment = compass.update(START_NS + index * FRAME_NS, frame)
        assert increment.t_ref_ns == START_NS
        result.append(wrap_angle(increment.yaw - shift * PER_PX) ** 2 / increment.variance)
    return np.array(result)


@needs_two_places  # the mean of six: of single places it reaches 12
@pytest.mark.parametrize("quality", [60, 75, 90])
def test_variance_of_jpeg_photographs_knows_of_the_blocks(quality):
    # Half of the turns are below one column, where blocks hold the picture fast: the bound of noise alone is exceeded
    # by 100 to 230 times. What is left is what they do to all bands of frequency alike.
    rng = np.random.default_rng(quality)
    columns = np.concatenate([rng.uniform(-1.0, 1.0, 6), rng.uniform(-30.0, 30.0, 6)])
    nees = np.concatenate([nees_of(photo(name), quality, columns) for name in PHOTO_NAMES])
    print(f"{nees.mean():.2f}")
    assert 0.5 < nees.mean() < 5.0


def test_small_turns_of_a_jpeg_scene_are_not_claimed_to_a_thousandth():
    image = scene(7, 1024, 512)
    nees = nees_of(image, 75, [0.1, 0.2, 0.3, 0.4, -0.1, -0.2, -0.3, -0.4])
    print(nees.round(1))
    assert nees.mean() < 4.0


@pytest.mark.parametrize("columns", [0.4, 1.3, 4.1])
def test_doubled_pixels_are_compared_to_a_tenth_of_a_degree(columns):
    # their finest detail moves by whole steps of two columns, against the rest, and leaves no maximum between them
    image = scene(1, 512, 96)
    frames = [np.repeat(np.repeat(as_bytes(shifted(image, s), 2.0, i), 2, 0), 2, 1) for i, s in enumerate((0, columns))]
    compass = VisualCompass()
    compass.update(START_NS, frames[0])
    increment = compass.update(START_NS + FRAME_NS, frames[1])
    assert increment.variance < math.radians(0.1) ** 2
    assert abs(wrap_angle(increment.yaw - 2.0 * columns * PER_PX)) < math.radians(0.1)


def test_variance_without_compression_stays_that_of_noise():
    image = scene(7, 1024, 512)
    compass = VisualCompass()
    compass.update(START_NS, as_bytes(image, 2.0, 0))
    region = image[128:282].astype(np.float64)
    gradient = 0.5 * (np.roll(region, -1, axis=1) - np.roll(region, 1, axis=1))
    bound = 2.0 * (4.0 + 1.0 / 12.0) / float((gradient**2).sum()) * PER_PX**2
    variances = [
        compass.update(START_NS + i * FRAME_NS, as_bytes(shifted(image, 0.3 * i), 2.0, i)).variance
        for i in range(1, 20)
    ]
    assert np.median(variances) == pytest.approx(bound, rel=0.25)  # central differences see a little less than all
