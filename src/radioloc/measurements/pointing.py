"""Directions of antennas to the target at the events of its light paths.

Directions are those of the light in the frame of the station: they include annual and diurnal aberration, but not
refraction. A transmitting station points to the later position of the target, with the aberration of the opposite sign.
The bending of light by the Sun is below 0.001 arcseconds for such near targets and neglected.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np

from radioloc.constants import C_M_S
from radioloc.measurements.station_motion import StationMotion
from radioloc.time import Epochs
from radioloc.vectors import Floats, cross, dot, normalized, rotated

_SUN_DISTANCE_AU = 1.0  # for the relativistic part of aberration, below 1e-7 arcseconds


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """Directions of the target from stations at n events; angles in degrees, shape (n,)."""

    azimuth_deg: Floats  # from north through east, 0 to 360
    elevation_deg: Floats  # above the plane normal to the ellipsoid's vertical
    ra_deg: Floats  # apparent, of the true equator and equinox of date, 0 to 360
    dec_deg: Floats
    icrs_ra_deg: Floats  # astrometric: along the ICRF's axes without aberration
    icrs_dec_deg: Floats


def direction(unit_bcrs: Floats, station: StationMotion, tt: Epochs, *, sends: bool = False) -> Direction:
    """Return directions from stations to the target, from unit vectors (BCRS) at the events."""
    beta = station.point.velocity_m_s / C_M_S * (-1.0 if sends else 1.0)
    apparent = np.asarray(erfa.ab(unit_bcrs, beta, _SUN_DISTANCE_AU, np.sqrt(1.0 - dot(beta, beta))))
    up = station.up_gcrs
    east = normalized(cross(station.pole_gcrs, up))
    horizontal = dot(east, apparent), dot(cross(up, east), apparent)
    ra_deg, dec_deg = _angles_deg(rotated(erfa.pnm06a(tt.jd, tt.fraction), apparent))
    return Direction(
        np.degrees(np.arctan2(*horizontal)) % 360.0,
        np.degrees(np.arctan2(dot(up, apparent), np.hypot(*horizontal))),
        ra_deg,
        dec_deg,
        *_angles_deg(unit_bcrs),
    )


def _angles_deg(unit: Floats) -> tuple[Floats, Floats]:
    longitude_rad, latitude_rad = erfa.c2s(unit)
    return np.degrees(longitude_rad) % 360.0, np.degrees(latitude_rad)
