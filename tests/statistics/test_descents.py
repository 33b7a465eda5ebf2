"""Accuracy of landers within a pixel of the map, and coverage of their ellipses, over drawn descents."""

import numpy as np
import pytest
from drawn_descents import outcomes
from scipy.stats import binom, chi2

DESCENTS = 100
OBLIQUE_SEEDS, OBLIQUE_RELIEF = range(100, 118), 0.5  # other seeds than those of the development of the sigma


@pytest.mark.slow
def test_landers_are_found_within_a_pixel_of_the_map():
    drawn = outcomes(range(DESCENTS))
    result = [o for o in drawn if not o.refused]
    beyond = [(o.seed, o.refused or f"{o.pixels:.2f} pixels") for o in drawn if not o.pixels < 1.0]
    assert len(beyond) <= 0.05 * DESCENTS, beyond
    for squares in ([o.relative for o in result], [o.total for o in result]):
        contained = sum(square < chi2.ppf(0.95, 2) for square in squares)
        low, high = binom.ppf([0.0025, 0.9975], len(result), 0.95)  # 1 % for both
        assert low <= contained <= high


@pytest.mark.slow
@pytest.mark.parametrize("with_dem", [False, True])
@pytest.mark.parametrize("tilt_deg", [20.0, 40.0, 60.0])
def test_sigma_of_oblique_frames_includes_the_displacement_by_relief(tilt_deg, with_dem):
    drawn = outcomes(OBLIQUE_SEEDS, OBLIQUE_RELIEF, with_dem, tilt_deg)
    squares = [o.relative for o in drawn if not o.refused]
    assert len(squares) > 0.4 * len(OBLIQUE_SEEDS)
    assert 0.5 < 0.5 * np.mean(squares) < 1.6
