"""Delay by the axis offset of an antenna.

A station's position is the point of its fixed axis nearest to the moving axis. The moving axis carries the dish at a
distance of some millimetres to some metres from the fixed axis, on the side of the target. At either end the path is
longer by

    delay = -offset sqrt(1 - (s . i)^2),

with s the apparent (refracted) direction to the target and i that of the fixed axis: vertical, parallel to the
Earth's axis, or horizontal. For an azimuth-elevation mount the root is the cosine of the elevation.

Source: Sovers, Fanselow and Jacobs (1998), Rev. Mod. Phys. 70, 1393, on the motion of antenna feeds; Nothnagel (2009),
J. Geod. 83, 787.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from radioloc.constants import EARTH_ROTATION_RAD_S
from radioloc.media.medium import Leg, LegDelay, LegEnd
from radioloc.vectors import Floats, cross, dot, length, normalized

_REFRACTION_RAD = 3.13e-4  # refractivity of the air on the ground; times the cotangent of the elevation
_HORIZON_SINE = 0.03  # limits the cotangent, so that refraction at the horizon is 36 minutes of arc


@dataclass(frozen=True, slots=True)
class AntennaAxisOffset:
    """Delay by the axis offsets of antennas; derivatives neglect refraction."""

    name: ClassVar[str] = "antenna_axis_offset"
    description: ClassVar[str] = (
        "offset of an antenna's moving axis from its fixed one, of stations that state it"
    )
    limits_rad: ClassVar[tuple[float, ...]] = ()

    def prepare(self, end: LegEnd) -> None:
        """Prepare nothing."""

    def delay(self, leg: Leg, prepared: None) -> LegDelay | None:
        """Return the delay and its derivatives; zero for stations that state no offset."""
        offsets_m = [station.axis_offset_m or 0.0 for station in leg.end.stations]
        if not any(offsets_m):
            return None
        offset_m = leg.end.per_leg(offsets_m)
        up, pole, unit = leg.station.up_gcrs, leg.station.pole_gcrs, leg.unit
        fixed = _fixed_axes(leg)
        sine = dot(up, unit)
        lift = _REFRACTION_RAD / np.sqrt(sine**2 + _HORIZON_SINE**2)
        apparent = unit + lift[:, None] * (up - sine[:, None] * unit)
        cosine = dot(unit, fixed)
        # The delay has a corner, so no derivative, at the end of the fixed axis.
        slope = offset_m * cosine / np.maximum(length(cross(unit, fixed)), 1e-9)
        by_position = (fixed - unit * cosine[:, None]) * slope[:, None] / leg.distance_m
        turning = EARTH_ROTATION_RAD_S * dot(cross(pole, fixed), unit) * slope
        return LegDelay(
            delay_m=-offset_m * length(cross(apparent, fixed)) / length(apparent),
            rate_m_s=dot(by_position, leg.velocity_m_s) + turning,
            by_position=by_position,
        )


def _fixed_axes(leg: Leg) -> Floats:
    """Return the direction of the fixed axis of each leg's station, shape (n, 3)."""
    up, pole = leg.station.up_gcrs, leg.station.pole_gcrs
    fixed = up
    for mount in {station.mount for station in leg.end.stations} - {"azimuth_elevation"}:
        axis = pole
        if mount != "equatorial":
            east = normalized(cross(pole, up))
            axis = cross(up, east) if mount == "xy_north" else east
        has_mount = leg.end.per_leg([station.mount == mount for station in leg.end.stations])
        fixed = np.where(has_mount[:, None], axis, fixed)
    return fixed
