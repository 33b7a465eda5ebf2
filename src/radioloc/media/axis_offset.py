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

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from radioloc.constants import EARTH_ROTATION_RAD_S
from radioloc.media.medium import Leg, LegDelay, LegEnd
from radioloc.vectors import Floats, cross, dot, length, normalized

_REFRACTION_RAD = 3.13e-4
"""Refractivity of the air on the ground: refraction is this times the cotangent of the elevation."""
_LEVEL_SINE = 0.03
"""Near the horizon the cotangent levels off; with this, refraction there is 36 minutes of arc."""


@dataclass(frozen=True, slots=True)
class AntennaAxisOffset:
    """Path shortened by the known axis offset of an antenna; derivatives leave refraction out."""

    # Refraction, 3.13e-4 cot e, shortens the delay of an azimuth-elevation mount by 3e-4 of itself.

    name: ClassVar[str] = "antenna_axis_offset"
    description: ClassVar[str] = (
        "motion of an antenna's moving axis about its fixed one, where the offset is known"
    )
    limits_rad: ClassVar[tuple[float, ...]] = ()

    def prepare(self, end: LegEnd) -> None:
        """Prepare nothing."""

    def delay(self, leg: Leg, prepared: None) -> LegDelay | None:
        """Delay and its derivatives; zero for stations of which the offset is not known."""
        offsets_m = [station.axis_offset_m or 0.0 for station in leg.end.stations]
        if not any(offsets_m):
            return None
        offset_m = leg.end.of_station(offsets_m)
        up, pole, unit = leg.station.up_gcrs, leg.station.pole_gcrs, leg.unit
        fixed = _fixed_axes(leg)
        sine = dot(up, unit)
        lift = _REFRACTION_RAD / np.sqrt(sine**2 + _LEVEL_SINE**2)
        apparent = unit + lift[:, None] * (up - sine[:, None] * unit)
        along = dot(unit, fixed)
        # Towards the end of the fixed axis the delay has a corner, and no derivative.
        slope = offset_m * along / np.maximum(length(cross(unit, fixed)), 1e-9)
        by_position = (fixed - unit * along[:, None]) * slope[:, None] / leg.distance_m
        turning = EARTH_ROTATION_RAD_S * dot(cross(pole, fixed), unit) * slope
        return LegDelay(
            delay_m=-offset_m * length(cross(apparent, fixed)) / length(apparent),
            rate_m_s=dot(by_position, leg.velocity_m_s) + turning,
            by_position=by_position,
        )


def _fixed_axes(leg: Leg) -> Floats:
    """Direction of the fixed axis of each leg's station, shape (n, 3)."""
    up, pole = leg.station.up_gcrs, leg.station.pole_gcrs
    mounts = [station.mount for station in leg.end.stations]
    fixed = up
    for mount in {*mounts} - {"azimuth_elevation"}:
        axis = pole
        if mount != "equatorial":
            east = normalized(cross(pole, up))
            axis = cross(up, east) if mount == "xy_north" else east
        mine = leg.end.of_station([one == mount for one in mounts])
        fixed = np.where(mine[:, None], axis, fixed)
    return fixed
