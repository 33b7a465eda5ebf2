"""Directions of Earth and Sun from the Moon, and occultation by it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.lunar.frames import rot_icrf_to_me, rot_icrf_to_pa
from radioloc.time import Epochs, to_scale
from radioloc.units import as_float_array
from radioloc.vectors import Floats


def earth_elevation_rad(
    ephemeris: Ephemeris, libration: LunarOrientation, tdb: Epochs, point_pa_m: Floats
) -> Floats:
    """Elevation of the Earth's centre for a point on the Moon (principal axes, m), rad, (n,); good to 1 degree."""
    # Light time, aberration and the Earth's radius are left out.
    moon_m, _ = ephemeris.geocentric("moon", tdb)
    angles_rad, _ = libration.angles(tdb)
    to_earth_m = np.einsum("nij,nj->ni", rot_icrf_to_pa(angles_rad), -moon_m) - point_pa_m
    sine = vectors.normalized(to_earth_m) @ vectors.normalized(point_pa_m)
    return np.arcsin(np.clip(sine, -1.0, 1.0))


def sun_me_m(epochs: Epochs) -> Floats:
    """Geometric position of the Sun from the Moon's centre, ME_DE421, m, shape (n, 3)."""
    # Aberration moves it by 0.006 degrees, a fiftieth of its radius on the sky.
    tdb = to_scale(epochs, "TDB")
    ephemeris = Ephemeris.open("DE421")
    (sun_m, _), (moon_m, _) = (ephemeris.geocentric(body, tdb) for body in ("sun", "moon"))
    return vectors.rotated(rot_icrf_to_me(tdb), sun_m - moon_m)


def hidden_by_moon(
    point_m: ArrayLike, station_m: ArrayLike, radius_m: ArrayLike = MEAN_LUNAR_RADIUS_M
) -> NDArray[np.bool_]:
    """Determine whether the Moon, a sphere, is between a point and a station; from its centre, in the same axes, m."""
    point = as_float_array(point_m, "m", "point_m")
    ray = as_float_array(station_m, "m", "station_m") - point
    ray_part = -np.sum(point * ray, axis=-1) / np.sum(ray * ray, axis=-1)
    nearest_m = np.linalg.norm(point + np.clip(ray_part, 0.0, 1.0)[..., None] * ray, axis=-1)
    return np.asarray(nearest_m < as_float_array(radius_m, "m", "radius_m"))
