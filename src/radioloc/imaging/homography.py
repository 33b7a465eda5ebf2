r"""The projective transformation between two views of a plane: its eight parameters from tie points.

Wang et al. (2021), equation 7, and Zhang et al. (2014, Chang'e-3), equation 2:

.. math:: x = \frac{aX + bY + c}{gX + hY + 1}, \qquad y = \frac{dX + eY + f}{gX + hY + 1}

Both places of a tie point have errors. To first order the residual :math:`r = x - h(X)` has the covariance
:math:`\Sigma_x + J \Sigma_X J^T`, with J the derivative of the transformation at the point (Hartley and Zisserman 2004,
section 4.2.6, Sampson's error); weighted least squares with its inverse is iterated to convergence.

A correction of a transformation G is written :math:`N^{-1} (1 + \Delta) N G`, where N normalizes the transformed points
to size one, and :math:`\Delta_{33} = 0`. Large coordinates and small :math:`G_{33}` then do no harm, and the partial
derivatives by the eight elements of Delta depend only on those points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.vectors import Floats

_MIN_POINTS = 4
_MAX_CHI2 = 13.8  # of two degrees of freedom, exceeded with a probability of 1 in 1000
_MAX_ITERATIONS = 50
_STEP_TOLERANCE = 1e-10  # of normalized coordinates
_COLLINEAR = "the tie points lie on a line or at one place and do not determine a homography"
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
    """Fit the matrix to tie points, (n, 2), with errors on both sides; outliers are rejected."""
    start_variance = np.broadcast_to(np.square(start_sigma), len(start))
    end_variance = np.broadcast_to(np.square(end_sigma), len(end))
    if not (
        np.isfinite(start).all() and np.isfinite(end).all() and (start_variance + end_variance > 0.0).all()
    ):
        raise InputError("tie points: expected finite coordinates and positive sigmas")
    if any(np.linalg.matrix_rank(points - points.mean(axis=0)) < 2 for points in (start, end)):
        raise InputError(_COLLINEAR)
    normal = normalization(end)
    matrix = _direct(start, end) if approximate is None else approximate
    used = np.ones(len(start), dtype=bool)
    for iteration in range(_MAX_ITERATIONS):
        residuals = end - transformed(matrix, start)
        weights = _weights(matrix, start, start_variance, end_variance)
        chi2 = np.einsum("ni,nij,nj->n", residuals, weights, residuals)
        scale = max(1.0, float(np.median(chi2[used])) / _MEDIAN_CHI2)
        previous, used = used, chi2 < _MAX_CHI2 * scale
        if used.sum() < _MIN_POINTS:
            raise InputError(f"expected four consistent tie points or more, got {used.sum()} of {len(start)}")
        normalized = transformed(normal @ matrix, start[used])
        partials = correction_partials(
            normalized, np.broadcast_to(np.eye(2) / normal[0, 0], (len(normalized), 2, 2))
        )
        information = np.einsum("nik,nij,njl->kl", partials, weights[used], partials)
        if np.linalg.cond(information) > 1e14:
            raise InputError(_COLLINEAR)
        step = np.linalg.solve(
            information, np.einsum("nik,nij,nj->k", partials, weights[used], residuals[used])
        )
        matrix = corrected(matrix, normal, step)
        if np.abs(step).max() < _STEP_TOLERANCE and (used == previous).all() and iteration:
            break
    return _scaled(matrix)


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


def normalization(points: Floats) -> Floats:
    """Return the similarity that brings points to mean zero and size one, shape (3, 3)."""
    centre = points.mean(axis=0)
    size = float(np.sqrt(((points - centre) ** 2).mean())) or 1.0
    return np.array(
        [[1.0 / size, 0.0, -centre[0] / size], [0.0, 1.0 / size, -centre[1] / size], [0.0, 0.0, 1.0]]
    )


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
    scaled = _scaled(matrix)
    change = (np.eye(9)[:8] - np.outer(scaled.ravel()[:8], np.eye(9)[8])) / matrix[2, 2]
    return Homography(scaled, change @ covariance @ change.T)


def _scaled(matrix: Floats) -> Floats:
    """Return the matrix with a last element of 1."""
    if abs(matrix[2, 2]) < 1e-12 * np.abs(matrix).max():
        raise InputError("a homography moves the origin of its coordinates to infinity")
    return np.asarray(matrix / matrix[2, 2])


def _element_partials(row: Floats, image: Floats) -> Floats:
    """Return partial derivatives, (n, 2, 9), of transformed points by the elements of the matrix."""
    zero = np.zeros_like(row)
    first = np.concatenate([row, zero, -image[:, :1] * row], axis=1)
    second = np.concatenate([zero, row, -image[:, 1:] * row], axis=1)
    return np.stack([first, second], axis=1)


def _weights(matrix: Floats, start: Floats, start_variance: Floats, end_variance: Floats) -> Floats:
    """Return inverse covariances of residuals, shape (n, 2, 2)."""
    by_start = derivative(matrix, start)
    covariance = start_variance[:, np.newaxis, np.newaxis] * (by_start @ by_start.transpose(0, 2, 1))
    return np.asarray(np.linalg.inv(covariance + end_variance[:, np.newaxis, np.newaxis] * np.eye(2)))


def _direct(start: Floats, end: Floats) -> Floats:
    """Solve the direct linear transformation in normalized coordinates (Hartley and Zisserman 2004, algorithm 4.2)."""
    start_normal, end_normal = normalization(start), normalization(end)
    rows = np.insert(transformed(start_normal, start), 2, 1.0, axis=1)
    equations = _element_partials(rows, transformed(end_normal, end))
    matrix = np.linalg.svd(equations.reshape(-1, 9))[2][-1].reshape(3, 3)
    return np.asarray(np.linalg.inv(end_normal) @ matrix @ start_normal)
