"""Coverage of regions of 68 and 95 % with the defaults, over kinds of data, lengths of arcs and worlds.

Consider parameters are drawn with their sigmas. Quantities that the fit estimates, such as the size of the noise,
differ from the stated ones. Bounds hold for all cells together.
"""

import pytest
from coverage_cells import CELLS, DATA, UNCOVERED, bounds, held

pytestmark = pytest.mark.slow

TRIALS = 100
COVERED_CELLS = [cell for cell in CELLS if cell[0] not in UNCOVERED]


@pytest.mark.parametrize(("world", "data", "hours"), COVERED_CELLS)
def test_regions_have_the_claimed_coverage(world, data, hours):
    for (_, level), count in held(data, hours, world, TRIALS).items():
        low, high = bounds(TRIALS, level, 4 * len(COVERED_CELLS))
        assert low <= count <= high


@pytest.mark.parametrize("data", DATA)
def test_wrong_apriori_sigmas_are_not_covered(data):
    """Draw errors of twice and half the a-priori sigmas."""
    low, high = bounds(TRIALS, 0.68, 2 * len(DATA))
    double, half = (held(data, 12.0, world, TRIALS)["horizontal", 0.68] for world in UNCOVERED)
    assert double < low
    assert half > high
