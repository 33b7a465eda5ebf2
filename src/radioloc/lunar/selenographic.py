"""Selenographic longitude, latitude and height, and the cartesian coordinates they stand for.

Longitude counts east from the prime meridian, latitude is the angle to the equator, height is above the
sphere of 1737.4 km (IAU WGCCRE). They belong to axes: the same numbers in PA and ME axes are up to 875 m
apart, so name the axes in whatever holds them (``lander_me_m``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radioloc import vectors
from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.units import as_float_array
from radioloc.vectors import Floats


def selenographic_to_cartesian(
    longitude_rad: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike
) -> Floats:
    """Cartesian coordinates of points, m, shape (..., 3).

    Parameters
    ----------
    longitude_rad, latitude_rad, height_m : array_like, shape (...,)
        East longitude, latitude, rad; height above the sphere of 1737.4 km, m.

    Examples
    --------
    >>> from radioloc.lunar import selenographic_to_cartesian
    >>> selenographic_to_cartesian(0.0, 0.0, [0.0, 600.0]).tolist()
    [[1737400.0, 0.0, 0.0], [1738000.0, 0.0, 0.0]]
    """
    longitude, latitude, radius_m = checked(longitude_rad, latitude_rad, height_m)
    return radius_m[..., np.newaxis] * vectors.east_north_up(longitude, latitude)[..., 2, :]


def cartesian_to_selenographic(point_m: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """East longitude, from -pi to pi, and latitude, rad, and height, m, of points, shapes (...,).

    Parameters
    ----------
    point_m : array_like, shape (..., 3)
        Cartesian coordinates, m; not the Moon's centre. At a pole the longitude is zero.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.lunar import cartesian_to_selenographic
    >>> longitude_rad, latitude_rad, height_m = cartesian_to_selenographic([0.0, 1737400.0, 0.0])
    >>> float(np.degrees(longitude_rad)), float(latitude_rad), float(height_m)
    (90.0, 0.0, 0.0)
    """
    point = as_float_array(point_m, "m", "point_m")
    if point.ndim == 0 or point.shape[-1] != 3:
        raise InputError(f"x, y, z are needed along the last axis, but the shape is {point.shape}")
    x, y, z = np.moveaxis(point, -1, 0)
    equatorial_m = np.hypot(x, y)
    radius_m = np.hypot(equatorial_m, z)
    if not np.isfinite(radius_m).all():
        raise InputError("a coordinate is not a finite number")
    if (radius_m == 0.0).any():
        raise InputError("the Moon's centre has no longitude and latitude")
    return np.arctan2(y, x), np.arctan2(z, equatorial_m), radius_m - MEAN_LUNAR_RADIUS_M


def east_north_up(longitude_rad: ArrayLike, latitude_rad: ArrayLike) -> Floats:
    """East, north and up unit vectors at points, as rows, (..., 3, 3); at a pole the longitude chooses the meridian.

    The matrix times a vector gives its east, north and up components.

    Examples
    --------
    >>> from radioloc.lunar import east_north_up
    >>> east_north_up(0.0, 0.0)[2].tolist()  # up
    [1.0, 0.0, 0.0]
    """
    longitude, latitude, _ = checked(longitude_rad, latitude_rad, 0.0)
    return vectors.east_north_up(longitude, latitude)


def require_lunar_height(height_m: float) -> None:
    """Raise :class:`InputError` for a height above 1737.4 km that the ground of the Moon does not have."""
    low_m, high_m = LUNAR_HEIGHT_LIMITS_M
    if not low_m <= height_m <= high_m:
        raise InputError(
            f"height_m: expected a lunar height above the 1737.4 km sphere, {low_m / 1e3:g} to {high_m / 1e3:g} km, "
            f"got {height_m!r} m"
        )


def checked(
    longitude_rad: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Longitude and latitude, rad, and distance from the Moon's centre, m, of one shape and possible."""
    longitude, latitude, height = np.broadcast_arrays(
        as_float_array(longitude_rad, "rad", "longitude_rad"),
        as_float_array(latitude_rad, "rad", "latitude_rad"),
        as_float_array(height_m, "m", "height_m"),
    )
    for name, values in (("longitude", longitude), ("latitude", latitude), ("height", height)):
        if not np.isfinite(values).all():
            raise InputError(f"a {name} is not a finite number")
    if (np.abs(latitude) > np.pi / 2).any():
        worst = latitude.flat[int(np.argmax(np.abs(latitude)))]
        raise InputError(
            f"latitude {worst:.6g} rad is beyond a pole (-pi/2 to pi/2); is it in degrees instead of radians?"
        )
    radius_m = height + MEAN_LUNAR_RADIUS_M
    if (radius_m <= 0.0).any():
        raise InputError(
            f"height {height.min():.6g} m is below the Moon's centre; heights count from 1737.4 km up"
        )
    return longitude, latitude, radius_m
