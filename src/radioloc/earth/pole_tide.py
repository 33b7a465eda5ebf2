"""Displacement of a station by the pole tide: up to some 25 mm up and 7 mm sideways, over months and years.

As the spin axis wanders through the crust, the centrifugal potential at a station changes and the solid
Earth gives way. Only the wander about a pole that itself drifts slowly counts: the secular pole of the IERS
(2018), a straight line.

The load of the ocean's own pole tide is not modelled (IERS Conventions 2010, section 7.1.5, needs a global
grid of coefficients): it is up to about 2 mm up and 0.6 mm sideways.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.geodesy import rot_itrf_to_spherical_enu
from radioloc.time import Epochs

_RADIAL_M_RAD = 33e-3 / ARCSEC_RAD
_TRANSVERSE_M_RAD = 9e-3 / ARCSEC_RAD
"""Displacement per radian of wobble (eq. 7.26)."""


def secular_pole_rad(tt: Epochs) -> NDArray[np.float64]:
    """Coordinates x and y of the IERS secular pole (2018), rad, shape (n, 2).

    IERS Conventions (2010), section 7.1.4 as updated in February 2018: x = 55.0 + 1.677 t and y = 320.5 + 3.460 t
    milliarcseconds, t in years since 2000.
    """
    tt.require("TT")
    years = 100.0 * tt.centuries_since_j2000()
    return np.stack([55.0 + 1.677 * years, 320.5 + 3.460 * years], axis=-1) * (1e-3 * ARCSEC_RAD)


def pole_tide_displacement(
    station_itrf_m: NDArray[np.float64], xp_rad: NDArray[np.float64], yp_rad: NDArray[np.float64], tt: Epochs
) -> NDArray[np.float64]:
    """Displacement of stations, shape (n, 3), by the solid Earth pole tide, ITRF, m, shape (n, 3).

    IERS Conventions (2010), eq. 7.26 with m1 = xp - xs and m2 = -(yp - ys): towards the radius, the south and the east,
    -33 sin 2t (m1 cos L + m2 sin L), -9 cos 2t (m1 cos L + m2 sin L) and 9 cos t (m1 sin L - m2 cos L) mm for m1, m2 in
    arcseconds, at colatitude t and longitude L.
    """
    x_secular, y_secular = secular_pole_rad(tt).T
    m1, m2 = xp_rad - x_secular, y_secular - yp_rad
    axes = rot_itrf_to_spherical_enu(station_itrf_m)
    sin_lat, cos_lat = axes[:, 2, 2], axes[:, 1, 2]
    sin_lon, cos_lon = -axes[:, 0, 0], axes[:, 0, 1]
    along = m1 * cos_lon + m2 * sin_lon
    across = m1 * sin_lon - m2 * cos_lon
    up = -_RADIAL_M_RAD * 2.0 * sin_lat * cos_lat * along
    north = _TRANSVERSE_M_RAD * (sin_lat**2 - cos_lat**2) * along
    east = _TRANSVERSE_M_RAD * sin_lat * across
    return np.einsum("nij,ni->nj", axes, np.stack([east, north, up], axis=-1))
