"""The Moon's axes, selenographic coordinates, solid tide and terrain."""

from radioloc.lunar.frames import (
    angular_velocity_pa,
    rot_icrf_to_iau_moon,
    rot_icrf_to_pa,
    rot_icrf_to_pa_rate,
    rot_pa_to_me,
)
from radioloc.lunar.selenographic import (
    cartesian_to_selenographic,
    east_north_up,
    selenographic_to_cartesian,
)
from radioloc.lunar.terrain import TerrainModel
from radioloc.lunar.tide import solid_tide
from radioloc.lunar.visibility import earth_elevation_rad, hidden_by_moon

__all__ = [
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
