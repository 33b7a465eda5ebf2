"""Stations on the rotating Earth: ITRF positions, displacements, and the rotation from ITRF to GCRS.

Positions are metres in the ITRF unless a name says otherwise; epochs are :class:`radioloc.time.Epochs`.
"""

from radioloc.earth.eop import EopTable
from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.orientation import EarthOrientation
from radioloc.earth.stations import Station, StationCatalogue

__all__ = ["EarthOrientation", "EopTable", "Station", "StationCatalogue", "geodetic_from_itrf"]
