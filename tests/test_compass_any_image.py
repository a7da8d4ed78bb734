"""Whatever a camera sends: a status or an increment with a positive variance, never an exception.

Pictures without corners, of one texture all over, of nothing but noise, and of other places in turn; upside down,
covered, dark, compressed to nothing, and with an IMU that says anything of the vertical.
"""

import warnings

import cv2
import numpy as np
import pytest
from panoramas import scene

from compass import CompassConfig, CompassStatus, VisualCompass

WIDTH, HEIGHT = 320, 160
IMAGES = 8
STEPS_NS = (10_000_000, 100_000_000, 600_000_000)


def place(rng):
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    dots = np.zeros((HEIGHT, WIDTH))
    dots[rng.integers(HEIGHT, size=9), rng.integers(WIDTH, size=9)] = 255.0
    kinds = [
        scene(int(rng.integers(5)), WIDTH, HEIGHT),
        np.full((HEIGHT, WIDTH), float(rng.integers(256))),
        rng.uniform(0.0, 255.0, (HEIGHT, WIDTH)),
        255.0 * x / WIDTH,
        np.tile(rng.uniform(0.0, 255.0, (1, WIDTH)), (HEIGHT, 1)),
        np.tile(rng.uniform(0.0, 255.0, (HEIGHT, 1)), (1, WIDTH)),
        255.0 * ((x // 9 + y // 9) % 2),
        cv2.GaussianBlur(dots, (0, 0), 2.0) * 20.0,
    ]
    return np.clip(kinds[rng.integers(len(kinds))], 0, 255).astype(np.uint8)


def spoilt(rng, image):
    """What a mount, a cable, the light and a driver make of a picture."""
    column, row = int(rng.integers(WIDTH)), int(rng.integers(HEIGHT))
    covered, half = image.copy(), image.copy()
    covered[:, column : column + WIDTH // 2], half[:row] = 0, 255
    made = [
        image,
        image[::-1, ::-1],
        image[:, ::-1],
        np.roll(image, column, axis=1),
        covered,
        half,
        image // 16,
        cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 2])[1], cv2.IMREAD_GRAYSCALE),
        cv2.cvtColor(image, cv2.COLOR_GRAY2BGR),
        image.astype(np.uint16) * 257,
    ]
    return np.ascontiguousarray(made[rng.integers(len(made))])


@pytest.mark.parametrize("method", ["rows", "sectors", "corners"])
@pytest.mark.parametrize("projection", ["equirectangular", "dual_fisheye", "ring"])
@pytest.mark.parametrize("seed", range(6))
def test_any_sequence_of_images_gets_a_status(method, projection, seed):
    rng = np.random.default_rng([seed, len(method), len(projection)])
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    attitude = (lambda t_ns: tuple(up.tolist())) if seed % 2 else None
    compass = VisualCompass(CompassConfig(method=method, projection=projection), attitude)
    t_ns, here = 10**18, place(rng)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a division by zero is one of numpy's
        for _ in range(IMAGES):
            here = place(rng) if rng.random() < 0.3 else np.roll(here, int(rng.integers(-6, 7)), axis=1)
            t_ns += int(rng.choice(STEPS_NS))
            increment = compass.update(t_ns, spoilt(rng, here))
            assert isinstance(compass.status, CompassStatus)
            assert np.isfinite(compass.yaw)
            assert compass.yaw_variance >= 0.0
            if increment is not None:
                assert increment.variance > 0.0
                assert np.isfinite([increment.yaw, increment.variance, increment.confidence]).all()


def test_keyframe_without_a_single_corner():
    """Stripes all round have texture, and nothing to be found again."""
    stripes = np.tile((np.arange(HEIGHT) // 8 % 2 * 200).astype(np.uint8)[:, None], (1, WIDTH))
    compass = VisualCompass()
    for k in range(3):
        assert compass.update(10**18 + k * 10**8, np.roll(stripes, k, axis=0)) is None
    assert compass.status is not CompassStatus.OK


def test_image_in_which_no_corner_of_the_keyframe_is_found():
    """Two cameras on one topic, one of them upside down."""
    image = np.clip(scene(1, WIDTH, HEIGHT), 0, 255).astype(np.uint8)
    compass = VisualCompass()
    for k in range(6):
        compass.update(10**18 + k * 10**8, image[::-1, ::-1] if k % 2 else image)
        assert compass.yaw_variance >= 0.0
