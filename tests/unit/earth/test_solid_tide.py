import numpy as np
import pytest

from radioloc.earth import solid_tide
from radioloc.earth.geodesy import itrf_from_geodetic, rot_itrf_to_spherical_enu
from radioloc.errors import InputError
from radioloc.time import Epochs

ROUNDING_M = 1e-15

MOON_M = 3.844e8
SUN_M = 1.496e11
MIDNIGHT = Epochs.from_jd(2459000.5, 0.0, "TT")


def solid_earth_tide(*of: object) -> np.ndarray:
    """That of stations, Moon and Sun of shape (3,) or (n, 3)."""
    return solid_tide.solid_earth_tide(*map(np.atleast_2d, of[:3]), *of[3:])


def along(direction: list[float], distance_m: float) -> np.ndarray:
    return np.array([direction]) / np.linalg.norm(direction) * distance_m


def test_moon_overhead_raises_and_on_the_horizon_lowers() -> None:
    """To a fifth: the equilibrium tide of 0.36 m of the Moon, times h2 of 0.61; half of it downwards."""
    equator_m = [6378137.0, 0.0, 0.0]
    sun = along([1.0, 1.0, np.sqrt(2.0 / 3.0)], SUN_M)  # zenith distance where the degree-2 tide vanishes
    overhead = solid_earth_tide(equator_m, along([1.0, 0.0, 0.0], MOON_M), sun, MIDNIGHT, 0.0)[0]
    horizon = solid_earth_tide(equator_m, along([0.0, 1.0, 0.0], MOON_M), sun, MIDNIGHT, 0.0)[0]
    assert overhead[0] == pytest.approx(0.61 * 0.36, rel=0.2)
    assert horizon[0] == pytest.approx(-0.61 * 0.18, rel=0.2)


def test_transverse_is_toward_the_moon() -> None:
    station_m = itrf_from_geodetic(0.0, 0.0, 0.0)
    sun = along([1.0, 1.0, np.sqrt(2.0 / 3.0)], SUN_M)
    east = [
        solid_earth_tide(station_m, along([1.0, y, 0.0], MOON_M), sun, MIDNIGHT, 0.0)[0, 1]
        for y in (1.0, -1.0)
    ]
    # 1.5 l2 times twice the equilibrium tide of 0.18 m.
    assert east[0] - east[1] == pytest.approx(2 * 3 * 0.0847 * 0.5 * 0.36, rel=0.05)


def test_one_station_and_many_are_alike() -> None:
    station_m = itrf_from_geodetic(1.0, 0.5, 100.0)
    tt = Epochs.from_jd(2459000.5 + np.arange(4.0), 0.3, "TT")
    angle = np.arange(4.0)[:, np.newaxis]
    moon = MOON_M * np.hstack([np.cos(angle), 0.8 * np.sin(angle), 0.6 * np.sin(angle)])
    sun = SUN_M * np.hstack([np.sin(angle), 0.9 * np.cos(angle), np.sqrt(0.19) * np.cos(angle)])
    one = solid_earth_tide(station_m, moon, sun, tt, np.full(4, 0.3))
    many = solid_earth_tide(np.tile(station_m, (4, 1)), moon, sun, tt, 0.3)
    assert one.shape == (4, 3)
    np.testing.assert_array_equal(one, many)
    for i in range(4):
        single = solid_earth_tide(station_m, moon[i], sun[i], tt[i], 0.3)
        np.testing.assert_allclose(single[0], one[i], rtol=0.0, atol=ROUNDING_M)


def test_no_step_at_midnight() -> None:
    """The UT1 day ends between two epochs one microsecond apart; a day's tide moves 6e-11 m in that time."""
    station_m = itrf_from_geodetic(1.0, 0.9, 0.0)
    tt = Epochs.from_jd(2459000.5, np.array([0.0008, 0.0008 + 1e-6 / 86400.0]), "TT")
    moon = np.tile(along([1.0, 0.3, 0.4], MOON_M), (2, 1))
    sun = np.tile(along([-0.3, 1.0, 0.4], SUN_M), (2, 1))
    before, after = solid_earth_tide(station_m, moon, sun, tt, np.array([1.0 - 1e-6 / 86400.0, 0.0]))
    np.testing.assert_allclose(before, after, rtol=0.0, atol=1e-10)


def test_correction_of_the_k1_tide_turns_with_the_sidereal_day() -> None:
    """Over a day of fixed Moon and Sun only step 2 moves: K1 with 12 mm at latitude 45 degrees leads."""
    station_m = itrf_from_geodetic(0.3, np.pi / 4, 0.0)
    fraction = np.arange(24) / 24.0
    tt = Epochs.from_jd(2459000.5, fraction, "TT")
    moon = np.tile(along([1.0, 0.3, 0.4], MOON_M), (24, 1))
    sun = np.tile(along([-0.3, 1.0, 0.4], SUN_M), (24, 1))
    up = solid_earth_tide(station_m, moon, sun, tt, fraction) @ rot_itrf_to_spherical_enu(station_m)[2]
    assert 9e-3 < (up.max() - up.min()) / 2 < 16e-3


def test_stations_at_the_poles_have_a_tide() -> None:
    moon, sun = along([1.0, 0.3, 0.4], MOON_M), along([-0.3, 1.0, 0.4], SUN_M)
    pole = solid_earth_tide([0.0, 0.0, 6356752.0], moon, sun, MIDNIGHT, 0.0)
    beside = solid_earth_tide([1e-3, 0.0, 6356752.0], moon, sun, MIDNIGHT, 0.0)
    np.testing.assert_allclose(pole, beside, rtol=0.0, atol=1e-9)


def test_wants_tt() -> None:
    utc = Epochs.from_jd(2459000.5, scale="UTC")
    with pytest.raises(InputError, match="TT"):
        solid_earth_tide([6378137.0, 0, 0], along([1, 0, 0], MOON_M), along([0, 1, 0], SUN_M), utc, 0.0)
