import numpy as np
import pytest

from radioloc.earth.geodesy import itrf_from_geodetic
from radioloc.errors import InputError
from radioloc.media.ionosphere import (
    GROUP_DELAY_M3_S2,
    ionosphere_delay_m,
    modified_shell_mapping,
    pierce_point,
)


def test_constant() -> None:
    """From e, eps0 and m_e of CODATA 2018."""
    charge, permittivity, mass = 1.602176634e-19, 8.8541878128e-12, 9.1093837015e-31
    expected = charge**2 / (8.0 * np.pi**2 * permittivity * mass)
    # Half of the last digit of the constant.
    assert pytest.approx(expected, abs=5e-10) == GROUP_DELAY_M3_S2


def test_delay_in_the_bands() -> None:
    # One TECU is 0.162 m at GPS L1 (1575.42 MHz), a number every textbook has.
    assert ionosphere_delay_m(1.0, 1575.42e6) == pytest.approx(0.16240, abs=1e-5)
    delays = ionosphere_delay_m(np.array([10.0, 50.0, 50.0]), np.array([2.2e9, 8.4e9, 32e9]))
    np.testing.assert_allclose(delays, [0.833, 0.2856, 0.0197], atol=5e-4)
    assert ionosphere_delay_m(0.0, 8.4e9) == 0.0
    # The combination of two frequencies that dual-band VLBI forms takes it away.
    s, x = ionosphere_delay_m(37.0, np.array([2.3e9, 8.6e9])) * np.array([2.3e9, 8.6e9]) ** 2
    assert s == pytest.approx(x, rel=1e-15)


def test_modified_shell() -> None:
    elevation = np.deg2rad([10.0, 20.0, 45.0, 90.0])
    mapping, _ = modified_shell_mapping(elevation)
    zenith = np.pi / 2 - elevation
    written_out = 1.0 / np.sqrt(1.0 - (6371.0 / (6371.0 + 506.7) * np.sin(0.9782 * zenith)) ** 2)
    np.testing.assert_allclose(mapping, written_out, rtol=1e-14)
    # All electrons in a shell at 450 km: the triangle of geocentre, station and pierce point, by the law of sines.
    plain = 1.0 / np.cos(np.arcsin(6371.0 / 6821.0 * np.cos(elevation)))
    np.testing.assert_allclose(1.0 - mapping / plain, [0.069, 0.056, 0.019, 0.0], atol=1e-3)


def test_rate_is_the_derivative() -> None:
    mapping = modified_shell_mapping
    elevation, step = np.deg2rad([3.1, 20.0, 60.0, 89.0]), 1e-6
    difference = (mapping(elevation + step)[0] - mapping(elevation - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(mapping(elevation)[1], difference, rtol=1e-7, atol=1e-9)


def test_pierce_point_by_spherical_trigonometry() -> None:
    """At a station on the equator, where the normal of the ellipsoid goes through the geocentre."""
    station = itrf_from_geodetic(np.deg2rad(100.0), 0.0, 0.0)
    azimuth, elevation = np.deg2rad([0.0, 90.0, 225.0]), np.deg2rad([30.0, 20.0, 10.0])
    latitude, longitude = pierce_point(station, azimuth, elevation)
    arc = np.pi / 2 - elevation - np.arcsin(6378137.0 / 6821e3 * np.cos(elevation))
    sin_latitude = np.sin(arc) * np.cos(azimuth)
    np.testing.assert_allclose(latitude, np.arcsin(sin_latitude), atol=1e-13)
    east = np.arctan2(np.sin(arc) * np.sin(azimuth), np.cos(arc))
    np.testing.assert_allclose(longitude, np.deg2rad(100.0) + east, atol=1e-13)


def test_pierce_point_lies_on_the_ray_and_on_the_shell() -> None:
    longitude, latitude = np.deg2rad([-116.9, 149.0]), np.deg2rad([35.4, -35.4])
    stations = itrf_from_geodetic(longitude, latitude, [1000.0, 700.0])
    up = itrf_from_geodetic(longitude, latitude, [2000.0, 1700.0]) - stations
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    elevation = np.deg2rad([10.0, 70.0])
    at_latitude, at_longitude = pierce_point(stations, [1.0, 5.0], elevation, 350e3)
    point = 6721e3 * np.stack(
        [
            np.cos(at_latitude) * np.cos(at_longitude),
            np.cos(at_latitude) * np.sin(at_longitude),
            np.sin(at_latitude),
        ],
        axis=-1,
    )
    ray = point - stations
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.arcsin(np.sum(ray * up, axis=-1)), elevation, atol=1e-9)


def test_pierce_point_overhead() -> None:
    station = itrf_from_geodetic(0.5, 1.0, 0.0)
    latitude, longitude = pierce_point(station, 0.3, np.pi / 2)
    assert longitude == pytest.approx(0.5, abs=1e-12)
    # Geocentric latitude is below geodetic by up to 0.19 degrees on the ground, less above.
    assert 0.0 < 1.0 - latitude < np.deg2rad(0.19)


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: ionosphere_delay_m(-1.0, 8.4e9), "electron contents are -1 to -1 TECU"),
        (lambda: ionosphere_delay_m(5e17, 8.4e9), "5e.17 TECU"),
        (lambda: ionosphere_delay_m(np.nan, 8.4e9), "electron contents are nan"),
        (lambda: ionosphere_delay_m(10.0, 8400.0), "frequencies are 8400 to 8400 Hz"),
        (lambda: modified_shell_mapping(0.01), "elevation is 0.01"),
        (lambda: pierce_point([6378e3, 0.0, 0.0], 0.0, 0.5, 450.0), "a shell 450 m above"),
        (lambda: modified_shell_mapping(20.0), "elevation is 20"),
        (lambda: pierce_point([6378e3, 0.0, 0.0], 0.0, -0.1), "elevation is -0.1"),
        (lambda: pierce_point([6378e3, 0.0, 0.0], np.nan, 0.5), "azimuth is not a finite"),
        (lambda: pierce_point([7000e3, 0.0, 0.0], 0.0, 0.5), "not below the shell"),
    ],
)
def test_refuses_what_cannot_be(call, what: str) -> None:
    with pytest.raises(InputError, match=what):
        call()
