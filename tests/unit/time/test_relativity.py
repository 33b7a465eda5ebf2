"""TDB - TT against ERFA, and the two forms of its part that depends on the place against each other."""

import erfa
import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.earth import EarthOrientation, StationCatalogue
from radioloc.ephemeris import Ephemeris
from radioloc.time import Epochs, geocentric_tdb_minus_tt, topocentric_tdb_minus_tt, tt_to_tdb

# ERFA's terms for a place leave out the second order in eccentricity (2.6e-10 s along the spin axis) and there also
# what Jupiter and the Moon do to the Earth's velocity, 12 m/s each (3.5e-10 s): 1.17 ns at the worst, found over all
# stations of the catalogue and 50 years. The whole is 2 microseconds.
SERIES_TRUNCATION_S = 1.2e-9
# What is left out has no daily term above this.
SERIES_DAILY_TRUNCATION_S = 4e-10


def tdb_minus_tt(epochs, ut1_fraction, longitude_rad, u_m, v_m):
    """ERFA's series with its terms for a place."""
    u_km, v_km = np.asarray(u_m) / 1e3, np.asarray(v_m) / 1e3
    return erfa.dtdb(epochs.jd, epochs.fraction, ut1_fraction, longitude_rad, u_km, v_km)


def test_erfa_value():
    """The value of ERFA's own test of dtdb (t_erfa_c.c), to its own tolerance."""
    epochs = Epochs.from_jd(2448939.5, 0.123, "TDB")
    got = tdb_minus_tt(epochs, 0.76543, 5.0123, 5525.242e3, 3190.0e3)
    assert got == pytest.approx([-0.1280368005936998991e-2], rel=0, abs=1e-15)


def test_geocentric_is_the_series_without_a_place():
    # Within the table from 1972 to 2049, before it and after it; 3e-16 s are a tenth of a micrometre of light.
    epochs = Epochs.from_jd(2440000.5 + 7.1 * np.arange(5000), 0.3, "TT")
    zero = np.zeros(5000)
    expected_s = tdb_minus_tt(epochs, zero, zero, zero, zero)
    np.testing.assert_allclose(geocentric_tdb_minus_tt(epochs), expected_s, rtol=0, atol=3e-16)
    assert (
        1.5e-3
        < np.abs(geocentric_tdb_minus_tt(Epochs.from_jd(2459000.5 + np.arange(366), 0.0, "TDB"))).max()
        < 1.7e-3
    )


@pytest.mark.parametrize("name", ["APOLLO", "GRASSE", "KASHI", "NEUQUEN", "SESHAN25"])
def test_topocentric_part_against_the_series(name):
    tt = Epochs.from_jd(
        np.repeat(2453736.5 + 61.0 * np.arange(12), 24), np.tile(np.arange(24) / 24.0, 12), "TT"
    )
    rotation = EarthOrientation.default().evaluate(tt)
    x_m, y_m, z_m = StationCatalogue.default().get(name).itrf_m
    tdb = tt_to_tdb(tt)
    velocity_m_s = Ephemeris.open().earth(tdb).velocity_m_s
    station_gcrs_m = rotation.rot_itrf_to_gcrs @ np.array([x_m, y_m, z_m])
    exact = topocentric_tdb_minus_tt(velocity_m_s, station_gcrs_m)
    at_place = tdb_minus_tt(tdb, rotation.ut1.fraction, np.arctan2(y_m, x_m), np.hypot(x_m, y_m), z_m)
    left_out_s = exact - (at_place - geocentric_tdb_minus_tt(tdb))
    assert np.abs(left_out_s).max() < SERIES_TRUNCATION_S
    by_day = left_out_s.reshape(12, 24)
    assert np.abs(by_day - by_day.mean(axis=1, keepdims=True)).max() < SERIES_DAILY_TRUNCATION_S
    assert 1.0e-6 < np.abs(exact).max() < 2.2e-6


def test_topocentric_part_by_hand():
    velocity, place = np.array([[0.0, 3e4, 0.0]]), np.array([[1e6, 6e6, 2e6]])
    assert topocentric_tdb_minus_tt(velocity, place) == pytest.approx([3e4 * 6e6 / C_M_S**2], rel=1e-15)
