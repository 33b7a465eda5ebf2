import numpy as np
import pytest

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.geodesy import rot_itrf_to_spherical_enu
from radioloc.earth.solid_tide import pole_tide_displacement, secular_pole_rad
from radioloc.errors import InputError
from radioloc.time import Epochs

ROUNDING_M = 1e-15
RADIUS_M = 6371000.0
TT = Epochs.from_jd(2451545.0 + 18 * 365.25, 0.0, "TT")
SECULAR_ARCSEC = (0.055 + 18 * 0.001677, 0.3205 + 18 * 0.00346)


def enu_mm(latitude_deg: float, longitude_deg: float, m1_arcsec: float, m2_arcsec: float) -> np.ndarray:
    """East, north and up for a wobble m1, m2."""
    lat, lon = np.deg2rad([latitude_deg, longitude_deg])
    station_m = RADIUS_M * np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    xp_rad = (SECULAR_ARCSEC[0] + m1_arcsec) * ARCSEC_RAD
    yp_rad = (SECULAR_ARCSEC[1] - m2_arcsec) * ARCSEC_RAD
    displacement_m = pole_tide_displacement(np.array([station_m]), xp_rad, yp_rad, TT)
    return 1e3 * rot_itrf_to_spherical_enu(station_m) @ displacement_m[0]


@pytest.mark.parametrize(
    ("place", "wobble", "expected"),
    [
        ((45.0, 0.0), (1.0, 0.0), (0.0, 0.0, -33.0)),
        ((45.0, 90.0), (0.0, 1.0), (0.0, 0.0, -33.0)),
        ((-45.0, 0.0), (1.0, 0.0), (0.0, 0.0, 33.0)),
        ((45.0, 90.0), (1.0, 0.0), (9.0 / np.sqrt(2.0), 0.0, 0.0)),
        ((45.0, 0.0), (0.0, 1.0), (-9.0 / np.sqrt(2.0), 0.0, 0.0)),
        ((0.0, 0.0), (1.0, 0.0), (0.0, -9.0, 0.0)),
        ((30.0, 0.0), (1.0, 0.0), (0.0, -4.5, -33.0 * np.sqrt(0.75))),
    ],
)
def test_equation_at_simple_places(
    place: tuple[float, float], wobble: tuple[float, float], expected: tuple[float, float, float]
) -> None:
    np.testing.assert_allclose(enu_mm(*place, *wobble), expected, rtol=0.0, atol=1e-10)


def test_is_the_response_to_the_centrifugal_potential() -> None:
    """Love numbers h2 = 0.6207 and l2 = 0.0836 at the wobble's frequency; 2 % for rounding to 33 and 9."""
    m1, m2 = 0.2, -0.3
    rate, gravity = 7.292115e-5, 9.82
    axis = np.array([m1 * ARCSEC_RAD, m2 * ARCSEC_RAD, 1.0])
    axis /= np.linalg.norm(axis)

    def height_m(unit: np.ndarray) -> float:
        return -0.5 * (rate * RADIUS_M) ** 2 / gravity * ((axis @ unit) ** 2 - unit[2] ** 2)

    lat, lon, step = 0.5, 2.0, 1e-4

    def unit_vector(latitude: float, longitude: float) -> np.ndarray:
        return np.array(
            [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
        )

    slope_north = (height_m(unit_vector(lat + step, lon)) - height_m(unit_vector(lat - step, lon))) / (
        2 * step
    )
    slope_east = (height_m(unit_vector(lat, lon + step)) - height_m(unit_vector(lat, lon - step))) / (
        2 * step
    )
    expected_m = [
        0.0836 * slope_east / np.cos(lat),
        0.0836 * slope_north,
        0.6207 * height_m(unit_vector(lat, lon)),
    ]
    np.testing.assert_allclose(
        enu_mm(np.rad2deg(lat), np.rad2deg(lon), m1, m2), np.multiply(expected_m, 1e3), rtol=0.02
    )


def test_no_displacement_at_the_secular_pole() -> None:
    assert np.abs(enu_mm(45.0, 30.0, 0.0, 0.0)).max() < 1e-10


def test_secular_pole() -> None:
    pole_mas = (
        secular_pole_rad(Epochs.from_jd([2451545.0, TT.jd[0]], [0.0, TT.fraction[0]], "TT")) / ARCSEC_RAD
    )
    np.testing.assert_allclose(pole_mas, [(0.055, 0.3205), SECULAR_ARCSEC], rtol=0.0, atol=1e-12)


def test_many_stations_and_epochs() -> None:
    tt = Epochs.from_jd(2451545.0 + np.array([0.0, 4000.0]), 0.0, "TT")
    stations_m = np.array([[4.6e6, 5e5, 4.4e6], [-1.3e6, -5.3e6, 3.2e6]])
    xp, yp = np.array([0.1, 0.2]) * ARCSEC_RAD, np.array([0.3, 0.5]) * ARCSEC_RAD
    both = pole_tide_displacement(stations_m, xp, yp, tt)
    assert both.shape == (2, 3)
    for i in range(2):
        single = pole_tide_displacement(stations_m[[i]], xp[i], yp[i], tt[i])
        np.testing.assert_allclose(single[0], both[i], rtol=0.0, atol=ROUNDING_M)
    repeated = pole_tide_displacement(stations_m[[0, 0]], xp, yp, tt)
    np.testing.assert_allclose(repeated[0], both[0], rtol=0.0, atol=ROUNDING_M)


def test_wants_tt() -> None:
    with pytest.raises(InputError, match="TT"):
        pole_tide_displacement(
            np.array([[6.4e6, 0.0, 0.0]]), 0.0, 0.0, Epochs.from_jd(2451545.0, scale="UTC")
        )
