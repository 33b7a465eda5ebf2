"""Products and lengths of many vectors, component by component; sums of many Chebyshev series.

NumPy is several times faster on arrays of shape (n, 3) that are stored by component, as it then works through columns.
Results are stored like their arguments.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Codes = NDArray[np.int32]  # indices of four bytes, of columns that are held for each observation
Mask = NDArray[np.bool_]


def dot(a: Floats, b: Floats) -> Floats:
    """Return scalar products of vectors, shapes (..., 3), row by row; shape (...)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def length(a: Floats) -> Floats:
    """Return lengths of vectors, shape (..., 3); shape (...)."""
    return np.asarray(np.sqrt(dot(a, a)))


def normalized(a: Floats) -> Floats:
    """Return unit vectors along vectors, shape (..., 3)."""
    return np.asarray(a / length(a)[..., np.newaxis])


def cross(a: Floats, b: Floats) -> Floats:
    """Return vector products, shapes (n, 3), row by row; shape (n, 3)."""
    out = np.empty((3, len(a)))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out.T


def cross_matrices(a: Floats) -> Floats:
    """Return matrices, shape (..., 3, 3), whose product with b is a x b for vectors a, shape (..., 3)."""
    x, y, z = np.moveaxis(a, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*a.shape, 3)


def rtn_axes(position_m: Floats, velocity_m_s: Floats) -> Floats:
    """Return radial, along and across axes of states as rows, shape (..., 3, 3)."""
    across = np.cross(position_m, velocity_m_s)
    return normalized(np.stack([position_m, np.cross(across, position_m), across], axis=-2))


def rotated(rotation: Floats, a: Floats) -> Floats:
    """Return products of matrices, shape (n, 3, 3), with vectors, shape (n, 3), row by row; shape (n, 3)."""
    out = np.empty((3, len(a)))
    for i in range(3):
        out[i] = dot(rotation[:, i], a)
    return out.T


def east_north_up(longitude_rad: Floats, latitude_rad: Floats) -> Floats:
    """Return east, north and up unit vectors as rows, (..., 3, 3), of a vertical with these angles."""
    sin_lon, cos_lon = np.sin(longitude_rad), np.cos(longitude_rad)
    sin_lat, cos_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(sin_lon)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-2)


def by_component(a: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return an array stored by component (column-major)."""
    return np.asfortranarray(a) if a.ndim > 1 else a


def chebyshev_sums(coefficients: Floats, s: Floats, derivatives: int = 1) -> tuple[Floats, ...]:
    """Return values and derivatives by s, (k, n), of Chebyshev series, (degrees, k, n), -1 <= s <= 1."""
    # Clenshaw's recurrence b_j = c_j + 2 s b_(j+1) - b_(j+2), differentiated.
    s2 = 2.0 * s
    b = b_next = db = db_next = ddb = ddb_next = np.zeros(coefficients.shape[1:])
    for k in range(len(coefficients) - 1, 0, -1):
        if derivatives > 1:
            ddb, ddb_next = 4.0 * db + s2 * ddb - ddb_next, ddb
        db, db_next = 2.0 * b + s2 * db - db_next, db
        # In this order the leading coefficient, 1e4 rad for the lunar angle psi, is rounded once.
        b, b_next = coefficients[k] + (s2 * b - b_next), b
    values = coefficients[0] + (s * b - b_next)
    rates = b + s * db - db_next
    if derivatives == 1:
        return values, rates
    return values, rates, 2.0 * db + s * ddb - ddb_next
