"""The paper's future work: sectors, and the median of their shifts."""

import numpy as np
import pytest
from panoramas import as_bytes, scene, shifted

from compass import CompassConfig
from compass.images.strip import prepare_strip
from compass.methods.match import Search
from compass.methods.sector_median import match_sectors

WHOLE, ANYWHERE = CompassConfig(roi_top=0.0, roi_bottom=1.0), Search(0.0, 512.0, 512.0)


@pytest.mark.parametrize("pushed_px", [-5.0, 5.0])
def test_a_quarter_of_the_circle_that_is_near_and_pushed_aside_does_not_turn_the_median(pushed_px):
    """A mean would follow by a quarter of that; a median moves by what noise lets the others scatter, hundredths."""
    place = scene(3, 1024, 64)
    now, near = shifted(place, 2.0), shifted(place, 2.0 + pushed_px)
    now[:, 100:356] = near[:, 100:356]
    strips = (prepare_strip(0, as_bytes(view, 1.0, seed), WHOLE) for seed, view in enumerate((place, now)))
    assert match_sectors(*strips, ANYWHERE).shift_px == pytest.approx(2.0, abs=0.05)


def test_variance_of_the_median_is_no_smaller_than_its_errors():
    normalised = []
    for seed in range(24):
        place, shift = scene(seed % 6, 1024, 64), np.random.default_rng(seed).uniform(-9.0, 9.0)
        views = (as_bytes(place, 3.0, 2 * seed), as_bytes(shifted(place, shift), 3.0, 2 * seed + 1))
        match = match_sectors(*(prepare_strip(0, view, WHOLE) for view in views), ANYWHERE)
        normalised.append((match.shift_px - shift) ** 2 / match.variance_px2)
    assert np.mean(normalised) < 1.0
