"""Delay by the offset of an antenna's axes: the moving axis is nearer to the target than the reference point is.

A station's position is that of its fixed axis, at the point nearest to the moving one. The moving axis, which carries
the dish, stands off by a few millimetres to some metres; as the antenna points, it goes round the fixed axis on the
side of the target. At either end the path is longer by

    delay = -offset sqrt(1 - (s . i)^2),

with s the direction to the target as refraction shows it and i that of the fixed axis: vertical, parallel to the
Earth's axis, or horizontal. For an azimuth-elevation mount the root is the cosine of the elevation.

Source: Sovers, Fanselow and Jacobs (1998), Rev. Mod. Phys. 70, 1393, on the motion of antenna feeds; Nothnagel (2009),
J. Geod. 83, 787.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import EARTH_ROTATION_RAD_S
from radioloc.earth.stations import Station
from radioloc.measurements.station_motion import StationMotion
from radioloc.vectors import cross, dot, length

_REFRACTION_RAD = 3.13e-4
"""Refractivity of the air on the ground: refraction is this times the cotangent of the elevation."""
_LEVEL_SINE = 0.03
"""Near the horizon the cotangent levels off; with this, refraction there is 36 minutes of arc."""


@dataclass(frozen=True, slots=True)
class AxisOffset:
    """Delay at one end, one way, and its derivatives.

    Parameters
    ----------
    delay_m : ndarray, shape (n,)
        Not above zero for an offset above zero.
    rate_m_s : ndarray, shape (n,)
        With time.
    by_position : ndarray, shape (n, 3)
        With the point's position, celestial axes, m/m.
    """

    delay_m: NDArray[np.float64]
    rate_m_s: NDArray[np.float64]
    by_position: NDArray[np.float64]


def axis_offset_delay(
    stations: Sequence[Station],
    which: NDArray[np.int32],
    motion: StationMotion,
    point_gcrs_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
) -> AxisOffset:
    """Delay by the offset of the axes at one end; zero for stations of which it is not known.

    Parameters
    ----------
    stations : sequence of Station
    which : ndarray of int, shape (n,)
        Index of each row's station.
    motion : StationMotion
        The stations at their events.
    point_gcrs_m, velocity_m_s : ndarray, shape (n, 3)
        Geocentric position and velocity of the point at its event; the direction between the two events is the one
        seen from the station (aberration is contained).

    Notes
    -----
    Refraction raises the direction by 3.13e-4 cot e, which shortens the delay of an azimuth-elevation mount by 3e-4 of
    itself. Derivatives leave it out.
    """
    n = len(which)
    offset_m = np.array([station.axis_offset_m or 0.0 for station in stations])[which]
    if not offset_m.any():
        return AxisOffset(np.zeros(n), np.zeros(n), np.zeros((n, 3)))
    up, pole = motion.up_gcrs, motion.pole_gcrs
    fixed = _fixed_axes(np.array([station.mount for station in stations]), which, up, pole)
    away_m = point_gcrs_m - motion.gcrs_m
    distance_m = length(away_m)[:, None]
    unit = away_m / distance_m
    sine = dot(up, unit)
    lift = _REFRACTION_RAD / np.sqrt(sine**2 + _LEVEL_SINE**2)
    apparent = _normalized(unit + lift[:, None] * (up - sine[:, None] * unit))
    delay_m = -offset_m * length(cross(apparent, fixed))
    along = dot(unit, fixed)
    # Towards the end of the fixed axis the delay has a corner, and no derivative.
    slope = offset_m * along / np.maximum(length(cross(unit, fixed)), 1e-9)
    by_position = (fixed - unit * along[:, None]) * slope[:, None] / distance_m
    turning = EARTH_ROTATION_RAD_S * dot(cross(pole, fixed), unit) * slope
    return AxisOffset(
        delay_m, dot(by_position, velocity_m_s - motion.gcrs_velocity_m_s) + turning, by_position
    )


def _fixed_axes(
    mounts: NDArray[np.str_],
    which: NDArray[np.int32],
    up: NDArray[np.float64],
    pole: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Direction of the fixed axis of each row's station, shape (n, 3)."""
    if (mounts == "azimuth_elevation").all():
        return up
    east = _normalized(cross(pole, up))
    fixed = up
    for mount, axis in (("equatorial", pole), ("xy_north", cross(up, east)), ("xy_east", east)):
        fixed = np.where((mounts == mount)[which][:, None], axis, fixed)
    return fixed


def _normalized(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / length(vectors)[:, None])
