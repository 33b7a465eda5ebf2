r"""The projective transformation between two views of a plane: its eight parameters from tie points.

Wang et al. (2021), equation 7, and Zhang et al. (2014, Chang'e-3), equation 2:

.. math:: x = \frac{aX + bY + c}{gX + hY + 1}, \qquad y = \frac{dX + eY + f}{gX + hY + 1}

Both places of a tie point have errors. To first order the residual :math:`r = x - h(X)` has the covariance
:math:`\Sigma_x + J \Sigma_X J^T`, with J the derivative of the transformation at the point (Hartley and Zisserman 2004,
section 4.2.6, Sampson's error); least squares with the inverse of it as weights is repeated until nothing changes.

A correction of a transformation G is written :math:`N^{-1} (1 + \Delta) N G` with N bringing the points to which G
leads to the size of one, and :math:`\Delta_{33} = 0`. So no coordinate that is large and no :math:`G_{33}` that is
small harms, and the partial derivatives by the eight elements of Delta depend on nothing but those points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.vectors import Floats

_MIN_POINTS = 4
_OUTLIER = 13.8  # chi squared of two degrees of freedom exceeds this once in 1000
_ITERATIONS = 50
_CONVERGED = 1e-10  # change of normalized coordinates
_ON_A_LINE = "the tie points lie on a line or at one place; they determine no homography"
_MEDIAN_CHI2 = 2.0 * np.log(2.0)  # of two degrees of freedom


class Homography(NamedTuple):
    """Projective transformation of (X, Y, 1), scaled to a last element of 1, and the covariance of the other eight."""

    matrix: Floats
    covariance: Floats  # of a to h of equation 7, row by row


def fit_homography(
    start: Floats,
    end: Floats,
    start_sigma: ArrayLike,
    end_sigma: ArrayLike,
    approximate: Floats | None = None,
) -> Floats:
    """Return the matrix from tie points, (n, 2), whose places have errors on both sides; outliers are rejected."""
    start_variance = np.broadcast_to(np.square(start_sigma), len(start))
    end_variance = np.broadcast_to(np.square(end_sigma), len(end))
    if not (
        np.isfinite(start).all() and np.isfinite(end).all() and (start_variance + end_variance > 0.0).all()
    ):
        raise InputError("a tie point is not finite, or has no positive sigma")
    if any(np.linalg.matrix_rank(points - points.mean(axis=0)) < 2 for points in (start, end)):
        raise InputError(_ON_A_LINE)
    normal = normalization(end)
    matrix = _direct(start, end) if approximate is None else approximate
    used = np.ones(len(start), dtype=bool)
    for iteration in range(_ITERATIONS):
        residuals = end - transformed(matrix, start)
        weights = _weights(matrix, start, start_variance, end_variance)
        chi2 = np.einsum("ni,nij,nj->n", residuals, weights, residuals)
        scale = max(1.0, float(np.median(chi2[used])) / _MEDIAN_CHI2)
        before, used = used, chi2 < _OUTLIER * scale
        if used.sum() < _MIN_POINTS:
            raise InputError(
                f"{used.sum()} of {len(start)} tie points agree with each other; four are needed"
            )
        normalized = transformed(normal @ matrix, start[used])
        partials = by_correction(
            normalized, np.broadcast_to(np.eye(2) / normal[0, 0], (len(normalized), 2, 2))
        )
        information = np.einsum("nik,nij,njl->kl", partials, weights[used], partials)
        if np.linalg.cond(information) > 1e14:
            raise InputError(_ON_A_LINE)
        step = np.linalg.solve(
            information, np.einsum("nik,nij,nj->k", partials, weights[used], residuals[used])
        )
        matrix = corrected(matrix, normal, step)
        if np.abs(step).max() < _CONVERGED and (used == before).all() and iteration:
            break
    return _scaled(matrix)


def transformed(matrix: Floats, points: Floats) -> Floats:
    """Points, shape (n, 2), transformed by a matrix; NaN where they have no image."""
    homogeneous = points @ matrix[:, :2].T + matrix[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        result = homogeneous[:, :2] / homogeneous[:, 2:]
    result[~np.isfinite(result).all(axis=1)] = np.nan
    return result


def derivative(matrix: Floats, points: Floats) -> Floats:
    """Derivatives of transformed points by the points, shape (n, 2, 2)."""
    scale = points @ matrix[2, :2] + matrix[2, 2]
    image = transformed(matrix, points)
    return (matrix[:2, :2] - image[:, :, np.newaxis] * matrix[2, :2]) / scale[:, np.newaxis, np.newaxis]


def normalization(points: Floats) -> Floats:
    """The similarity that brings points to mean zero and size one, shape (3, 3)."""
    centre = points.mean(axis=0)
    size = float(np.sqrt(((points - centre) ** 2).mean())) or 1.0
    return np.array(
        [[1.0 / size, 0.0, -centre[0] / size], [0.0, 1.0 / size, -centre[1] / size], [0.0, 0.0, 1.0]]
    )


def by_correction(normalized: Floats, by_normalized: Floats) -> Floats:
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
    """A homography from its matrix and the covariance of the elements of its correction."""
    # elements of N^-1 Delta N G, row by row, by those of Delta
    change = np.kron(np.linalg.inv(normal), (normal @ matrix).T)[:, :8]
    return of_elements(matrix, change @ covariance @ change.T)


def of_elements(matrix: Floats, covariance: Floats) -> Homography:
    """A homography from a matrix of any scale and the covariance of its nine elements."""
    scaled = _scaled(matrix)
    change = (np.eye(9)[:8] - np.outer(scaled.ravel()[:8], np.eye(9)[8])) / matrix[2, 2]
    return Homography(scaled, change @ covariance @ change.T)


def _scaled(matrix: Floats) -> Floats:
    """Return the matrix with a last element of 1."""
    if abs(matrix[2, 2]) < 1e-12 * np.abs(matrix).max():
        raise InputError(
            "a homography moves the origin to infinity; count its coordinates from a point in view"
        )
    return np.asarray(matrix / matrix[2, 2])


def _homogeneous(points: Floats) -> Floats:
    return np.insert(points, 2, 1.0, axis=1)


def _by_elements(row: Floats, image: Floats) -> Floats:
    """Return partial derivatives, (n, 2, 9), by a matrix's elements, of points that it makes of rows."""
    zero = np.zeros_like(row)
    first = np.concatenate([row, zero, -image[:, :1] * row], axis=1)
    second = np.concatenate([zero, row, -image[:, 1:] * row], axis=1)
    return np.stack([first, second], axis=1)


def _weights(matrix: Floats, start: Floats, start_variance: Floats, end_variance: Floats) -> Floats:
    """Inverse covariances of residuals, shape (n, 2, 2)."""
    by_start = derivative(matrix, start)
    covariance = start_variance[:, np.newaxis, np.newaxis] * (by_start @ by_start.transpose(0, 2, 1))
    return np.asarray(np.linalg.inv(covariance + end_variance[:, np.newaxis, np.newaxis] * np.eye(2)))


def _direct(start: Floats, end: Floats) -> Floats:
    """The direct linear transformation with normalized coordinates (Hartley and Zisserman 2004, algorithm 4.2)."""
    of_start, of_end = normalization(start), normalization(end)
    equations = _by_elements(_homogeneous(transformed(of_start, start)), transformed(of_end, end))
    matrix = np.linalg.svd(equations.reshape(-1, 9))[2][-1].reshape(3, 3)
    return np.asarray(np.linalg.inv(of_end) @ matrix @ of_start)
