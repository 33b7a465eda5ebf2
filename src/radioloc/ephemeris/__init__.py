"""Positions of the Earth, the Moon and the Sun, and orientation of the Moon; km and days occur only in this package.

SI units, ICRF axes and TDB; the DE421 files of the package, or any SPK and binary PCK made of a JPL ephemeris.
"""

from radioloc.ephemeris.constants import CONSTANTS, EphemerisConstants
from radioloc.ephemeris.orientation import LunarOrientation
from radioloc.ephemeris.positions import BODIES, EarthState, Ephemeris
from radioloc.ephemeris.trajectory import Trajectory

__all__ = [
    "BODIES",
    "CONSTANTS",
    "EarthState",
    "Ephemeris",
    "EphemerisConstants",
    "LunarOrientation",
    "Trajectory",
]
