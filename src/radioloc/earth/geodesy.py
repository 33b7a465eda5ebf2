"""Geodetic coordinates, and axes to the east, to the north and up at a place on the ground.

The ellipsoid is GRS80, as for the ITRF; WGS84 differs by 0.1 mm in height.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.units import as_metres
from radioloc.vectors import Floats, east_north_up

_GRS80 = 2  # ERFA's number of the ellipsoid
_LEAST_RADIUS_M = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Geodetic:
    """Geodetic coordinates on GRS80, of any shape; the longitude is counted east, in (-pi, pi]."""

    longitude_rad: Floats
    latitude_rad: Floats
    height_m: Floats


def geodetic_from_itrf(itrf_m: ArrayLike) -> Geodetic:
    """Turn geocentric positions in the ITRF, (..., 3), into geodetic coordinates: ERFA ``gc2gd`` (Fukushima 2006).

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.earth import StationCatalogue, geodetic_from_itrf
    >>> place = geodetic_from_itrf(StationCatalogue.default().get("WETTZELL").itrf_m)
    >>> np.degrees([place.longitude_rad, place.latitude_rad]).round(4).tolist(), round(float(place.height_m))
    ([12.878, 49.1444], 665)
    """
    positions = np.asarray(as_metres(itrf_m, "itrf_m"), dtype=np.float64)
    if positions.shape[-1:] != (3,) or not np.isfinite(positions).all():
        raise InputError(
            f"positions: expected finite numbers of shape (..., 3), got the shape {positions.shape}"
        )
    least_m = np.linalg.norm(positions, axis=-1).min(initial=np.inf)
    if least_m < _LEAST_RADIUS_M:
        raise InputError(f"a position is {least_m:.6g} m from the geocentre; give metres, geocentric")
    longitude, latitude, height = erfa.gc2gd(_GRS80, positions)
    return Geodetic(np.asarray(longitude), np.asarray(latitude), np.asarray(height))


def itrf_from_geodetic(longitude_rad: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike) -> Floats:
    """Position in the ITRF, m, (..., 3), of east longitude, latitude (rad) and height (m) on GRS80: ERFA ``gd2gc``."""
    return np.asarray(erfa.gd2gc(_GRS80, longitude_rad, latitude_rad, height_m))


def rot_itrf_to_enu(itrf_m: ArrayLike) -> Floats:
    """Rotations from the ITRF to east, north and up (the ellipsoid's normal) at places, shape (..., 3, 3)."""
    place = geodetic_from_itrf(itrf_m)
    return east_north_up(place.longitude_rad, place.latitude_rad)


def rot_itrf_to_spherical_enu(itrf_m: Floats) -> Floats:
    """Rotations from the ITRF to east, north and away from the geocentre, in which tides are developed, (..., 3, 3)."""
    x, y, z = np.moveaxis(itrf_m, -1, 0)
    return east_north_up(np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))
