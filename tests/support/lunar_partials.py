"""Partials of positions on the Moon by longitude, latitude and height."""

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.lunar import east_north_up


def cartesian_partials(longitude_rad, latitude_rad, height_m):
    """Return partial derivatives of x, y, z (rows) by longitude, latitude and height (columns), shape (..., 3, 3)."""
    radius_m = MEAN_LUNAR_RADIUS_M + np.asarray(height_m)
    scale = np.stack(
        np.broadcast_arrays(radius_m * np.cos(latitude_rad), radius_m, 1.0 + 0.0 * radius_m), axis=-1
    )
    return np.swapaxes(scale[..., np.newaxis] * east_north_up(longitude_rad, latitude_rad), -1, -2)
