"""Accuracy of landers within a pixel of the map, and coverage of their ellipses, over drawn descents."""

import numpy as np
import pytest
from coverage_cells import bounds
from drawn_descents import outcomes
from scipy.stats import chi2

DESCENTS = 100
CELL_DESCENTS = 60


@pytest.mark.slow
def test_landers_are_found_within_a_pixel_of_the_map():
    drawn = outcomes(range(DESCENTS))
    result = [o for o in drawn if not o.refused]
    beyond = [(o.seed, o.refused or f"{o.pixels:.2f} pixels") for o in drawn if not o.pixels < 1.0]
    assert len(beyond) <= 0.05 * DESCENTS, beyond
    for squares in ([o.relative for o in result], [o.total for o in result]):
        contained = sum(square < chi2.ppf(0.95, 2) for square in squares)
        low, high = bounds(len(result), 0.95, compared=2)
        assert low <= contained <= high


@pytest.mark.slow
@pytest.mark.parametrize("with_dem", [True, False], ids=["with elevation model", "without"])
@pytest.mark.parametrize("relief", [0.0, 1.0], ids=["flat ground", "relief"])
def test_ellipses_have_the_size_of_the_errors(relief, with_dem):
    drawn = outcomes(range(CELL_DESCENTS), relief, with_dem)
    squares = np.array([o.relative for o in drawn if not o.refused])
    assert len(squares) >= 0.9 * CELL_DESCENTS
    # Three sigmas of the mean of chi squared over two, whose standard deviation is 1.
    assert 0.5 * squares.mean() == pytest.approx(1.0, abs=3.0 / np.sqrt(len(squares)))
    for level in (0.68, 0.95):
        contained = sum(square < chi2.ppf(level, 2) for square in squares)
        low, high = bounds(len(squares), level, compared=8)
        assert low <= contained <= high, (level, contained)
