"""Where a spacecraft on a known trajectory is near the instant at which a signal meets it, and what hides it.

The positions of an SPK are coordinates of the BCRS in the units of TDB already, so nothing shrinks: the terms of a
point on the Moon (``lunar_tide``, ``lunar_scale``, ``lunar_lorentz``) have no part in them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError
from radioloc.lunar.visibility import hidden_by_moon
from radioloc.measurements.light_path import MovingPoint
from radioloc.measurements.lunar_motion import LunarMotion
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.time import Epochs
from radioloc.vectors import rotated

_FARTHEST_M = 2e10
"""After the 67 s of light the Earth's motion is no longer a parabola to 0.06 mm."""
_DEEPEST_M = 2e4
"""Below any terrain: heights about the sphere reach down to -9.2 km."""


def trajectory_motion(
    model: PhysicalModel,
    trajectory: Trajectory,
    reference: Epochs,
    moon: LunarMotion,
) -> MovingPoint:
    """The spacecraft at the instants for which the Moon has been prepared, as a straight motion.

    Its error by the acceleration of a low lunar orbit, 1.6 m/s^2, is 0.8 micrometres after the 1e-3 s for which it may
    be used, and 1e-16 m after the nanoseconds for which it is.
    """
    offset_s = moon.centre.offset_s
    position_m, velocity_m_s = trajectory.geocentric(model.ephemeris, reference.shifted(offset_s))
    distance_m = float(np.linalg.norm(position_m, axis=-1).max(initial=0.0))
    if distance_m > _FARTHEST_M:
        raise InputError(
            f"{trajectory.name} is {distance_m / 1e9:.1f} million km from the Earth; the light path is made for "
            f"targets within {_FARTHEST_M / 1e9:.0f} million km"
        )
    earth_velocity_m_s = moon.centre.velocity_m_s - moon.geocentric_velocity_m_s
    return MovingPoint(offset_s, moon.geocentre_m + position_m, earth_velocity_m_s + velocity_m_s)


def displaced(motion: MovingPoint, moon: LunarMotion, offset_pa_m: NDArray[np.float64]) -> MovingPoint:
    """A motion beside another one, at a constant distance in the Moon's principal axes, shape (3,) or (n, 3), m."""
    return MovingPoint(
        motion.offset_s,
        motion.position_m
        + rotated(moon.rot_pa_to_icrf, np.broadcast_to(offset_pa_m, motion.position_m.shape)),
        motion.velocity_m_s
        + rotated(moon.rot_pa_to_icrf_rate, np.broadcast_to(offset_pa_m, motion.position_m.shape)),
    )


def behind_moon(
    point_gcrs_m: NDArray[np.float64], station_gcrs_m: NDArray[np.float64], moon_gcrs_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the Moon hides a spacecraft from a station; geocentric positions at the events, m.

    The Moon is the 1737.4 km sphere, or a smaller one through a spacecraft that is lower, as on a landing.
    """
    from_moon_m = point_gcrs_m - moon_gcrs_m
    # The sphere must not hold the spacecraft itself, by rounding.
    radius_m = np.minimum(MEAN_LUNAR_RADIUS_M, np.linalg.norm(from_moon_m, axis=-1) - 1e-3)
    radius_m = np.maximum(radius_m, MEAN_LUNAR_RADIUS_M - _DEEPEST_M)
    return hidden_by_moon(from_moon_m, station_gcrs_m - moon_gcrs_m, radius_m)
