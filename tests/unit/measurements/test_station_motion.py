"""Barycentric motion of stations: displacements, scale and contraction of lengths, clocks."""

import dataclasses

import numpy as np
import pytest

from radioloc.constants import C_M_S, L_B, L_G
from radioloc.earth.blq import BlqCoefficients
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.earth.ocean_loading import TIDAL_GEOCENTRE_M, loading_enu_m, loading_itrf_m, sum_of_tides
from radioloc.earth.solid_tide import pole_tide_displacement, solid_earth_tide
from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import Ephemeris
from radioloc.measurements.station_motion import geocentre_displacement_m, station_motion
from radioloc.time import Epochs, geocentric_tdb_minus_tt

REFERENCE = Epochs.from_jd(2459185.5 + 13.7 * np.arange(27), 0.0, "TDB")
COUNT = len(REFERENCE)
STATIONS = tuple(StationCatalogue.default()[name] for name in ("GRASSE", "APOLLO", "KASHI"))
STATION_INDEX = np.arange(COUNT, dtype=np.int32) % 3


def motion(model, offset_s=0.0, stations=STATIONS, station_index=STATION_INDEX):
    earth = model.ephemeris.earth(REFERENCE)
    return station_motion(model, stations, station_index, REFERENCE, earth, np.full(COUNT, offset_s))


def position_without(model, *terms):
    return motion(model.without(*terms)).point.position_m


def test_motion_of_the_geocentre_is_that_of_the_ephemeris():
    """Compare with barycentric positions of the ephemeris; their rounding is 3e-5 m, the jerk 5e-9 m at 3 s."""
    ephemeris = Ephemeris.open()
    start = ephemeris.earth(REFERENCE)
    for offset_s in (-2.7, 1.3, 3.0):
        moved = ephemeris.earth(REFERENCE.shifted(offset_s)).position_m - start.position_m
        predicted = geocentre_displacement_m(start, np.full(COUNT, offset_s))
        np.testing.assert_allclose(predicted, moved, rtol=0, atol=2e-4)
    # At a longer offset the second order is 3 mm per 1 s^2 and the third 2e-4 m.
    moved = ephemeris.earth(REFERENCE.shifted(100.0)).position_m - start.position_m
    np.testing.assert_allclose(
        geocentre_displacement_m(start, np.full(COUNT, 100.0)), moved, rtol=0, atol=1e-3
    )
    assert np.abs(start.acceleration_m_s2).max() * 100.0**2 / 2 > 20.0


def test_velocity_is_the_derivative_of_the_position(model):
    # Over +-2 s the third derivative of the spin, 2.5e-6 m/s^3, contributes 2e-6 m/s; rounding is smaller.
    # The velocity leaves out the motion by tides of 1e-5 m/s (1e-8 m in a millisecond).
    change_m = motion(model, 2.0).point.position_m - motion(model, -2.0).point.position_m
    np.testing.assert_allclose(motion(model).point.velocity_m_s, change_m / 4.0, rtol=0, atol=5e-5)


def test_linear_motion_is_valid_for_a_millisecond(model):
    """The light path relies on 2e-8 m; the bound includes the rounding of positions near 6e6 m."""
    point = motion(model).point
    for offset_s in (-1e-3, 1e-3):
        expected_m = motion(model, offset_s).point.position_m
        assert np.abs(point.position_at(np.full(COUNT, offset_s)) - expected_m).max() < 5e-8


def test_scale_and_contraction(model):
    """Compare with the transformation r (1 - U/c^2 - L_C) - v (v.r) / (2 c^2)."""
    full = motion(model)
    earth = model.ephemeris.earth(REFERENCE)
    r, v = full.gcrs_m, earth.velocity_m_s
    scale = full.point.position_m - position_without(model, "earth_scale")
    contraction = full.point.position_m - position_without(model, "earth_lorentz")
    # U of the Sun at 1 au is 9.87e-9 c^2, of the Moon 1.4e-13; L_C = 1.4808268674e-8 (IERS 2010, table 1.1).
    ratio = -np.einsum("ni,ni->n", scale, r) / np.einsum("ni,ni->n", r, r)
    distance_au = np.linalg.norm(model.ephemeris.geocentric("sun", REFERENCE)[0], axis=-1) / 1.495978707e11
    np.testing.assert_allclose(ratio, 1.48082686741e-8 + 9.87062e-9 / distance_au, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.cross(scale, r) / 6.4e6, 0.0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        contraction, -v * np.einsum("ni,ni->n", v, r)[:, None] / (2 * C_M_S**2), rtol=0, atol=1e-8
    )
    assert pytest.approx(1.48082686741e-8, abs=1e-17) == L_B - L_G
    assert 0.15 < np.linalg.norm(scale, axis=-1).max() < 0.16
    assert 0.02 < np.linalg.norm(contraction, axis=-1).max() < 0.035


@pytest.mark.parametrize("term", ["solid_earth_tide", "pole_tide", "ocean_loading", "tidal_geocentre"])
def test_displacements_are_those_of_their_functions(model, term):
    """Compare with the functions for the TT of the station, Moon and Sun in the ITRF, and tabulated pole and UT1."""
    tt = Epochs.from_jd(REFERENCE.jd, REFERENCE.fraction - geocentric_tdb_minus_tt(REFERENCE) / 86400.0, "TT")
    rotation = model.earth.evaluate(tt)
    moon_m, sun_m = (
        np.einsum("nji,nj->ni", rotation.rot_itrf_to_gcrs, model.ephemeris.geocentric(body, REFERENCE)[0])
        for body in ("moon", "sun")
    )
    displacement_m = np.einsum(
        "nji,nj->ni",
        rotation.rot_itrf_to_gcrs,
        motion(model).point.position_m - position_without(model, term),
    )
    for i, station in enumerate(STATIONS):
        rows = np.flatnonzero(i == STATION_INDEX)
        position_m, fraction = station.position_at(tt[rows]), rotation.ut1.fraction[rows]
        expected_m = np.zeros((len(rows), 3))
        if term == "solid_earth_tide":
            expected_m = solid_earth_tide(position_m, moon_m[rows], sun_m[rows], tt[rows], fraction)
        elif term == "pole_tide":
            pole = rotation.xp_table_rad[rows], rotation.yp_table_rad[rows]
            expected_m = pole_tide_displacement(position_m, *pole, tt[rows])
        elif term == "tidal_geocentre":
            expected_m = sum_of_tides(TIDAL_GEOCENTRE_M, tt[rows], fraction)
        elif station.ocean_loading is not None:
            loading_m = loading_itrf_m(station.ocean_loading, station.itrf_m)
            expected_m = sum_of_tides(loading_m, tt[rows], fraction)
        # Barycentric lengths are shorter by 3e-8; positions are rounded to 1e-9 m.
        np.testing.assert_allclose(displacement_m[rows], expected_m, rtol=0, atol=3e-8)


def test_tidal_geocentre_in_loading_coefficients_is_not_added_again(model):
    """Loading with respect to the solid Earth and loading marked as including the tidal geocentre are equal."""
    of_crust = motion(model).point.position_m
    station = STATIONS[0]
    tides_m = loading_enu_m(station.ocean_loading) + rot_itrf_to_enu(station.itrf_m) @ TIDAL_GEOCENTRE_M
    up_west_south_m = np.stack([tides_m[2], -tides_m[0], -tides_m[1]])
    marked = BlqCoefficients("A", np.abs(up_west_south_m), -np.angle(up_west_south_m), "made", True)
    stations = (dataclasses.replace(station, ocean_loading=marked), *STATIONS[1:])
    np.testing.assert_allclose(motion(model, stations=stations).point.position_m, of_crust, rtol=0, atol=1e-8)
    unloaded = model.without("ocean_loading")  # then the tidal geocentre is a separate term
    np.testing.assert_array_equal(
        motion(unloaded, stations=stations).point.position_m, motion(unloaded).point.position_m
    )


def test_clock_of_the_station(model):
    """Compare the rate of TDB - TT, from v^2/2 and the potential, with differences."""
    station = motion(model)
    earth = model.ephemeris.earth(REFERENCE)
    np.testing.assert_allclose(
        station.topocentric_s,
        np.einsum("ni,ni->n", earth.velocity_m_s, station.gcrs_m) / C_M_S**2,
        rtol=0,
        atol=1e-15,
    )
    step_s = 600.0
    ahead, behind = motion(model, step_s), motion(model, -step_s)
    rate = (ahead.tdb_minus_tt_s - behind.tdb_minus_tt_s) / (2 * step_s)
    # Left out: the potential of the planets (Jupiter's 1.8e-12, Saturn's 3e-13).
    # Over a millisecond, for which the rate is used, that is 1 micrometre.
    np.testing.assert_allclose(station.tdb_rate, rate, rtol=0, atol=4e-12)
    assert np.abs(station.tdb_rate).max() > 2e-10
    np.testing.assert_allclose(
        station.tdb_minus_tt_at(np.full(COUNT, 1e-3)),
        station.tdb_minus_tt_s + 1e-3 * station.tdb_rate,
        rtol=0,
        atol=1e-18,
    )


def test_clock_of_the_geocentre_at_another_epoch(model):
    """TDB - TT at the geocentre is linear in offsets of a second, with a rate of up to 1e-10."""
    station, step_s = motion(model, 0.5), np.full(COUNT, 1.0)
    for offset_s in (0.5 + step_s, 0.5 - step_s):
        computed_s = station.geocentric_tdb_minus_tt_at(offset_s)
        expected_s = geocentric_tdb_minus_tt(REFERENCE.shifted(offset_s))
        np.testing.assert_allclose(computed_s, expected_s, rtol=0, atol=4e-12)
    assert np.abs(station.geocentric_tdb_rate).max() > 1e-10


def test_vertical_and_geodetic_position(model):
    station = motion(model)
    np.testing.assert_allclose(np.linalg.norm(station.up_gcrs, axis=-1), 1.0, rtol=0, atol=1e-14)
    vertical_m = np.einsum("ni,ni->n", station.up_gcrs, station.gcrs_m)
    # The ellipsoid's normal is at most 0.19 deg off the radius.
    assert (vertical_m > np.linalg.norm(station.gcrs_m, axis=-1) * np.cos(np.radians(0.2))).all()
    rate = (motion(model, 1.0).up_gcrs - motion(model, -1.0).up_gcrs) / 2.0
    np.testing.assert_allclose(station.up_rate_gcrs, rate, rtol=0, atol=1e-12)
    assert np.degrees(station.latitude_rad[:3]) == pytest.approx([43.75, 32.78, 38.42], abs=0.02)
    assert station.height_m[:2] == pytest.approx([1323.0, 2788.0], abs=30.0)
