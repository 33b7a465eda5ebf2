"""In which directions antennas point: the target as stations see it at the events of its light paths.

All directions are those of the light in the frame that moves with the station: annual and diurnal aberration are
contained, refraction is not. A station that sends points to where the target will be, and its light leaves with the
aberration of the other sign. The Sun's bending of so near a target's light is below 0.001 arcseconds and left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np

from radioloc.constants import C_M_S
from radioloc.measurements.station_motion import StationMotion
from radioloc.time import Epochs
from radioloc.vectors import Floats, cross, dot, normalized, rotated

_SUN_AU = 1.0  # of the distance to the Sun depends the aberration's relativistic part, below 1e-7 arcseconds


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """The target seen from n stations, one event each; angles in degrees, shape (n,)."""

    azimuth_deg: Floats  # from north through east, 0 to 360
    elevation_deg: Floats  # above the plane normal to the ellipsoid's vertical
    ra_deg: Floats  # apparent, of the true equator and equinox of date, 0 to 360
    dec_deg: Floats
    icrs_ra_deg: Floats  # astrometric: along the ICRF's axes without aberration
    icrs_dec_deg: Floats


def direction(unit_bcrs: Floats, station: StationMotion, tt: Epochs, *, sends: bool = False) -> Direction:
    """Compute directions from stations to the target, from unit vectors (BCRS) at the events."""
    beta = station.point.velocity_m_s / C_M_S * (-1.0 if sends else 1.0)
    seen = np.asarray(erfa.ab(unit_bcrs, beta, _SUN_AU, np.sqrt(1.0 - dot(beta, beta))))
    up = station.up_gcrs
    east = normalized(cross(station.pole_gcrs, up))
    horizontal = dot(east, seen), dot(cross(up, east), seen)
    ra_deg, dec_deg = _angles_deg(rotated(erfa.pnm06a(tt.jd, tt.fraction), seen))
    return Direction(
        np.degrees(np.arctan2(*horizontal)) % 360.0,
        np.degrees(np.arctan2(dot(up, seen), np.hypot(*horizontal))),
        ra_deg,
        dec_deg,
        *_angles_deg(unit_bcrs),
    )


def _angles_deg(unit: Floats) -> tuple[Floats, Floats]:
    longitude_rad, latitude_rad = erfa.c2s(unit)
    return np.degrees(longitude_rad) % 360.0, np.degrees(latitude_rad)
