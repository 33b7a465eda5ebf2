import numpy as np
import pytest

from radioloc.constants import ARCSEC_RAD, SECONDS_PER_DAY
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


def test_sizes_are_those_documented():
    days = np.arange(51544.0, 60000.0, 0.17)
    ocean, _ = ocean_tides(days)
    lunisolar, _ = libration(days)
    uas = 1e-6 * ARCSEC_RAD
    assert 700 < np.hypot(ocean[:, 0], ocean[:, 1]).max() / uas < 1000
    assert 60 < np.abs(ocean[:, 2]).max() * 1e6 < 95
    assert 30 < np.hypot(lunisolar[:, 0], lunisolar[:, 1]).max() / uas < 45
    assert 3 < np.abs(lunisolar[:, 2]).max() * 1e6 < 4


def test_one_and_many_epochs_give_the_same():
    np.testing.assert_allclose(ocean_tides(DAYS[3:4])[0], ocean_tides(DAYS)[0][3:4], rtol=1e-13)
    assert zonal_tides(np.array([0.1]))[0].shape == (1,)


def test_diurnal_motion_of_the_pole_is_prograde():
    # Retrograde diurnal motion of the pole is nutation, by convention (IERS 2010, section 5.4).
    t = 55000.0 + np.arange(0.0, 27.5, 0.01)
    value = ocean_tides(t)[0] + libration(t)[0]
    spectrum = np.abs(np.fft.fft(value[:, 0] - 1j * value[:, 1]))
    frequency = np.fft.fftfreq(len(t), 0.01)
    prograde = spectrum[(frequency > 0.8) & (frequency < 1.2)].max()
    retrograde = spectrum[(frequency < -0.8) & (frequency > -1.2)].max()
    assert prograde > 20 * retrograde
