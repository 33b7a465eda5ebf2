"""The Moon's axes, positions in them, selenographic coordinates, solid tide and terrain.

Axes are principal (PA) or mean-Earth (ME) ones of an ephemeris, named as ``PA_DE421`` or ``ME_DE421``; lengths are
metres, angles radians unless a name says otherwise.
"""

from radioloc.lunar.frames import (
    angular_velocity_pa,
    rot_icrf_to_iau_moon,
    rot_icrf_to_pa,
    rot_icrf_to_pa_rate,
    rot_pa_to_me,
)
from radioloc.lunar.position import LunarPosition
from radioloc.lunar.selenographic import (
    cartesian_to_selenographic,
    east_north_up,
    selenographic_to_cartesian,
)
from radioloc.lunar.terrain import TerrainModel
from radioloc.lunar.tide import solid_tide
from radioloc.lunar.visibility import earth_elevation_rad, hidden_by_moon

__all__ = [
    "LunarPosition",
    "TerrainModel",
    "angular_velocity_pa",
    "cartesian_to_selenographic",
    "earth_elevation_rad",
    "east_north_up",
    "hidden_by_moon",
    "rot_icrf_to_iau_moon",
    "rot_icrf_to_pa",
    "rot_icrf_to_pa_rate",
    "rot_pa_to_me",
    "selenographic_to_cartesian",
    "solid_tide",
]
