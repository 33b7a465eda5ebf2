"""Elevation of the Earth seen from the Moon."""

import numpy as np
import pytest

from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.lunar.frames import earth_elevation_rad
from radioloc.lunar.position import LunarPosition
from radioloc.time import Epochs, epochs_from_strings

EPHEMERIS, LIBRATION = Ephemeris.open(), LunarOrientation.open()
# A libration in longitude and latitude of 7.9 and 6.9 deg at the most.
LIBRATION_DEG = 10.5


def elevation_deg(longitude_deg, latitude_deg, tdb):
    position = LunarPosition.from_selenographic(longitude_deg, latitude_deg, 0.0).to_axes(
        "PA", EPHEMERIS.constants
    )
    return np.degrees(earth_elevation_rad(EPHEMERIS, LIBRATION, tdb, position.xyz_m))


def year():
    start = epochs_from_strings("2024-01-01", "TDB")
    return Epochs.from_jd(start.jd + np.arange(0.0, 365.0, 1.0), np.zeros(365), "TDB")


@pytest.mark.parametrize(("lon", "lat"), [(0, 0), (60, 0), (0, -75), (90, 0), (0, 90), (120, 0), (180, 0)])
def test_stands_within_the_libration_of_its_mean_place(lon, lat):
    # The Earth's mean direction is the x axis of the mean-Earth frame.
    mean_deg = np.degrees(np.arcsin(np.cos(np.radians(lon)) * np.cos(np.radians(lat))))
    seen_deg = elevation_deg(lon, lat, year())
    assert abs(seen_deg - mean_deg).max() < LIBRATION_DEG
    assert np.ptp(seen_deg) > 5.0
