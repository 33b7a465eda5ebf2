"""Solid Earth tide over a day; reference/test_iers_displacements.py has the values of DEHANTTIDEINEL at midnight."""

import numpy as np
import pytest

from radioloc.earth.geodesy import itrf_from_geodetic, rot_itrf_to_spherical_enu
from radioloc.earth.solid_tide import solid_earth_tide
from radioloc.errors import InputError
from radioloc.time import Epochs

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
