from fractions import Fraction

import erfa
import numpy as np
import pytest

from radioloc.earth.eop import EopTable
from radioloc.earth.orientation import EarthOrientation, _celestial_pole, earth_rotation_angle
from radioloc.errors import PredictedEopWarning
from radioloc.time import Epochs, epochs_from_strings, utc_to_tt
from radioloc.time.smooth import FIRST_JD, SPAN_D

EARTH_RADIUS_M = 6.4e6


@pytest.fixture(scope="module")
def model():
    return EarthOrientation.default()


def years(n=60):
    return Epochs.from_jd(2451545.0 + np.linspace(0.0, 9000.0, n), 0.137, "TT")


@pytest.mark.parametrize("terms", [True, False])
def test_rate_is_the_derivative(terms):
    model = EarthOrientation(EopTable.packaged(), subdaily_tides=terms, libration=terms, zonal_tides=terms)
    tt, h = years(), 10.0
    difference = (
        model.evaluate(tt.shifted(h)).rot_itrf_to_gcrs - model.evaluate(tt.shifted(-h)).rot_itrf_to_gcrs
    )
    # A central difference shrinks a rotation at angular velocity w by sin(w h) / (w h).
    spin = 7.292115e-5
    difference = difference / (2 * h) / np.sinc(spin * h / np.pi)
    # Without the pole's motion it would be 8e-12.
    np.testing.assert_allclose(model.evaluate(tt).rot_itrf_to_gcrs_rate, difference, rtol=0, atol=3e-16)


def test_rotation_is_continuous_over_a_leap_second(model):
    tt = utc_to_tt(epochs_from_strings("2016-12-31T23:59:50", "UTC"))
    tt = Epochs.from_jd(tt.jd, tt.fraction + np.arange(0.0, 20.0, 0.25) / 86400.0, "TT")
    station = model.evaluate(tt).rot_itrf_to_gcrs @ np.array([EARTH_RADIUS_M, 0.0, 0.0])
    third = np.diff(station, 3, axis=0)
    assert np.abs(third).max() < 1e-6  # m; the spin's is 4e-8 m, round-off's 4e-8 m, a second's 460 m


def test_terms_add_what_they_should(model):
    tt = years(400)
    deterministic = {
        name: EarthOrientation(model.table, **{name: False}).evaluate(tt)
        for name in ("subdaily_tides", "libration", "zonal_tides")
    }
    full = model.evaluate(tt)
    sizes = {
        name: np.abs(full.rot_itrf_to_gcrs - part.rot_itrf_to_gcrs).max() * EARTH_RADIUS_M
        for name, part in deterministic.items()
    }
    assert 0.02 < sizes["subdaily_tides"] < 0.05
    assert 0.001 < sizes["libration"] < 0.003
    assert 0.0003 < sizes["zonal_tides"] < 0.0015
    np.testing.assert_array_equal(full.xp_table_rad, deterministic["subdaily_tides"].xp_table_rad)
    assert np.abs(full.xp_rad - full.xp_table_rad).max() > 1e-9


def test_earth_rotation_angle_keeps_all_digits():
    jd = 2400000.5 + np.array([41317.0, 51544.0, 57754.0, 61365.0])
    fraction = np.array([0.1, 0.999999999, 0.123456789, 0.5])
    turn = Fraction("0.7790572732640"), Fraction("1.00273781191135448")  # IERS 2010, eq. 5.15
    got = earth_rotation_angle(Epochs(jd, fraction, "UT1"))
    for k in range(len(jd)):
        days = Fraction(jd[k]) + Fraction(fraction[k]) - Fraction(2451545)
        exact = float((turn[0] + turn[1] * days) % 1) * 2 * np.pi
        assert got[k] == pytest.approx(exact, abs=1e-14)


def test_predictions_warn_once_and_are_flagged(model):
    last = epochs_from_strings(model.table.last_measured_date, "UTC")
    tt = Epochs.from_jd(last.jd[0] + np.array([-10.0, 5.0, 6.0]), 0.5, "TT")
    with pytest.warns(
        PredictedEopWarning, match=f"2 of 3 epochs.*measured values end {model.table.last_measured_date}"
    ) as warning:
        earth = model.evaluate(tt)
    assert len(warning) == 1
    np.testing.assert_array_equal(earth.predicted, [False, True, True])


def test_pole_is_that_of_erfa():
    """Over the whole table, its ends and the joints between its polynomials, and after it."""
    random = np.random.default_rng(2).uniform(0.0, SPAN_D * 891 + 3000.0, 4000)
    tt = Epochs.from_jd(FIRST_JD + np.r_[random, SPAN_D * np.arange(892), SPAN_D * 891 - 1e-9], 0.0, "TT")
    (x, y), (x_rate, y_rate) = _celestial_pole(tt)
    expected_x, expected_y, s = erfa.xys06a(tt.jd, tt.fraction)
    np.testing.assert_allclose([x, y], [expected_x, expected_y], rtol=0, atol=2e-14)
    np.testing.assert_allclose(erfa.s06(tt.jd, tt.fraction, x, y), s, rtol=0, atol=5e-17)
    step_d = 0.01
    moved = [np.stack(erfa.xys06a(tt.jd, tt.fraction + d)[:2]) for d in (step_d, -step_d)]
    rates = (moved[0] - moved[1]) / (2 * step_d * 86400.0)
    # The difference bends by 1e-17 rad/s, and so do the polynomials at their ends.
    np.testing.assert_allclose([x_rate, y_rate], rates, rtol=0, atol=3e-17)


def test_rough_rotation_is_good_to_twenty_metres(model):
    tt = years(400)
    moved = (model.rough_rotation(tt) - model.evaluate(tt).rot_itrf_to_gcrs) * EARTH_RADIUS_M
    assert 5.0 < np.linalg.norm(moved, axis=(1, 2)).max() < 30.0
