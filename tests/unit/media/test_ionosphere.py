"""The ionosphere: its constant, the mapping of its shell, and its delays on legs and paths."""

import numpy as np
import pytest
from legs import leg

from radioloc.earth.geodesy import itrf_from_geodetic
from radioloc.errors import InputError
from radioloc.media.ionosphere import (
    GROUP_DELAY_M3_S2,
    Ionosphere,
    UniformTec,
    delay_by_content_m,
    ionosphere_delay_m,
    modified_shell_mapping,
    pierce_point,
)
from radioloc.media.medium import Status

X_DOWN_HZ = 8.4e9


def test_constant() -> None:
    """Constant computed with e, eps0 and m_e of CODATA 2018."""
    charge, permittivity, mass = 1.602176634e-19, 8.8541878128e-12, 9.1093837015e-31
    expected = charge**2 / (8.0 * np.pi**2 * permittivity * mass)
    # Half of the last digit of the constant.
    assert pytest.approx(expected, abs=5e-10) == GROUP_DELAY_M3_S2


def test_delay_in_the_bands() -> None:
    # Textbook value: one TECU is 0.162 m at GPS L1 (1575.42 MHz).
    assert ionosphere_delay_m(1.0, 1575.42e6) == pytest.approx(0.16240, abs=1e-5)
    delays = ionosphere_delay_m(np.array([0.0, 10.0, 50.0, 50.0]), np.array([8.4e9, 2.2e9, 8.4e9, 32e9]))
    np.testing.assert_allclose(delays, [0.0, 0.833, 0.2856, 0.0197], atol=5e-4)


def test_modified_shell() -> None:
    elevation, step = np.deg2rad([10.0, 20.0, 45.0, 89.0]), 1e-6
    mapping, rate = modified_shell_mapping(elevation)
    zenith = np.pi / 2 - elevation
    written_out = 1.0 / np.sqrt(1.0 - (6371.0 / (6371.0 + 506.7) * np.sin(0.9782 * zenith)) ** 2)
    np.testing.assert_allclose(mapping, written_out, rtol=1e-14)
    # All electrons in a shell at 450 km: the triangle of geocentre, station and pierce point, by the law of sines.
    plain = 1.0 / np.cos(np.arcsin(6371.0 / 6821.0 * np.cos(elevation)))
    np.testing.assert_allclose(1.0 - mapping / plain, [0.069, 0.056, 0.019, 0.0], atol=1e-3)
    ahead, behind = (modified_shell_mapping(elevation + k * step)[0] for k in (1, -1))
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), rtol=1e-7, atol=1e-9)


def test_pierce_point_by_spherical_trigonometry() -> None:
    """Station on the equator, where the normal of the ellipsoid goes through the geocentre."""
    station = itrf_from_geodetic(np.deg2rad(100.0), 0.0, 0.0)
    azimuth, elevation = np.deg2rad([0.0, 90.0, 225.0]), np.deg2rad([30.0, 20.0, 10.0])
    latitude, longitude = pierce_point(station, azimuth, elevation)
    arc = np.pi / 2 - elevation - np.arcsin(6378137.0 / 6821e3 * np.cos(elevation))
    np.testing.assert_allclose(latitude, np.arcsin(np.sin(arc) * np.cos(azimuth)), atol=1e-13)
    east = np.arctan2(np.sin(arc) * np.sin(azimuth), np.cos(arc))
    np.testing.assert_allclose(longitude, np.deg2rad(100.0) + east, atol=1e-13)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ionosphere_delay_m(-1.0, 8.4e9), "got -1"),
        (lambda: ionosphere_delay_m(10.0, 8400.0), "got 8400"),
        (lambda: pierce_point([6378e3, 0.0, 0.0], 0.0, 0.5, 450.0), "0.45 km"),
        (lambda: UniformTec(-1.0), "TECU"),
    ],
)
def test_impossible_values_are_an_error(call, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()


def test_delay_by_one_tecu_equals_that_of_a_constant_content():
    """Two frequencies, a phase, light, and a signal without a frequency."""
    legs = leg(
        [10.0, 45.0, 90.0, 30.0, 30.0],
        radio=np.array([True, True, True, False, True]),
        frequency_hz=np.array([7.2e9, X_DOWN_HZ, X_DOWN_HZ, 5.6e14, np.nan]),
        phase=np.array([False, False, True, False, False]),
    )
    delay_m = delay_by_content_m(legs)
    expected = Ionosphere(UniformTec(1.0)).delay(legs, None)
    np.testing.assert_allclose(delay_m[:4], expected.delay_m[:4], rtol=1e-14)
    assert (delay_m[2] < 0.0, delay_m[3]) == (True, 0.0)
    assert np.isnan(delay_m[4])
    assert expected.status.tolist() == [0, 0, 0, 0, Status.NO_FREQUENCY]
