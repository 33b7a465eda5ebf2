"""Elevation of a point above a station's horizon, and how fast it changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.station_motion import StationMotion


def elevation_and_rate(
    station: StationMotion, point_gcrs_m: NDArray[np.float64], velocity_m_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Elevation above the plane normal to the ellipsoid's vertical, without refraction.

    Parameters
    ----------
    station : StationMotion
        The station at its event.
    point_gcrs_m, velocity_m_s : ndarray, shape (n, 3)
        Geocentric position and velocity of the point at its event. Both are geocentric at their own instants, so the
        direction between them is the one seen in the frame that moves with the Earth (aberration is contained).

    Returns
    -------
    elevation_rad : ndarray, shape (n,)
    rate_rad_s : ndarray, shape (n,)
    """
    away_m = point_gcrs_m - station.gcrs_m
    distance_m = np.linalg.norm(away_m, axis=-1)[:, None]
    unit = away_m / distance_m
    relative_m_s = velocity_m_s - station.gcrs_velocity_m_s
    unit_rate = (relative_m_s - unit * np.einsum("ni,ni->n", unit, relative_m_s)[:, None]) / distance_m
    sine = np.einsum("ni,ni->n", station.up_gcrs, unit)
    sine_rate = np.einsum("ni,ni->n", station.up_gcrs, unit_rate) + np.einsum(
        "ni,ni->n", station.up_rate_gcrs, unit
    )
    # arctan2 keeps its digits near the zenith, where arcsin loses half of them.
    cosine = np.linalg.norm(np.cross(station.up_gcrs, unit), axis=-1)
    return np.arctan2(sine, cosine), sine_rate / np.maximum(cosine, 1e-9)
