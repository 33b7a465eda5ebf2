"""Elevation of a point above a station's horizon, and how it changes with time and with the point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.station_motion import StationMotion
from radioloc.vectors import cross, dot, length


@dataclass(frozen=True, slots=True)
class Elevation:
    """Elevation and its derivatives.

    Parameters
    ----------
    angle_rad : ndarray, shape (n,)
        Without refraction.
    rate_rad_s : ndarray, shape (n,)
        With time.
    by_position_rad_m : ndarray, shape (n, 3)
        With the point's position, celestial axes.
    """

    angle_rad: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]
    by_position_rad_m: NDArray[np.float64]


def elevation_of(
    station: StationMotion, point_gcrs_m: NDArray[np.float64], velocity_m_s: NDArray[np.float64]
) -> Elevation:
    """Elevation above the plane normal to the ellipsoid's vertical, without refraction.

    Parameters
    ----------
    station : StationMotion
        The station at its event.
    point_gcrs_m, velocity_m_s : ndarray, shape (n, 3)
        Geocentric position and velocity of the point at its event. Both are geocentric at their own instants, so the
        direction between them is the one seen in the frame that moves with the Earth (aberration is contained).
    """
    away_m = point_gcrs_m - station.gcrs_m
    distance_m = length(away_m)[:, None]
    unit = away_m / distance_m
    relative_m_s = velocity_m_s - station.gcrs_velocity_m_s
    sine = dot(station.up_gcrs, unit)
    # arctan2 keeps its digits near the zenith, where arcsin loses half of them.
    cosine = length(cross(station.up_gcrs, unit))
    slope = 1.0 / np.maximum(cosine, 1e-9)
    by_position = (station.up_gcrs - unit * sine[:, None]) * slope[:, None] / distance_m
    turning = dot(station.up_rate_gcrs, unit) * slope
    return Elevation(np.arctan2(sine, cosine), dot(by_position, relative_m_s) + turning, by_position)
