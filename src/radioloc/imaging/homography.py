r"""The projective transformation between two views of a plane.

Wang et al. (2021), equation 7, and Zhang et al. (2014, Chang'e-3), equation 2:

.. math:: x = \frac{aX + bY + c}{gX + hY + 1}, \qquad y = \frac{dX + eY + f}{gX + hY + 1}

A correction of a transformation G is written :math:`N^{-1} (1 + \Delta) N G`, where N normalizes the transformed points
to size one, and :math:`\Delta_{33} = 0`. Large coordinates and small :math:`G_{33}` then do no harm, and the partial
derivatives by the eight elements of Delta depend only on those points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from radioloc.errors import InputError
from radioloc.vectors import Floats


class Homography(NamedTuple):
    """Projective transformation of (X, Y, 1), scaled to a last element of 1, and the covariance of the other eight."""

    matrix: Floats
    covariance: Floats  # of a to h of equation 7, row by row


def transformed(matrix: Floats, points: Floats) -> Floats:
    """Return points, shape (n, 2), transformed by a matrix; NaN for points at infinity."""
    homogeneous = points @ matrix[:, :2].T + matrix[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        result = homogeneous[:, :2] / homogeneous[:, 2:]
    result[~np.isfinite(result).all(axis=1)] = np.nan
    return result


def derivative(matrix: Floats, points: Floats) -> Floats:
    """Return derivatives of transformed points with respect to the points, shape (n, 2, 2)."""
    scale = points @ matrix[2, :2] + matrix[2, 2]
    image = transformed(matrix, points)
    return (matrix[:2, :2] - image[:, :, np.newaxis] * matrix[2, :2]) / scale[:, np.newaxis, np.newaxis]


def correction_partials(normalized: Floats, by_normalized: Floats) -> Floats:
    """Return partial derivatives by the eight elements of a correction from those by normalized points, (n, 2, 2)."""
    point = normalized.T
    partials = np.empty((2, 8, len(normalized)))
    for row, (by_first, by_second) in zip(partials, np.moveaxis(by_normalized, 0, -1), strict=True):
        row[:2], row[2] = by_first * point, by_first
        row[3:5], row[5] = by_second * point, by_second
        row[6:] = -(by_first * point[0] + by_second * point[1]) * point
    return np.moveaxis(partials, -1, 0)


def corrected(matrix: Floats, normal: Floats, step: Floats) -> Floats:
    """Matrices, shape (..., 3, 3), after corrections of eight elements, shape (..., 8), of unit norm."""
    delta = np.insert(step, 8, 0.0, axis=-1).reshape(matrix.shape)
    result = np.linalg.solve(normal, (np.eye(3) + delta) @ normal @ matrix)
    return np.asarray(result / np.linalg.norm(result, axis=(-2, -1), keepdims=True))


def of_correction(matrix: Floats, normal: Floats, covariance: Floats) -> Homography:
    """Build a homography from its matrix and the covariance of the elements of its correction."""
    # Derivatives of the elements of N^-1 Delta N G, row by row, by those of Delta.
    change = np.kron(np.linalg.inv(normal), (normal @ matrix).T)[:, :8]
    return of_elements(matrix, change @ covariance @ change.T)


def of_elements(matrix: Floats, covariance: Floats) -> Homography:
    """Build a homography from a matrix of any scale and the covariance of its nine elements."""
    if abs(matrix[2, 2]) < 1e-12 * np.abs(matrix).max():
        raise InputError("a homography moves the origin of its coordinates to infinity")
    scaled = matrix / matrix[2, 2]
    change = (np.eye(9)[:8] - np.outer(scaled.ravel()[:8], np.eye(9)[8])) / matrix[2, 2]
    return Homography(scaled, change @ covariance @ change.T)
