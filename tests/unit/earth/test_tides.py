"""Displacements by the solid tide and the pole tide."""

import numpy as np
import pytest

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.geodesy import itrf_from_geodetic, rot_itrf_to_spherical_enu
from radioloc.earth.solid_tide import pole_tide_displacement, secular_pole_rad, solid_earth_tide
from radioloc.errors import InputError
from radioloc.time import Epochs

RADIUS_M = 6371000.0
TT = Epochs.from_jd(2451545.0 + 18 * 365.25, 0.0, "TT")
SECULAR_ARCSEC = (0.055 + 18 * 0.001677, 0.3205 + 18 * 0.00346)


def unit_vector(latitude: float, longitude: float) -> np.ndarray:
    x, y = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    return np.array([x, y, np.sin(latitude)])


def enu_mm(latitude_deg: float, longitude_deg: float, m1_arcsec: float, m2_arcsec: float) -> np.ndarray:
    """East, north and up for a wobble m1, m2."""
    station_m = RADIUS_M * unit_vector(*np.deg2rad([latitude_deg, longitude_deg]))
    xp_rad = (SECULAR_ARCSEC[0] + m1_arcsec) * ARCSEC_RAD
    yp_rad = (SECULAR_ARCSEC[1] - m2_arcsec) * ARCSEC_RAD
    displacement_m = pole_tide_displacement(np.array([station_m]), xp_rad, yp_rad, TT)
    return 1e3 * rot_itrf_to_spherical_enu(station_m) @ displacement_m[0]


@pytest.mark.parametrize(
    ("place", "wobble", "expected"),
    [
        ((45.0, 30.0), (0.0, 0.0), (0.0, 0.0, 0.0)),
        ((45.0, 0.0), (1.0, 0.0), (0.0, 0.0, -33.0)),
        ((45.0, 90.0), (0.0, 1.0), (0.0, 0.0, -33.0)),
        ((-45.0, 0.0), (1.0, 0.0), (0.0, 0.0, 33.0)),
        ((45.0, 90.0), (1.0, 0.0), (9.0 / np.sqrt(2.0), 0.0, 0.0)),
        ((45.0, 0.0), (0.0, 1.0), (-9.0 / np.sqrt(2.0), 0.0, 0.0)),
        ((0.0, 0.0), (1.0, 0.0), (0.0, -9.0, 0.0)),
        ((30.0, 0.0), (1.0, 0.0), (0.0, -4.5, -33.0 * np.sqrt(0.75))),
    ],
)
def test_equation_at_simple_places(place: tuple, wobble: tuple, expected: tuple) -> None:
    np.testing.assert_allclose(enu_mm(*place, *wobble), expected, rtol=0.0, atol=1e-10)


def test_is_the_response_to_the_centrifugal_potential() -> None:
    """Love numbers h2 = 0.6207 and l2 = 0.0836 at the wobble's frequency; 2 % for rounding to 33 and 9."""
    m1, m2 = 0.2, -0.3
    axis = np.array([m1 * ARCSEC_RAD, m2 * ARCSEC_RAD, 1.0])
    axis /= np.linalg.norm(axis)

    def height_m(latitude: float, longitude: float) -> float:
        unit = unit_vector(latitude, longitude)
        return -0.5 * (7.292115e-5 * RADIUS_M) ** 2 / 9.82 * ((axis @ unit) ** 2 - unit[2] ** 2)

    lat, lon, step = 0.5, 2.0, 1e-4
    slope_north = (height_m(lat + step, lon) - height_m(lat - step, lon)) / (2 * step)
    slope_east = (height_m(lat, lon + step) - height_m(lat, lon - step)) / (2 * step)
    expected_m = [0.0836 * slope_east / np.cos(lat), 0.0836 * slope_north, 0.6207 * height_m(lat, lon)]
    found_mm = enu_mm(np.rad2deg(lat), np.rad2deg(lon), m1, m2)
    np.testing.assert_allclose(found_mm, np.multiply(expected_m, 1e3), rtol=0.02)


def test_secular_pole() -> None:
    tt = Epochs.from_jd([2451545.0, TT.jd[0]], [0.0, TT.fraction[0]], "TT")
    pole_arcsec = secular_pole_rad(tt) / ARCSEC_RAD
    np.testing.assert_allclose(pole_arcsec, [(0.055, 0.3205), SECULAR_ARCSEC], rtol=0.0, atol=1e-12)


MOON_M = 3.844e8 * np.array([1.0, 0.3, 0.4]) / np.sqrt(1.25)
SUN_M = 1.496e11 * np.array([-0.3, 1.0, 0.4]) / np.sqrt(1.25)


def tide(station_m: object, tt: Epochs, ut1_fraction: object) -> np.ndarray:
    """Tide of a station, where Moon and Sun stand still."""
    places = (np.tile(place, (len(tt), 1)) for place in (station_m, MOON_M, SUN_M))
    return solid_earth_tide(*places, tt, ut1_fraction)


def test_no_step_at_midnight() -> None:
    """The UT1 day ends between two epochs one microsecond apart; a day's tide moves 6e-11 m in that time."""
    tt = Epochs.from_jd(2459000.5, np.array([0.0008, 0.0008 + 1e-6 / 86400.0]), "TT")
    earlier, later = tide(itrf_from_geodetic(1.0, 0.9, 0.0), tt, np.array([1.0 - 1e-6 / 86400.0, 0.0]))
    np.testing.assert_allclose(earlier, later, rtol=0.0, atol=1e-10)


def test_correction_of_the_k1_tide_turns_with_the_sidereal_day() -> None:
    """Over a day of fixed Moon and Sun only step 2 moves: K1 with 12 mm at latitude 45 degrees leads."""
    station_m, fraction = itrf_from_geodetic(0.3, np.pi / 4, 0.0), np.arange(24) / 24.0
    displacement_m = tide(station_m, Epochs.from_jd(2459000.5, fraction, "TT"), fraction)
    up_m = displacement_m @ rot_itrf_to_spherical_enu(station_m)[2]
    assert 9e-3 < np.ptp(up_m) / 2 < 16e-3


def test_stations_at_the_poles_have_a_tide() -> None:
    midnight = Epochs.from_jd(2459000.5, 0.0, "TT")
    pole, neighbour = (tide([x, 0.0, 6356752.0], midnight, 0.0) for x in (0.0, 1e-3))
    np.testing.assert_allclose(pole, neighbour, rtol=0.0, atol=1e-9)


def test_wants_tt() -> None:
    with pytest.raises(InputError, match="TT"):
        tide([6378137.0, 0, 0], Epochs.from_jd(2459000.5, 0.0, "UTC"), 0.0)
