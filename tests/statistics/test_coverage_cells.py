"""Whether regions of 68 and 95 % hold the truth as often with the defaults, over kinds of data, lengths and noise.

What the fit considers is drawn with the sigmas that it has of it. Bounds are those of chance for all cells together.
"""

import pytest
from coverage_cells import DATA, HOURS, NOISE, bounds, held

pytestmark = pytest.mark.slow

TRIALS = 100
COMPARED = len(DATA) * len(HOURS) * len(NOISE) * 4


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("hours", HOURS)
@pytest.mark.parametrize("data", DATA)
def test_regions_hold_what_they_claim(data, hours, noise):
    for (_, level), count in held(data, hours, noise, TRIALS).items():
        low, high = bounds(TRIALS, level, COMPARED)
        assert low <= count <= high
