"""The Moon's axes, positions in them, selenographic coordinates, solid tide, terrain.

Axes are principal (PA) or mean-Earth (ME) ones of an ephemeris, named as ``PA_DE421`` or ``ME_DE421``; lengths are
metres, angles radians unless a name says otherwise.
"""

from radioloc.lunar.frames import rot_icrf_to_iau_moon, rot_icrf_to_pa, rot_pa_to_me
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.lunar.position import LunarPosition, rot_between
from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up, selenographic_to_cartesian
from radioloc.lunar.terrain import TerrainModel

__all__ = [
    "LunarPosition",
    "Map",
    "TangentPlane",
    "TerrainModel",
    "cartesian_to_selenographic",
    "east_north_up",
    "rot_between",
    "rot_icrf_to_iau_moon",
    "rot_icrf_to_pa",
    "rot_pa_to_me",
    "selenographic_to_cartesian",
]
