"""Stations on the turning Earth: where they stand in the ITRF, what displaces them, how the ITRF lies in the GCRS.

Positions are metres in the ITRF unless a name says otherwise; epochs are :class:`radioloc.time.Epochs`.
"""

from radioloc.earth.blq import BlqCoefficients, read_blq
from radioloc.earth.eop import EopTable
from radioloc.earth.geodesy import (
    Geodetic,
    azimuth_elevation,
    geodetic_from_itrf,
    itrf_from_geodetic,
    rot_itrf_to_enu,
)
from radioloc.earth.ocean_loading import ocean_loading_displacement, tidal_geocentre_displacement
from radioloc.earth.orientation import EarthOrientation, EarthRotation, earth_rotation_angle
from radioloc.earth.pole_tide import pole_tide_displacement
from radioloc.earth.solid_tide import solid_earth_tide
from radioloc.earth.stations import Station, StationCatalogue

__all__ = [
    "BlqCoefficients",
    "EarthOrientation",
    "EarthRotation",
    "EopTable",
    "Geodetic",
    "Station",
    "StationCatalogue",
    "azimuth_elevation",
    "earth_rotation_angle",
    "geodetic_from_itrf",
    "itrf_from_geodetic",
    "ocean_loading_displacement",
    "pole_tide_displacement",
    "read_blq",
    "rot_itrf_to_enu",
    "solid_earth_tide",
    "tidal_geocentre_displacement",
]
