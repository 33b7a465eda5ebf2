"""Whether regions of 68 and 95 % hold the truth as often with the defaults, over kinds of data, lengths and worlds.

What the fit considers is drawn with the sigmas that it has of it; what the fit is to find out itself, such as the size
of the noise, is drawn otherwise than stated. Bounds are those of chance for all cells together.
"""

import pytest
from coverage_cells import CELLS, DATA, UNTOLD, bounds, held

pytestmark = pytest.mark.slow

TRIALS = 100
TOLD = [cell for cell in CELLS if cell[0] not in UNTOLD]


@pytest.mark.parametrize(("world", "data", "hours"), TOLD)
def test_regions_hold_what_they_claim(world, data, hours):
    for (_, level), count in held(data, hours, world, TRIALS).items():
        low, high = bounds(TRIALS, level, 4 * len(TOLD))
        assert low <= count <= high


@pytest.mark.parametrize("data", DATA)
def test_what_no_data_tell_is_not_covered(data):
    """Errors that are twice as large as they are taken to be, and half."""
    low, high = bounds(TRIALS, 0.68, 2 * len(DATA))
    twice, half = (held(data, 12.0, world, TRIALS)["horizontal", 0.68] for world in UNTOLD)
    assert twice < low
    assert half > high
