import numpy as np
import pytest

from radioloc.constants import SECONDS_PER_DAY
from radioloc.earth.eop_tides import libration, ocean_tides, zonal_tides

DAYS = np.linspace(45000.0, 61000.0, 500)
MJD_PER_CENTURY = 36525.0
STEP_D = 1e-3
# A central difference over 2e-3 days of half-daily terms is off by (w h)^2 / 6 = 3e-5 of the rate; beside it
# stands the round-off of a date in one float.
RATE_TOL_RELATIVE = 5e-5


@pytest.mark.parametrize("model", [ocean_tides, libration])
def test_rates_are_the_derivatives(model):
    _, rate = model(DAYS)
    difference = (model(DAYS + STEP_D)[0] - model(DAYS - STEP_D)[0]) / (2 * STEP_D * SECONDS_PER_DAY)
    assert (np.abs(difference - rate).max(axis=0) < RATE_TOL_RELATIVE * np.abs(rate).max(axis=0)).all()


def test_zonal_rate_is_the_derivative():
    centuries, step = (DAYS - 51544.5) / MJD_PER_CENTURY, 0.05 / MJD_PER_CENTURY
    _, rate = zonal_tides(centuries)
    seconds = 2 * step * MJD_PER_CENTURY * SECONDS_PER_DAY
    difference = (zonal_tides(centuries + step)[0] - zonal_tides(centuries - step)[0]) / seconds
    # (w h)^2 / 6 for the monthly to weekly terms that make the rate
    assert np.abs(difference - rate).max() < 3e-4 * np.abs(rate).max()
