r"""Adjustment of all images and the places of all tie points by weighted least squares.

The unknowns are, for each image i, its projection of places, :math:`G_i` (:mod:`radioloc.imaging.projections`: a
homography, or the pose of a camera over relief), and, for each tie point j, its place :math:`X_j` in the plane. The
observations are the pixel of a tie point in each image, :math:`x_{ij} = G_i X_j`, and the place of some of them on the
map, :math:`m_j = X_j`. A feature with several matches is one observation. The normal equations contain the chain of
images from high to low with all its loops. Places are eliminated (Triggs et al. 2000, section 6.1):

.. math:: S = U - W V^{-1} W^T, \qquad C = S^{-1}

C is the covariance of all images, with the errors of map features and of the chain, without the common error of the
map: its tie to the Moon's axes.

Residuals determine the noise of pixels and of places on the map separately (variance components of Helmert's kind,
Foerstner 1979). An observation is rejected if chi squared of its tie point is exceeded with a probability below 1 in
1000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging.projections import Projections
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

_MAX_STEPS = 40  # per round; wrong tie points over cells of an elevation model may prevent convergence
_MAX_HALVINGS = 7  # of a step
_CHI2_ROUNDING = 1e-6
_CHI2_TOLERANCE = 1e-4  # change by a step: every parameter moves by less than a hundredth of its sigma
_MAX_ROUNDS = 40
_OUTLIER_PROBABILITY = 1e-3
_FACTOR_TOLERANCE = 0.02  # relative change of a variance component
_MAX_CHANGED_PART = 1e-3  # of all observations, rejected in the last round
_MIN_REDUNDANCY = 30.0  # for separate sigmas, and for smaller ones
_MIN_FACTOR = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Pixels of tie points in images, and places of some on the map; points have the numbers 0 to n - 1."""

    image: Indices  # of each pixel, shape (n,)
    point: Indices  # shape (n,)
    pixels: Floats  # shape (n, 2)
    sigma_px: Floats  # shape (n,)
    map_point: Indices  # of each place, shape (m,)
    map_m: Floats  # in the plane, shape (m, 2)
    map_sigma_m: Floats  # shape (m,)

    @property
    def count(self) -> int:
        """Number of points."""
        return int(max(self.point.max(initial=-1), self.map_point.max(initial=-1))) + 1

    def select(self, points: NDArray[np.bool_]) -> TiePoints:
        """Return some of the points, renumbered."""
        number = np.cumsum(points) - 1
        in_image, on_map = points[self.point], points[self.map_point]
        return TiePoints(
            self.image[in_image],
            number[self.point[in_image]],
            self.pixels[in_image],
            self.sigma_px[in_image],
            number[self.map_point[on_map]],
            self.map_m[on_map],
            self.map_sigma_m[on_map],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Result of the adjustment."""

    model: Projections
    covariance: Floats  # of all corrections, shape (8 images, 8 images)
    places_m: Floats  # of the tie points, shape (points, 2)
    used: NDArray[np.bool_]  # pixels that were not rejected
    map_used: NDArray[np.bool_]  # places on the map that were not rejected
    residuals_px: Floats  # shape (n, 2)
    map_residuals_m: Floats  # shape (m, 2)
    sigma_factors: tuple[float, float]  # of the sigmas of pixels and of places on the map
    redundancy: int

    def place(self, image: int, pixel: Floats, pixel_sigma: float = 0.0) -> tuple[Floats, Floats]:
        """Return the place of a pixel, m, and its covariance, m^2, with the errors of the chain and of the pixel."""
        place, to_place, by_parameters = self.place_partials(image, pixel)
        block = self.block(image)
        covariance = by_parameters @ self.covariance[block, block] @ by_parameters.T
        return place, covariance + pixel_sigma**2 * to_place @ to_place.T

    def place_partials(self, image: int, pixel: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the place of a pixel, m, and its derivatives by the pixel and by corrections of the image."""
        place = self.model.place(image, pixel)
        projected = self.model.project(np.array([image]), np.array([0]), place[np.newaxis])
        to_place = np.linalg.inv(projected.by_place[0])
        return place, to_place, -to_place @ projected.by_parameters[0]

    def block(self, image: int) -> slice:
        """Return the slice of the parameters of an image."""
        return slice(8 * image, 8 * image + 8)


def adjust(ties: TiePoints, model: Projections, places: Floats) -> Adjusted:
    """Adjust all images and the places of all tie points, m, from approximate values."""
    pixels = len(ties.point)
    used = np.ones(pixels + len(ties.map_point), bool)
    observed = _Observations(ties, np.lexsort((ties.image, ties.point)), used, np.ones(2))
    separate = True
    for number in range(_MAX_ROUNDS):
        observed = replace(observed, used=observed.used & model.covers(places)[observed.points])
        try:
            model, places, normal, small = _solve(observed, model, places)
        except LinAlgError:
            raise InputError(
                "the tie points do not determine the images: some image has too few, or all on a line"
            ) from None
        residuals = observed.residuals(model, places)
        redundancies, redundancy = normal.redundancies(observed)
        # With low redundancy both components have one factor from then on.
        separate = separate and bool((redundancies > _MIN_REDUNDANCY).all())
        factors = observed.components(residuals, redundancies, separate)
        following = replace(observed, factors=factors).without_outliers(residuals)
        changed = (following.used != observed.used).sum()
        settled = small and changed <= _MAX_CHANGED_PART * observed.used.sum()
        if settled and number and np.abs(factors / observed.factors - 1.0).max() < _FACTOR_TOLERANCE:
            return Adjusted(
                model,
                normal.covariance(),
                places,
                observed.used[:pixels],
                observed.used[pixels:],
                residuals[:pixels],
                residuals[pixels:],
                (float(observed.factors[0]), float(observed.factors[1])),
                redundancy,
            )
        observed = following
    raise ConvergenceError(f"the adjustment of the images did not converge in {_MAX_ROUNDS} rounds")


@dataclass(frozen=True, slots=True, eq=False)
class _Observations:
    """Observations of tie points, first all pixels, then all places on the map."""

    ties: TiePoints
    order: Indices  # of the pixels by points, and of those of a point by images
    used: NDArray[np.bool_]
    factors: Floats  # of the sigmas of pixels and of the map

    @property
    def points(self) -> Indices:
        """Number of the point of each observation."""
        return np.concatenate([self.ties.point, self.ties.map_point])

    def residuals(self, model: Projections, places: Floats) -> Floats:
        """Return residuals in pixels and in metres, shape (n, 2)."""
        ties = self.ties
        pixels = model.pixels(ties.image, ties.point, places)
        return np.concatenate([ties.pixels - pixels, ties.map_m - places[ties.map_point]])

    def chi2(self, residuals: Floats, factors: Floats) -> Floats:
        """Return chi squared of each observation, with two degrees of freedom; 0 for rejected ones."""
        sigmas = np.concatenate([factors[0] * self.ties.sigma_px, factors[1] * self.ties.map_sigma_m])
        return np.where(self.used, (residuals**2).sum(axis=1) / sigmas**2, 0.0)

    def components(self, residuals: Floats, redundancies: Floats, separate: bool) -> Floats:
        """Return factors of the sigmas of pixels and of places on the map, from residuals and redundancies."""
        pixel_chi2, map_chi2 = np.split(self.chi2(residuals, np.ones(2)), [len(self.ties.point)])
        sums = np.array([pixel_chi2.sum(), map_chi2.sum()])
        if separate:
            return np.maximum(np.sqrt(sums / redundancies), _MIN_FACTOR)
        redundancy = float(redundancies.sum())
        factor = float(np.sqrt(sums.sum() / max(redundancy, 1.0)))
        return np.full(2, max(factor, _MIN_FACTOR if redundancy > _MIN_REDUNDANCY else 1.0))

    def without_outliers(self, residuals: Floats) -> _Observations:
        """Reject the worst observation of each inconsistent tie point, and points with a single observation."""
        from scipy.special import chdtri

        point, count = self.points, self.ties.count
        chi2 = self.chi2(residuals, self.factors)
        number = np.bincount(point[self.used], minlength=count)
        limit = chdtri(2 * np.maximum(number - 1, 1), _OUTLIER_PROBABILITY)
        inconsistent = np.bincount(point, weights=chi2, minlength=count) > limit
        worst = np.zeros(count)
        np.maximum.at(worst, point, chi2)
        used = self.used & ~(inconsistent[point] & (chi2 >= worst[point]))
        single = np.bincount(point[used], minlength=count) < 2
        return replace(self, used=used & ~single[point])


@dataclass(frozen=True, slots=True, eq=False)
class _NormalEquations:
    """Normal equations of the images after elimination of places."""

    factor: Floats  # of Cholesky, below the diagonal
    right: Floats
    parameters: int  # number of effective ones
    image: Indices  # of each used pixel
    point: Indices  # of each used pixel
    first: Indices  # first pixel of each point, then the number of pixels
    coupling: Floats  # W^T, shape (n, 2, 8)
    points_inverse: Floats  # V^-1, shape (points, 2, 2)
    points_right: Floats  # shape (points, 2)
    map_weight: Floats  # shape (points,)

    def step(self) -> Floats:
        """Return corrections of the images, shape (images, 8)."""
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve((self.factor, True), self.right)).reshape(-1, 8)

    def covariance(self) -> Floats:
        """Return the inverse of the normal equations."""
        from scipy.linalg.lapack import dpotri

        lower = np.tril(dpotri(self.factor, lower=True)[0])
        return np.asarray(lower + np.tril(lower, -1).T)

    def place_steps(self, step: Floats) -> Floats:
        """Return the steps of the places, shape (points, 2), for a step of the images, shape (images, 8)."""
        by_images = np.einsum("nip,np->in", self.coupling, step[self.image])
        right = self.points_right - _sums(self.point, by_images, len(self.points_right)).T
        return np.einsum("nij,nj->ni", self.points_inverse, right)

    def redundancies(self, observed: _Observations) -> tuple[Floats, int]:
        """Return the redundancies of all pixels and of all places on the map, and their sum."""
        observed_points = (self.map_weight > 0.0) | (np.diff(self.first) > 0)
        total = 2 * int(observed.used.sum() - observed_points.sum()) - self.parameters
        # Variances of each place, from the covariance V^-1 + V^-1 W^T C W V^-1, times its weight on the map.
        between = self.map_weight[:, np.newaxis, np.newaxis] * (self.points_inverse @ self.points_inverse)
        blocks = _coupled(self.first, self.image, self.coupling, between, len(self.right) // 8)
        covariance = self.covariance().reshape(len(blocks), 8, len(blocks), 8)
        explained = 2.0 * np.einsum("ijpq,ipjq", blocks, covariance)
        explained -= np.einsum("iipq,ipiq", blocks, covariance)
        explained += self.map_weight @ np.trace(self.points_inverse, axis1=1, axis2=2)
        map_redundancy = 2.0 * int(observed.used[len(observed.ties.point) :].sum()) - float(explained)
        return np.array([total - map_redundancy, map_redundancy]), total


def _solve(
    observed: _Observations, model: Projections, places: Floats
) -> tuple[Projections, Floats, _NormalEquations, bool]:
    """Return model and places after Gauss-Newton steps, the last normal equations, and convergence."""
    chi2 = observed.chi2(observed.residuals(model, places), observed.factors).sum()
    for _ in range(_MAX_STEPS):
        normal = _normal_equations(observed, model, places)
        image_steps = normal.step()
        place_steps = normal.place_steps(image_steps)
        # Steps are halved until chi squared does not grow: a full step from far away may lead beyond a horizon.
        for part in 0.5 ** np.arange(_MAX_HALVINGS + 1):
            following = model.corrected(part * image_steps), places + part * place_steps
            following_chi2 = observed.chi2(observed.residuals(*following), observed.factors).sum()
            if following_chi2 <= (1.0 + _CHI2_ROUNDING) * chi2:
                break
        (model, places), chi2 = following, following_chi2
        if small := bool(np.vdot(image_steps, normal.right) < _CHI2_TOLERANCE):
            break
    return model, places, normal, small


def absorbed(ties: TiePoints, result: Adjusted, pattern: Floats) -> tuple[Floats, Floats]:
    """Return the corrections of images, (images, 8), by a pattern of pixels, (n, 2), and its remaining part."""
    normal = _final_equations(ties, result, pattern)
    model, places = result.model, result.places_m
    steps = normal.step()
    projected = model.project(ties.image, ties.point, places)
    explained = np.einsum("nij,nj->ni", projected.by_parameters, steps[ties.image])
    explained += np.einsum("nij,nj->ni", projected.by_place, normal.place_steps(steps)[ties.point])
    return steps, np.where(result.used[:, np.newaxis], pattern - explained, 0.0)


def map_influence(ties: TiePoints, result: Adjusted, image: int, pixel: Floats) -> Floats:
    """Return the derivatives of the place of a pixel by each point's place on the map, shape (points, 2, 2)."""
    normal = _final_equations(ties, result)
    by_parameters = result.place_partials(image, pixel)[2]
    by_right = (by_parameters @ result.covariance[result.block(image)]).reshape(2, -1, 8)
    by_points = np.einsum("nip,anp->ain", normal.coupling, -by_right[:, normal.image])
    sums = _sums(normal.point, by_points, len(normal.map_weight))
    return np.einsum("ain,nij,n->naj", sums, normal.points_inverse, normal.map_weight)


def _final_equations(ties: TiePoints, result: Adjusted, pattern: Floats | None = None) -> _NormalEquations:
    used = np.concatenate([result.used, result.map_used])
    order = np.lexsort((ties.image, ties.point))
    observed = _Observations(ties, order, used, np.array(result.sigma_factors))
    return _normal_equations(observed, result.model, result.places_m, pattern)


def _normal_equations(
    observed: _Observations, model: Projections, places: Floats, pattern: Floats | None = None
) -> _NormalEquations:
    """Return the normal equations for the residuals, or for a pattern of pixels in their place."""
    from scipy.linalg import cho_factor

    ties, count = observed.ties, len(places)
    pixels = observed.order[observed.used[observed.order]]
    map_used = observed.used[len(ties.point) :]
    image, point = ties.image[pixels], ties.point[pixels]
    projected = model.project(image, point, places)
    # Rows are components of all observations: derivatives by images (2, 8, n) and places (2, 2, n).
    weight = (observed.factors[0] * ties.sigma_px[pixels]) ** -1.0
    by_image, by_place = (
        np.moveaxis(part, 0, -1) * weight for part in (projected.by_parameters, projected.by_place)
    )
    pixel_residual = ties.pixels[pixels] - projected.pixels if pattern is None else pattern[pixels]
    residual = pixel_residual.T * weight
    map_point = ties.map_point[map_used]
    map_weights = (observed.factors[1] * ties.map_sigma_m[map_used]) ** -2.0
    map_weight = _sums(map_point, map_weights, count)
    # Blocks of the points; those without used observations are held by unit weights.
    first = np.searchsorted(point, np.arange(count + 1))
    unobserved = (np.diff(first) == 0) & (map_weight == 0.0)
    point_blocks = _sums(point, _products(by_place, by_place), count)
    point_blocks[[0, 1], [0, 1]] += map_weight + unobserved
    inverse = np.asarray(np.linalg.inv(np.moveaxis(point_blocks, -1, 0)), dtype=np.float64)
    map_residual = (ties.map_m[map_used] - places[map_point]).T * (pattern is None)
    points_right = _sums(map_point, map_weights * map_residual, count).T
    points_right += _sums(point, _products(by_place, residual[:, np.newaxis])[:, 0], count).T
    coupling, designs = (
        np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in (_products(by_place, by_image), by_image)
    )
    blocks = _coupled(first, image, coupling, inverse, model.images)
    reduced = -blocks.transpose(0, 2, 1, 3).reshape(8 * model.images, -1)
    east, north = np.einsum("nij,nj->in", inverse, points_right)[:, point]
    residual -= by_place[:, 0] * east + by_place[:, 1] * north
    right = np.zeros((model.images, 8))
    order = np.argsort(image, kind="stable")
    for k, rows in enumerate(np.split(order, np.searchsorted(image[order], np.arange(1, model.images)))):
        block, design = slice(8 * k, 8 * k + 8), designs[rows].reshape(-1, 8)
        reduced[block, block] += design.T @ design
        right[k] = design.T @ residual.T[rows].ravel()
    fixed = model.fixed_corrections().ravel()
    reduced[fixed, fixed] = 1.0
    factor = cho_factor(reduced, lower=True)[0]
    point_parts = image, point, first, coupling, inverse, points_right, map_weight
    return _NormalEquations(factor, right.ravel(), int((~fixed).sum()), *point_parts)


def _coupled(first: Indices, image: Indices, coupling: Floats, between: Floats, images: int) -> Floats:
    """Return the sum over all points of W B W^T for pairs of images with the first not earlier than the second."""
    number = np.diff(first)
    weighted = np.repeat(between, number, axis=0) @ coupling
    # Pairs of observations of a point, by the difference of their numbers.
    to_end = np.repeat(first[1:], number) - np.arange(len(image))
    starts = [np.flatnonzero(to_end > lag) for lag in range(number.max(initial=0))]
    columns = np.concatenate(starts)
    rows = columns + np.repeat(np.arange(len(starts)), [len(start) for start in starts])
    # Two observations of a point in one image, in full and reduced, are a pair in both orders.
    double = np.flatnonzero((image[rows] == image[columns]) & (rows != columns))
    rows, columns = np.append(rows, columns[double]), np.append(columns, rows[double])
    key = image[rows] * images + image[columns]
    order = np.argsort(key, kind="stable")
    keys, bounds = np.unique(key[order], return_index=True)
    out = np.zeros((images, images, 8, 8))
    for k, pairs in zip(keys, np.split(order, bounds[1:]), strict=True):
        designs = weighted[rows[pairs]].reshape(-1, 8), coupling[columns[pairs]].reshape(-1, 8)
        out[divmod(k, images)] = designs[0].T @ designs[1]
    return out


def _products(a: Floats, b: Floats) -> Floats:
    """Return products A^T B of matrices (2, i, n) and (2, j, n), shape (i, j, n)."""
    return a[0, :, np.newaxis] * b[0] + a[1, :, np.newaxis] * b[1]


def _sums(number: Indices, values: Floats, count: int) -> Floats:
    """Return sums over the last axis by numbers, shape (..., count)."""
    rows = values.reshape(math.prod(values.shape[:-1]), -1)
    sums = [np.bincount(number, row, minlength=count) for row in rows]
    return np.array(sums, dtype=np.float64).reshape(*values.shape[:-1], count)


def approximate_places(ties: TiePoints, matrices: Floats) -> Floats:
    """Return places of the points: the map's, or the mean over their images by homographies, shape (images, 3, 3)."""
    x, y, scale = np.einsum(
        "nij,nj->in", np.linalg.inv(matrices)[ties.image], np.insert(ties.pixels, 2, 1.0, axis=1)
    )
    east, north, number = _sums(ties.point, np.array([x / scale, y / scale, np.ones_like(scale)]), ties.count)
    places = np.column_stack([east, north]) / np.maximum(number, 1.0)[:, np.newaxis]
    places[ties.map_point] = ties.map_m
    return places
