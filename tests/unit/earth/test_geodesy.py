import numpy as np
import pytest

from radioloc.earth.geodesy import geodetic_from_itrf, itrf_from_geodetic, rot_itrf_to_enu
from radioloc.errors import InputError

ROUNDING_M = 2e-9
"""Rounding of coordinates of an Earth radius, some units in the last place."""

ROUNDING = 1e-14

EQUATORIAL_RADIUS_M = 6378137.0
POLAR_RADIUS_M = 6356752.314140356
"""GRS80 (Moritz 2000); WGS84's is 0.1 mm longer."""


def test_axes_of_the_ellipsoid() -> None:
    place = geodetic_from_itrf([[EQUATORIAL_RADIUS_M, 0.0, 0.0], [0.0, 0.0, POLAR_RADIUS_M + 100.0]])
    np.testing.assert_allclose(place.height_m, [0.0, 100.0], rtol=0.0, atol=ROUNDING_M)
    np.testing.assert_allclose(place.latitude_rad, [0.0, np.pi / 2], rtol=0.0, atol=ROUNDING)
    assert place.longitude_rad[0] == 0.0


def test_round_trip() -> None:
    longitude, latitude = np.meshgrid(
        np.deg2rad([-179.0, -60.0, 0.0, 121.0]), np.deg2rad([-89.0, -30.0, 0.0, 78.0])
    )
    itrf_m = itrf_from_geodetic(longitude, latitude, 2800.0)
    assert itrf_m.shape == (4, 4, 3)
    place = geodetic_from_itrf(itrf_m)
    np.testing.assert_allclose(place.longitude_rad, longitude, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(place.latitude_rad, latitude, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(place.height_m, 2800.0, rtol=0.0, atol=ROUNDING_M)


def test_local_axes_are_those_of_finite_steps() -> None:
    longitude, latitude, height = 2.1, 0.55, 300.0
    origin_m = itrf_from_geodetic(longitude, latitude, height)
    rot = rot_itrf_to_enu(origin_m)
    steps = [(1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 10.0)]
    for axis, (d_lon, d_lat, d_h) in enumerate(steps):
        displaced_m = itrf_from_geodetic(longitude + d_lon, latitude + d_lat, height + d_h)
        back = itrf_from_geodetic(longitude - d_lon, latitude - d_lat, height - d_h)
        unit = (displaced_m - back) / np.linalg.norm(displaced_m - back)
        # Rounding of positions over a step of 6 m or more.
        np.testing.assert_allclose(rot @ unit, np.eye(3)[axis], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(rot @ rot.T, np.eye(3), rtol=0.0, atol=ROUNDING)
    assert np.linalg.det(rot) == pytest.approx(1.0, abs=ROUNDING)


def test_refuses() -> None:
    with pytest.raises(InputError, match="give metres"):
        geodetic_from_itrf([6378.137, 0.0, 0.0])
    with pytest.raises(InputError, match="shape"):
        geodetic_from_itrf([6378137.0, 0.0])
    with pytest.raises(InputError, match="finite"):
        geodetic_from_itrf([np.nan, 0.0, 0.0])
