"""Geodetic coordinates, and directions as seen from a place on the ground.

The ellipsoid is GRS80, as for the ITRF; WGS84 differs by 0.1 mm in height.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.units import as_float_array, as_metres
from radioloc.vectors import east_north_up

_GRS80 = 2
"""ERFA's number of the ellipsoid."""

_LEAST_RADIUS_M = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Geodetic:
    """Geodetic coordinates on GRS80, of any shape; the longitude is counted east, in (-pi, pi]."""

    longitude_rad: NDArray[np.float64]
    latitude_rad: NDArray[np.float64]
    height_m: NDArray[np.float64]


def geodetic_from_itrf(itrf_m: ArrayLike) -> Geodetic:
    """Turn geocentric positions in the ITRF, (..., 3), into geodetic coordinates: ERFA ``gc2gd`` (Fukushima 2006)."""
    positions = np.asarray(as_metres(itrf_m, "itrf_m"), dtype=np.float64)
    if positions.shape[-1:] != (3,) or not np.isfinite(positions).all():
        raise InputError(f"positions must be finite, of shape (..., 3), but have shape {positions.shape}")
    least_m = np.linalg.norm(positions, axis=-1).min(initial=np.inf)
    if least_m < _LEAST_RADIUS_M:
        raise InputError(f"a position is {least_m:.6g} m from the geocentre; give metres, geocentric")
    longitude, latitude, height = erfa.gc2gd(_GRS80, positions)
    return Geodetic(np.asarray(longitude), np.asarray(latitude), np.asarray(height))


def itrf_from_geodetic(
    longitude_rad: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike
) -> NDArray[np.float64]:
    """Turn geodetic coordinates on GRS80 into a position in the ITRF, m, shape (..., 3): ERFA ``gd2gc``.

    Parameters
    ----------
    longitude_rad, latitude_rad : array_like, shape (...,)
        East longitude and geodetic latitude, rad.
    height_m : array_like, shape (...,)
        Height above the ellipsoid, m.

    Examples
    --------
    >>> from radioloc.earth import itrf_from_geodetic
    >>> itrf_from_geodetic(0.0, 0.0, 100.0).tolist()
    [6378237.0, 0.0, 0.0]
    """
    longitude, latitude, height = np.broadcast_arrays(
        as_float_array(longitude_rad, "rad", "longitude_rad"),
        as_float_array(latitude_rad, "rad", "latitude_rad"),
        as_float_array(height_m, "m", "height_m"),
    )
    if not all(np.isfinite(value).all() for value in (longitude, latitude, height)):
        raise InputError("a longitude, latitude or height is not a finite number")
    if (np.abs(latitude) > np.pi / 2).any():
        raise InputError(
            f"latitudes reach {np.abs(latitude).max():g} rad, which is beyond 90 degrees; give radians"
        )
    return np.asarray(erfa.gd2gc(_GRS80, longitude, latitude, height))


def itrf_positions(
    values: ArrayLike, count: int, what: str, distance_range_m: tuple[float, float] = (1e6, 1e7)
) -> NDArray[np.float64]:
    """Geocentric positions of shape (3,) or (count, 3) as (count, 3), each of them at a possible distance, m."""
    given = as_float_array(values, "m", f"positions of the {what}")
    if given.shape not in ((3,), (count, 3)):
        raise InputError(
            f"positions of the {what} have shape {given.shape}; with {count} epochs give (3,) or ({count}, 3)"
        )
    distance = np.linalg.norm(given, axis=-1)
    least, most = distance_range_m
    if not ((distance > least) & (distance < most)).all():
        raise InputError(
            f"the {what} is {distance.min():.6g} to {distance.max():.6g} m from the geocentre; "
            f"{least:.3g} to {most:.3g} m is possible: give metres, geocentric"
        )
    return np.broadcast_to(given, (count, 3))


def ut1_day_fractions(values: ArrayLike, count: int) -> NDArray[np.float64]:
    """UT1 as a fraction of its day, one for each epoch, shape (count,)."""
    fraction = np.asarray(values, dtype=np.float64)
    if fraction.shape not in ((), (count,)) or not np.isfinite(fraction).all():
        raise InputError(f"give the fraction of the UT1 day for {count} epochs, finite")
    return np.broadcast_to(fraction, count)


def rot_itrf_to_enu(itrf_m: ArrayLike) -> NDArray[np.float64]:
    """Rotations from the ITRF to east, north and up (the ellipsoid's normal) at places, shape (..., 3, 3).

    ``enu = rot @ itrf``; the rows are the unit vectors to the east, to the north and up.
    """
    place = geodetic_from_itrf(itrf_m)
    return east_north_up(place.longitude_rad, place.latitude_rad)


def rot_itrf_to_spherical_enu(itrf_m: ArrayLike) -> NDArray[np.float64]:
    """Rotations from the ITRF to east, north and away from the geocentre; as :func:`rot_itrf_to_enu`.

    Tides are developed in these. Away from the geocentre is up to 0.19 degrees from the ellipsoid's normal.
    """
    x, y, z = np.moveaxis(as_float_array(itrf_m, "m", "itrf_m"), -1, 0)
    return east_north_up(np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))


def azimuth_elevation(
    direction_itrf: ArrayLike, station_itrf_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth, from north through east in [0, 2 pi), and elevation of directions, without refraction, rad.

    Directions, of any length, and the station are ITRF. The elevation is above the plane normal to the ellipsoid's
    normal.
    """
    direction = np.asarray(direction_itrf, dtype=np.float64)
    length = np.linalg.norm(direction, axis=-1)
    if not (np.isfinite(length).all() and (length > 0.0).all()):
        raise InputError("a direction has no length or is not finite")
    east, north, up = np.moveaxis(
        np.einsum("...ij,...j->...i", rot_itrf_to_enu(station_itrf_m), direction), -1, 0
    )
    azimuth = np.arctan2(east, north) % (2.0 * np.pi)
    # The remainder of a tiny negative angle rounds up to a whole turn.
    azimuth = np.where(azimuth < 2.0 * np.pi, azimuth, 0.0)
    return azimuth, np.arctan2(up, np.hypot(east, north))
