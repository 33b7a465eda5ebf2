r"""One adjustment of all images: their homographies and the places of all tie points, by weighted least squares.

Unknown are, for each image i, the homography :math:`G_i` from the ground plane to its pixels (equation 7 of Wang et
al. 2021) and, for each tie point j, its place :math:`X_j` in the plane. Observed are the tie point's pixel in each
image that has it, :math:`x_{ij} = G_i X_j`, and the place that the map gives to some, :math:`m_j = X_j`. A feature that
is measured once and matched to many is one observation, so that nothing is counted twice; the chain of images from high
to low, and all ways around it, are in the one set of normal equations. Places are eliminated from these (Triggs et al.
2000, section 6.1):

.. math:: S = U - W V^{-1} W^T, \qquad C = S^{-1}

C is the covariance of all homographies together, with the errors of the map's features and the chain. What all of the
map has in common, its tie to the Moon's axes, is not in it.

How large errors are is found from residuals, of pixels of images and of places on the map apart (variance components of
Helmert's kind, Foerstner 1979). An observation is left out with chi squared of its tie point beyond what chance makes
once in 1000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.stats import chi2 as chi_squared

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging.homography import by_correction, corrected, derivative, transformed

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_STEPS = 30
_CONVERGED = 1e-5  # of coordinates of size one; the step after it would be of the order of its square
_ROUNDS = 40
_RARE = 1e-3
_SETTLED = 0.02  # relative change of a variance component
_FEW_CHANGES = 1e-3  # of all observations, left out in one round more
_ENOUGH_REDUNDANCY = 30.0  # below that, sigmas are not told apart, nor made smaller
_LEAST_FACTOR = 0.05
_ROWS_AT_ONCE = 2000


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Pixels of tie points in images, and places of some on the map. Points are counted from 0 without gaps."""

    image: Indices  # of each pixel, shape (n,)
    point: Indices  # shape (n,)
    pixels: Floats  # shape (n, 2)
    sigma_px: Floats  # shape (n,)
    map_point: Indices  # of each place, shape (m,)
    map_m: Floats  # in the plane, shape (m, 2)
    map_sigma_m: Floats  # shape (m,)


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedHomographies:
    """What the adjustment found."""

    matrices: Floats  # from the plane to pixels, shape (images, 3, 3)
    covariance: Floats  # of all corrections, shape (8 images, 8 images)
    normals: Floats  # the corrections' normalizations, shape (images, 3, 3)
    points_m: Floats  # places of the tie points, shape (points, 2)
    used: NDArray[np.bool_]  # which pixels,
    map_used: NDArray[np.bool_]  # and which places on the map were used
    residuals_px: Floats  # shape (n, 2)
    map_residuals_m: Floats  # shape (m, 2)
    sigma_factors: tuple[float, float]  # of the sigmas of pixels and of places on the map
    redundancy: int

    def ground_point(self, image: int, pixel: Floats) -> tuple[Floats, Floats]:
        """The place of a pixel in the plane, m, and its covariance, m^2, with those of chain, matches and features."""
        matrix, normal = self.matrices[image], self.normals[image]
        ground = transformed(np.linalg.inv(matrix), pixel[np.newaxis])
        by_parameters = by_correction(transformed(normal, pixel[np.newaxis]))[0] / normal[0, 0]
        to_ground = np.linalg.solve(derivative(matrix, ground)[0], by_parameters)
        block = slice(8 * image, 8 * image + 8)
        return ground[0], to_ground @ self.covariance[block, block] @ to_ground.T


def adjust(ties: TiePoints, matrices: Floats, sizes: Floats) -> AdjustedHomographies:
    """Adjust the homographies of all images and the places of all tie points together.

    Parameters
    ----------
    ties : TiePoints
        The observations.
    matrices : numpy.ndarray, shape (images, 3, 3)
        Approximate homographies from the plane to pixels.
    sizes : numpy.ndarray, shape (images, 2)
        Samples and lines of the images.

    Returns
    -------
    AdjustedHomographies
        The images' homographies with their covariance.

    Raises
    ------
    InputError
        The tie points do not determine the homographies.
    ConvergenceError
        The iteration does not settle.
    """
    normals = np.array([_of_size(size) for size in sizes])
    matrices = np.array([m / np.linalg.norm(m) for m in matrices])
    used, map_used = np.ones(len(ties.point), bool), np.ones(len(ties.map_point), bool)
    points = _first_places(ties, matrices)
    factors, apart = np.ones(2), True
    for number in range(_ROUNDS):
        matrices, points, normal = _solve(ties, used, map_used, factors, matrices, normals, points)
        residuals, map_residuals = _residuals(ties, matrices, points)
        shares, redundancy = normal.redundancies(ties, used, map_used, factors)
        before = factors
        # Where few observations are left to tell the two apart, both have one factor, and keep it.
        apart = apart and bool((shares > _ENOUGH_REDUNDANCY).all())
        factors = _components(ties, used, map_used, residuals, map_residuals, shares, apart)
        next_used, next_map_used = _kept(ties, used, map_used, residuals, map_residuals, factors)
        changed = int((next_used != used).sum() + (next_map_used != map_used).sum())
        settled = changed <= _FEW_CHANGES * int(used.sum() + map_used.sum())
        if settled and number and np.abs(factors / before - 1.0).max() < _SETTLED:
            covariance = normal.inverse()
            return AdjustedHomographies(
                matrices,
                covariance,
                normals,
                points,
                used,
                map_used,
                residuals,
                map_residuals,
                (float(before[0]), float(before[1])),
                redundancy,
            )
        used, map_used = next_used, next_map_used
    raise ConvergenceError(
        f"the images' adjustment did not settle in {_ROUNDS} rounds of leaving out tie points"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _NormalEquations:
    """The normal equations of the images, places eliminated."""

    factor: tuple[Floats, bool]
    right: Floats
    coupling: sparse.csr_matrix  # W^T
    points_inverse: Floats  # V^-1, shape (points, 2, 2)
    points_right: Floats

    def inverse(self) -> Floats:
        return np.asarray(cho_solve(self.factor, np.eye(len(self.right))))

    def redundancies(
        self, ties: TiePoints, used: NDArray[np.bool_], map_used: NDArray[np.bool_], factors: Floats
    ) -> tuple[Floats, int]:
        """Redundancies of the pixels together and of the map's places together, and their sum."""
        seen = np.zeros(len(self.points_inverse), bool)
        seen[ties.point[used]] = seen[ties.map_point[map_used]] = True
        total = 2 * (int(used.sum()) + int(map_used.sum()) - int(seen.sum())) - len(self.right)
        which = ties.map_point[map_used]
        weight = (factors[1] * ties.map_sigma_m[map_used]) ** -2.0
        inverse = self.inverse()
        explained = 0.0
        for begin in range(0, len(which), _ROWS_AT_ONCE):
            j = which[begin : begin + _ROWS_AT_ONCE]
            rows = (2 * j[:, np.newaxis] + np.arange(2)).ravel()
            coupling = self.coupling[rows]
            part = np.asarray((coupling @ inverse).reshape(len(j), 2, -1))
            dense = np.asarray(coupling.todense()).reshape(len(j), 2, -1)
            vinv = self.points_inverse[j]
            covariance = vinv + vinv @ (part @ dense.transpose(0, 2, 1)) @ vinv
            explained += float(
                (weight[begin : begin + len(j)] * np.trace(covariance, axis1=1, axis2=2)).sum()
            )
        on_map = 2.0 * len(which) - explained
        return np.array([total - on_map, on_map]), total


def _solve(
    ties: TiePoints,
    used: NDArray[np.bool_],
    map_used: NDArray[np.bool_],
    factors: Floats,
    matrices: Floats,
    normals: Floats,
    points: Floats,
) -> tuple[Floats, Floats, _NormalEquations]:
    for _ in range(_STEPS):
        normal = _normal_equations(ties, used, map_used, factors, matrices, normals, points)
        step = cho_solve(normal.factor, normal.right)
        back = normal.points_right - (normal.coupling @ step).reshape(-1, 2)
        points = points + np.einsum("jkl,jl->jk", normal.points_inverse, back)
        matrices = np.array(
            [corrected(m, n, d) for m, n, d in zip(matrices, normals, step.reshape(-1, 8), strict=True)]
        )
        if np.abs(step).max() < _CONVERGED:
            return matrices, points, normal
    raise ConvergenceError(f"the images' adjustment did not converge in {_STEPS} steps")


def _normal_equations(
    ties: TiePoints,
    used: NDArray[np.bool_],
    map_used: NDArray[np.bool_],
    factors: Floats,
    matrices: Floats,
    normals: Floats,
    points: Floats,
) -> _NormalEquations:
    image, point = ties.image[used], ties.point[used]
    matrix, normal = matrices[image], normals[image]
    at = points[point]
    predicted = _each(matrix, at)
    weight = (factors[0] * ties.sigma_px[used]) ** -1.0
    by_image = by_correction(_each(normal, predicted)) * (weight / normal[:, 0, 0])[:, np.newaxis, np.newaxis]
    by_point = _each_derivative(matrix, at, predicted) * weight[:, np.newaxis, np.newaxis]
    residual = (ties.pixels[used] - predicted) * weight[:, np.newaxis]
    map_point = ties.map_point[map_used]
    map_weight = (factors[1] * ties.map_sigma_m[map_used]) ** -2.0
    count, images = len(points), len(matrices)
    information = np.zeros((count, 2, 2))
    np.add.at(information, point, by_point.transpose(0, 2, 1) @ by_point)
    np.add.at(information, map_point, map_weight[:, np.newaxis, np.newaxis] * np.eye(2))
    information[~information.any(axis=(1, 2))] = np.eye(
        2
    )  # points of which nothing is used stay where they are
    points_inverse = np.asarray(np.linalg.inv(information))
    points_right = np.zeros((count, 2))
    np.add.at(points_right, point, np.einsum("nki,nk->ni", by_point, residual))
    np.add.at(points_right, map_point, map_weight[:, np.newaxis] * (ties.map_m[map_used] - points[map_point]))
    blocks = by_image.transpose(0, 2, 1) @ by_image
    own = np.zeros((images, 8, 8))
    np.add.at(own, image, blocks)
    right = np.zeros((images, 8))
    np.add.at(right, image, np.einsum("nki,nk->ni", by_image, residual))
    crossed = by_point.transpose(0, 2, 1) @ by_image  # (n, 2, 8)
    rows = np.broadcast_to((2 * point[:, np.newaxis] + np.arange(2))[:, :, np.newaxis], crossed.shape)
    columns = np.broadcast_to((8 * image[:, np.newaxis] + np.arange(8))[:, np.newaxis], crossed.shape)
    entries = (crossed.ravel(), (rows.ravel(), columns.ravel()))
    coupling = sparse.csr_matrix(entries, shape=(2 * count, 8 * images))
    spread = sparse.bsr_matrix(
        (points_inverse, np.arange(count), np.arange(count + 1)), shape=(2 * count, 2 * count)
    ).tocsr()
    eliminated = spread @ coupling
    reduced = -np.asarray((coupling.T @ eliminated).todense())
    for k in range(images):
        reduced[8 * k : 8 * k + 8, 8 * k : 8 * k + 8] += own[k]
    try:
        factor = cho_factor(reduced)
    except LinAlgError:
        raise InputError(
            "the tie points do not determine the images' homographies; some image has too few, or lies on a line"
        ) from None
    reduced_right = right.ravel() - eliminated.T @ points_right.ravel()
    return _NormalEquations(factor, reduced_right, coupling, points_inverse, points_right)


def _residuals(ties: TiePoints, matrices: Floats, points: Floats) -> tuple[Floats, Floats]:
    predicted = _each(matrices[ties.image], points[ties.point])
    return ties.pixels - predicted, ties.map_m - points[ties.map_point]


def _components(
    ties: TiePoints,
    used: NDArray[np.bool_],
    map_used: NDArray[np.bool_],
    residuals: Floats,
    map_residuals: Floats,
    redundancies: Floats,
    apart: bool,
) -> Floats:
    """Factors of the sigmas of pixels and of places on the map, apart or one, from residuals and redundancies."""
    sums = np.array(
        [
            ((residuals[used] / ties.sigma_px[used, np.newaxis]) ** 2).sum(),
            ((map_residuals[map_used] / ties.map_sigma_m[map_used, np.newaxis]) ** 2).sum(),
        ]
    )
    if apart:
        return np.maximum(np.sqrt(sums / redundancies), _LEAST_FACTOR)
    redundancy = float(redundancies.sum())
    factor = float(np.sqrt(sums.sum() / max(redundancy, 1.0)))
    return np.full(2, max(factor, _LEAST_FACTOR if redundancy > _ENOUGH_REDUNDANCY else 1.0))


def _kept(
    ties: TiePoints,
    used: NDArray[np.bool_],
    map_used: NDArray[np.bool_],
    residuals: Floats,
    map_residuals: Floats,
    factors: Floats,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What is left after the worst observation of each tie point whose chi squared is beyond chance is left out."""
    count = int(max(ties.point.max(initial=-1), ties.map_point.max(initial=-1))) + 1
    point = np.concatenate([ties.point, ties.map_point])
    kept = np.concatenate([used, map_used])
    chi2 = np.concatenate(
        [
            ((residuals / (factors[0] * ties.sigma_px)[:, np.newaxis]) ** 2).sum(axis=1),
            ((map_residuals / (factors[1] * ties.map_sigma_m)[:, np.newaxis]) ** 2).sum(axis=1),
        ]
    )
    number = np.bincount(point[kept], minlength=count)
    total = np.bincount(point[kept], weights=chi2[kept], minlength=count)
    bad = total > chi_squared.isf(_RARE, 2 * np.maximum(number - 1, 1))
    worst = np.zeros(count)
    np.maximum.at(worst, point[kept], chi2[kept])
    kept = kept & ~(bad[point] & (chi2 >= worst[point]))
    alone = np.bincount(point[kept], minlength=count) < 2  # one observation of a point says nothing
    kept &= ~alone[point]
    return kept[: len(used)], kept[len(used) :]


def _first_places(ties: TiePoints, matrices: Floats) -> Floats:
    """Places of the points: the map's, or the means over their images."""
    count = int(max(ties.point.max(initial=-1), ties.map_point.max(initial=-1))) + 1
    ground = _each(np.asarray(np.linalg.inv(matrices))[ties.image], ties.pixels)
    number = np.bincount(ties.point, minlength=count)[:, np.newaxis]
    places = np.stack(
        [np.bincount(ties.point, weights=ground[:, k], minlength=count) for k in (0, 1)], axis=1
    ) / np.maximum(number, 1)
    places[ties.map_point] = ties.map_m
    return places


def _of_size(size: Floats) -> Floats:
    """The similarity that brings the pixels of an image to between -1 and 1."""
    half = 0.5 * float(np.max(size))
    return np.array([[1 / half, 0, -0.5 * size[0] / half], [0, 1 / half, -0.5 * size[1] / half], [0, 0, 1.0]])


def _each(matrices: Floats, points: Floats) -> Floats:
    """Points transformed each by its own matrix."""
    homogeneous = np.einsum("nij,nj->ni", matrices[:, :, :2], points) + matrices[:, :, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _each_derivative(matrices: Floats, points: Floats, images: Floats) -> Floats:
    scale = np.einsum("nj,nj->n", matrices[:, 2, :2], points) + matrices[:, 2, 2]
    by_points = matrices[:, :2, :2] - images[:, :, np.newaxis] * matrices[:, 2, np.newaxis, :2]
    return np.asarray(by_points / scale[:, np.newaxis, np.newaxis])
