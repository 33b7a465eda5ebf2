r"""One adjustment of all images and the places of all tie points, by weighted least squares.

Unknown are, for each image i, how it shows places, :math:`G_i` (:mod:`radioloc.imaging.projections`: a homography, or
the pose of a camera over relief), and, for each tie point j, its place :math:`X_j` in the plane. Observed are the tie
point's pixel in each image that has it, :math:`x_{ij} = G_i X_j`, and the place that the map gives to some,
:math:`m_j = X_j`. A feature that is measured once and matched to many is one observation, so that nothing is counted
twice; the chain of images from high to low, and all ways around it, are in the one set of normal equations. Places are
eliminated from these (Triggs et al. 2000, section 6.1):

.. math:: S = U - W V^{-1} W^T, \qquad C = S^{-1}

C is the covariance of all images together, with the errors of the map's features and the chain. What all of the
map has in common, its tie to the Moon's axes, is not in it.

How large errors are is found from residuals, of pixels of images and of places on the map apart (variance components of
Helmert's kind, Foerstner 1979). An observation is left out with chi squared of its tie point beyond what chance makes
once in 1000.
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

_STEPS = 40  # in a round; wrong tie points over cells of an elevation model may keep it from settling
_HALVINGS = 7  # of a step
_ROUNDING = 1e-6  # of chi squared
_CONVERGED = 1e-4  # change of chi squared by a step: no parameter moves by more than a hundredth of its sigma
_ROUNDS = 40
_RARE = 1e-3
_SETTLED = 0.02  # relative change of a variance component
_FEW_CHANGES = 1e-3  # of all observations, left out in one round more
_ENOUGH_REDUNDANCY = 30.0  # below that, sigmas are not told apart, nor made smaller
_LEAST_FACTOR = 0.05


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

    @property
    def count(self) -> int:
        """How many points."""
        return int(max(self.point.max(initial=-1), self.map_point.max(initial=-1))) + 1

    def only(self, points: NDArray[np.bool_]) -> TiePoints:
        """Some of the points, counted anew."""
        number = np.cumsum(points) - 1
        here, on_map = points[self.point], points[self.map_point]
        return TiePoints(
            self.image[here],
            number[self.point[here]],
            self.pixels[here],
            self.sigma_px[here],
            number[self.map_point[on_map]],
            self.map_m[on_map],
            self.map_sigma_m[on_map],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """What the adjustment found."""

    model: Projections
    covariance: Floats  # of all corrections, shape (8 images, 8 images)
    places_m: Floats  # of the tie points, shape (points, 2)
    used: NDArray[np.bool_]  # which pixels,
    map_used: NDArray[np.bool_]  # and which places on the map were used
    residuals_px: Floats  # shape (n, 2)
    map_residuals_m: Floats  # shape (m, 2)
    sigma_factors: tuple[float, float]  # of the sigmas of pixels and of places on the map
    redundancy: int

    def place(self, image: int, pixel: Floats, pixel_sigma: float = 0.0) -> tuple[Floats, Floats]:
        """The place of a pixel, m, and its covariance, m^2, with those of chain, matches, features and the pixel."""
        place = self.model.place(image, pixel)
        at = self.model.project(np.array([image]), np.array([0]), place[np.newaxis])
        to_place = np.linalg.inv(at.by_place[0])
        by_parameters = to_place @ at.by_parameters[0]
        block = self.block(image)
        covariance = by_parameters @ self.covariance[block, block] @ by_parameters.T
        return place, covariance + pixel_sigma**2 * to_place @ to_place.T

    def block(self, image: int) -> slice:
        """Where the parameters of an image are among all."""
        return slice(8 * image, 8 * image + 8)


def adjust(ties: TiePoints, model: Projections, places: Floats) -> Adjusted:
    """Adjust all images and the places of all tie points, m, together, from approximate ones."""
    pixels = len(ties.point)
    used = np.ones(pixels + len(ties.map_point), bool)
    observed = _Observed(ties, np.lexsort((ties.image, ties.point)), used, np.ones(2))
    apart = True
    for number in range(_ROUNDS):
        observed = replace(observed, used=observed.used & model.known(places)[observed.points])
        try:
            model, places, normal, small = _solve(observed, model, places)
        except LinAlgError:
            raise InputError(
                "the tie points do not determine the images; some image has too few, or all on a line"
            ) from None
        residuals = observed.residuals(model, places)
        shares, redundancy = normal.redundancies(observed)
        # Where few observations are left to tell the two apart, both have one factor, and keep it.
        apart = apart and bool((shares > _ENOUGH_REDUNDANCY).all())
        factors = observed.components(residuals, shares, apart)
        following = replace(observed, factors=factors).kept(residuals)
        changed = (following.used != observed.used).sum()
        settled = small and changed <= _FEW_CHANGES * observed.used.sum()
        if settled and number and np.abs(factors / observed.factors - 1.0).max() < _SETTLED:
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
    raise ConvergenceError(
        f"the images' adjustment did not settle in {_ROUNDS} rounds of leaving out tie points"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Observed:
    """Observations of tie points, first all pixels, then all places on the map."""

    ties: TiePoints
    order: Indices  # of the pixels by points, and of those of a point by images
    used: NDArray[np.bool_]
    factors: Floats  # of the sigmas of pixels and of the map

    @property
    def points(self) -> Indices:
        """Which point each is of."""
        return np.concatenate([self.ties.point, self.ties.map_point])

    def residuals(self, model: Projections, places: Floats) -> Floats:
        """In pixels and in metres, shape (n, 2)."""
        ties = self.ties
        pixels = model.pixels(ties.image, ties.point, places)
        return np.concatenate([ties.pixels - pixels, ties.map_m - places[ties.map_point]])

    def chi2(self, residuals: Floats, factors: Floats) -> Floats:
        """Of each observation, two degrees of freedom; of those that are not used nothing."""
        sigmas = np.concatenate([factors[0] * self.ties.sigma_px, factors[1] * self.ties.map_sigma_m])
        return np.where(self.used, (residuals**2).sum(axis=1) / sigmas**2, 0.0)

    def components(self, residuals: Floats, redundancies: Floats, apart: bool) -> Floats:
        """Factors of the sigmas of pixels and of places on the map, apart or one, from residuals and redundancies."""
        of_pixels, of_map = np.split(self.chi2(residuals, np.ones(2)), [len(self.ties.point)])
        sums = np.array([of_pixels.sum(), of_map.sum()])
        if apart:
            return np.maximum(np.sqrt(sums / redundancies), _LEAST_FACTOR)
        redundancy = float(redundancies.sum())
        factor = float(np.sqrt(sums.sum() / max(redundancy, 1.0)))
        return np.full(2, max(factor, _LEAST_FACTOR if redundancy > _ENOUGH_REDUNDANCY else 1.0))

    def kept(self, residuals: Floats) -> _Observed:
        """Without the worst observation of each tie point whose chi squared is beyond chance."""
        from scipy.special import chdtri

        point, count = self.points, self.ties.count
        chi2 = self.chi2(residuals, self.factors)
        number = np.bincount(point[self.used], minlength=count)
        bad = np.bincount(point, weights=chi2, minlength=count) > chdtri(2 * np.maximum(number - 1, 1), _RARE)
        worst = np.zeros(count)
        np.maximum.at(worst, point, chi2)
        used = self.used & ~(bad[point] & (chi2 >= worst[point]))
        alone = np.bincount(point[used], minlength=count) < 2  # one observation of a point says nothing
        return replace(self, used=used & ~alone[point])


@dataclass(frozen=True, slots=True, eq=False)
class _NormalEquations:
    """The normal equations of the images, places eliminated."""

    factor: Floats  # of Cholesky, below the diagonal
    right: Floats
    parameters: int  # that have an effect
    image: Indices  # of each pixel that is used, and the point:
    point: Indices
    first: Indices  # where each point's pixels begin, and how many there are
    coupling: Floats  # W^T, shape (n, 2, 8)
    points_inverse: Floats  # V^-1, shape (points, 2, 2)
    points_right: Floats  # shape (points, 2)
    map_weight: Floats  # shape (points,)

    def step(self) -> Floats:
        """Corrections of the images, shape (images, 8)."""
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve((self.factor, True), self.right)).reshape(-1, 8)

    def covariance(self) -> Floats:
        """The inverse."""
        from scipy.linalg.lapack import dpotri

        lower = np.tril(dpotri(self.factor, lower=True)[0])
        return np.asarray(lower + np.tril(lower, -1).T)

    def places_moved(self, step: Floats) -> Floats:
        """What a step of the images, shape (images, 8), does to the places, shape (points, 2)."""
        by_images = np.einsum("nip,np->in", self.coupling, step[self.image])
        left = self.points_right - _sums(self.point, by_images, len(self.points_right)).T
        return np.einsum("nij,nj->ni", self.points_inverse, left)

    def redundancies(self, observed: _Observed) -> tuple[Floats, int]:
        """Redundancies of the pixels together and of the map's places together, and their sum."""
        on_map = self.map_weight > 0.0
        seen = on_map | (np.diff(self.first) > 0)
        total = 2 * int(observed.used.sum() - seen.sum()) - self.parameters
        # Of each place the variances, of the covariance V^-1 + V^-1 W^T C W V^-1, times what they weigh on the map.
        between = self.map_weight[:, np.newaxis, np.newaxis] * (self.points_inverse @ self.points_inverse)
        blocks = _coupled(self.first, self.image, self.coupling, between, len(self.right) // 8)
        covariance = self.covariance().reshape(len(blocks), 8, len(blocks), 8)
        explained = 2.0 * np.einsum("ijpq,ipjq", blocks, covariance)
        explained -= np.einsum("iipq,ipiq", blocks, covariance)
        explained += self.map_weight @ np.trace(self.points_inverse, axis1=1, axis2=2)
        of_map = 2.0 * int(observed.used[len(observed.ties.point) :].sum()) - float(explained)
        return np.array([total - of_map, of_map]), total


def _solve(
    observed: _Observed, model: Projections, places: Floats
) -> tuple[Projections, Floats, _NormalEquations, bool]:
    """The model and the places after some steps, the normal equations of the last one, and whether it was small."""
    chi2 = observed.chi2(observed.residuals(model, places), observed.factors).sum()
    for _ in range(_STEPS):
        normal = _normal_equations(observed, model, places)
        of_images = normal.step()
        of_places = normal.places_moved(of_images)
        # Halved until chi squared does not grow: from far off a whole step may lead beyond a horizon.
        for part in 0.5 ** np.arange(_HALVINGS + 1):
            following = model.corrected(part * of_images), places + part * of_places
            after = observed.chi2(observed.residuals(*following), observed.factors).sum()
            if after <= (1.0 + _ROUNDING) * chi2:
                break
        (model, places), chi2 = following, after
        if small := bool(np.vdot(of_images, normal.right) < _CONVERGED):
            break
    return model, places, normal, small


def _normal_equations(observed: _Observed, model: Projections, places: Floats) -> _NormalEquations:
    from scipy.linalg import cho_factor

    ties, count = observed.ties, len(places)
    pixels = observed.order[observed.used[observed.order]]
    map_used = observed.used[len(ties.point) :]
    image, point = ties.image[pixels], ties.point[pixels]
    found = model.project(image, point, places)
    # Components are rows here, of all observations: derivatives by images (2, 8, n) and places (2, 2, n).
    weight = (observed.factors[0] * ties.sigma_px[pixels]) ** -1.0
    by_image, by_place = (np.moveaxis(part, 0, -1) * weight for part in (found.by_parameters, found.by_place))
    residual = (ties.pixels[pixels] - found.pixels).T * weight
    map_point = ties.map_point[map_used]
    map_weights = (observed.factors[1] * ties.map_sigma_m[map_used]) ** -2.0
    map_weight = _sums(map_point, map_weights, count)
    # The points' own part, of those of which nothing is used such that nothing moves them.
    first = np.searchsorted(point, np.arange(count + 1))
    alone = (np.diff(first) == 0) & (map_weight == 0.0)
    own = _sums(point, _products(by_place, by_place), count)
    own[[0, 1], [0, 1]] += map_weight + alone
    inverse = np.asarray(np.linalg.inv(np.moveaxis(own, -1, 0)), dtype=np.float64)
    map_residual = (ties.map_m[map_used] - places[map_point]).T
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
    for k, mine in enumerate(np.split(order, np.searchsorted(image[order], np.arange(1, model.images)))):
        block, design = slice(8 * k, 8 * k + 8), designs[mine].reshape(-1, 8)
        reduced[block, block] += design.T @ design
        right[k] = design.T @ residual.T[mine].ravel()
    held = model.held().ravel()
    reduced[held, held] = 1.0
    of_points = image, point, first, coupling, inverse, points_right, map_weight
    return _NormalEquations(cho_factor(reduced, lower=True)[0], right.ravel(), int((~held).sum()), *of_points)


def _coupled(first: Indices, image: Indices, coupling: Floats, between: Floats, images: int) -> Floats:
    """The sum over all points of W B W^T, with B between, by images, of which the first is not less than the second."""
    from radioloc.imaging._kernels import coupled  # brings numba

    out = np.zeros((images, images, 8, 8))
    coupled(first, image, coupling, between, out)
    return out


def _products(a: Floats, b: Floats) -> Floats:
    """Products A^T B of matrices (2, i, n) and (2, j, n), shape (i, j, n)."""
    return a[0, :, np.newaxis] * b[0] + a[1, :, np.newaxis] * b[1]


def _sums(number: Indices, values: Floats, count: int) -> Floats:
    """Sums over the last axis by numbers, shape (..., count)."""
    rows = values.reshape(math.prod(values.shape[:-1]), -1)
    sums = [np.bincount(number, row, minlength=count) for row in rows]
    return np.array(sums, dtype=np.float64).reshape(*values.shape[:-1], count)


def approximate_places(ties: TiePoints, matrices: Floats) -> Floats:
    """Places of the points: the map's, or the means over their images by homographies, shape (images, 3, 3)."""
    one, other, scale = np.einsum(
        "nij,nj->in", np.linalg.inv(matrices)[ties.image], np.insert(ties.pixels, 2, 1.0, axis=1)
    )
    east, north, number = _sums(
        ties.point, np.array([one / scale, other / scale, np.ones_like(scale)]), ties.count
    )
    places = np.column_stack([east, north]) / np.maximum(number, 1.0)[:, np.newaxis]
    places[ties.map_point] = ties.map_m
    return places
