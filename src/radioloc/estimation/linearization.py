"""The linearized model of the observations, and its solution by orthogonal factorization.

Partials of millions of observations by a dozen parameters are gigabytes. They are therefore never all there: a fit
asks for those of some ten thousand rows, reduces them to a triangle and asks for the next. The whitened partials, the
a-priori rows and the right side are reduced by Householder reflections (Bierman 1977, chapters IV and V; Lawson and
Hanson 1974) and the triangle is solved by its inverse or its singular values, so the condition number is never squared
by normal equations. Rows are reduced some hundred at a time, and the triangles of these again (Demmel et al. 2012):
they stay in the processor's cache.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from radioloc.dynamics.stochastic import StochasticAccelerations
from radioloc.errors import InputError, RadiolocError
from radioloc.estimation.smooth_partials import SmoothPartials
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.processes import KalmanFilter
from radioloc.noise.whitening import LinkedWhitener, Rows, RowsOf, Whitener, column
from radioloc.parameters.parameter import ParameterSet
from radioloc.vectors import Floats, Indices, Mask


class Linearization(Protocol):
    """Residuals and partials of a model at one set of parameters."""

    @property
    def residual_m(self) -> Floats:
        """Observed - computed, m, shape (n,)."""

    def partials(self, rows: Rows) -> Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""


ResidualFunction = Callable[[Floats], Any]
"""From parameters (p,) to a :class:`Linearization`; or, where there is room, to the pair of residuals observed -
computed (n,), m, and partials d(computed)/d(parameter) (n, p)."""


def smooth_partials(linearization: Linearization) -> SmoothPartials | None:
    """Return the partials of a dense series as polynomials; None of others."""
    smooth: SmoothPartials | None = getattr(linearization, "smooth", None)
    return smooth


def free_partials(linearization: Linearization, free: Mask) -> RowsOf:
    """Return the function from rows (m,) to partials with respect to the free parameters, (m, q)."""
    smooth = smooth_partials(linearization)
    if smooth is not None:
        return smooth.combined(np.eye(len(free))[:, free])
    return lambda rows: linearization.partials(rows)[:, free]


def process_noise(linearization: Linearization) -> tuple[StochasticAccelerations, ...]:
    """Return the stochastic accelerations of orbits on the observations."""
    processes: tuple[StochasticAccelerations, ...] = getattr(linearization, "processes", ())
    return processes


@dataclass(frozen=True, slots=True, eq=False)
class DenseLinearization:
    """A linearization that holds all its partials."""

    residual_m: Floats  # (n,)
    matrix: Floats  # (n, p)

    def partials(self, rows: Rows) -> Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""
        return self.matrix[rows]


def evaluate(residual_function: ResidualFunction, x: Floats) -> Linearization:
    """Linearization at x; :class:`InputError` if its shapes do not agree."""
    output = residual_function(x)
    if not isinstance(output, tuple):
        if output.residual_m.ndim != 1:
            raise InputError(f"residuals have shape {output.residual_m.shape}; (n,) is needed")
        linearization: Linearization = output
        return linearization
    residual_m, partials = (np.asarray(part, dtype=np.float64) for part in output)
    if residual_m.ndim != 1 or partials.shape != (len(residual_m), len(x)):
        raise InputError(
            f"residuals of shape {residual_m.shape} and partials of shape {partials.shape} do not belong to "
            f"{len(x)} parameters; (n,) and (n, {len(x)}) are needed"
        )
    return DenseLinearization(residual_m, partials)


def evaluate_step(residual_function: ResidualFunction, x: Floats, previous: Linearization) -> Linearization:
    """Linearization after a step; residuals are infinite where the model cannot be evaluated."""
    try:
        return evaluate(residual_function, x)
    except RadiolocError:
        n = len(previous.residual_m)
        return DenseLinearization(np.full(n, np.inf), np.full((n, len(x)), np.nan))


def check_partials(linearization: Linearization, used: Mask, parameters: ParameterSet) -> None:
    """Raise :class:`InputError` if partials of the used observations are not finite."""
    rows = np.flatnonzero(used)
    for start in range(0, len(rows), ROWS_AT_ONCE):
        finite = np.isfinite(linearization.partials(rows[start : start + ROWS_AT_ONCE])).all(axis=0)
        if not finite.all():
            name = parameters.names[int(np.flatnonzero(~finite)[0])]
            raise InputError(f"the partials with respect to {name} are not finite at the start")


def check_residuals(linearization: Linearization, used: Mask) -> None:
    """Raise :class:`InputError` if a residual of the used observations is not finite."""
    bad = np.flatnonzero(used & ~np.isfinite(linearization.residual_m))
    if len(bad):
        raise InputError(
            f"{len(bad)} of {int(used.sum())} residuals are not finite at the start, the first at {bad[0]}"
        )


_LEAF_ELEMENTS = 8192
"""Elements of a block of rows that is factorized at once. It fits the cache of a processor, and is too small for
multithreading in linear algebra libraries, so that results do not depend on the number of threads."""

_MAX_SLAB_PRODUCT = 2**16  # elements of a product, above which one for each slab takes gigabytes
_MAX_SPARSE_FRACTION = 0.1  # of nonzero elements, below which a sparse product is faster

_MIN_INFORMATION = 1e-13  # along an orthonormal coordinate; less is rounding

_RANK_TOLERANCE = 1e-10
"""Smallest singular value of a determined combination over the largest, with columns scaled to length one. Partials
have rounding errors of 1e-13 and errors of the light-time iteration of 1e-11."""

_MIN_SINGULAR_VALUE = 1e-12  # of a root with rows of length one: less is rounding
_MAX_SIGMA = 1e6
"""Largest standard deviation of a determined combination, in parameter scales (metres): the linear model is not valid
beyond about the Moon's radius."""


_KEPT_ELEMENTS = 2**22  # largest number of whitened partials in memory, 32 MB; more are computed again


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedPartials:
    """Whitened partials that are kept, part by part, by coordinates into which those of the free parameters turn."""

    parts: tuple[Floats, ...]  # (m, q)
    from_free: Floats  # (q, q)
    grams: tuple[Floats, ...] = ()  # (q, q), products of the parts with themselves, where they are used again
    # Takes observations that are rejected, but still in the parts, out of a part in place, from its first row on.
    project: Callable[[Floats, int], None] | None = None

    @classmethod
    def from_basis(cls, whitening: Whitener, basis: Floats, from_free: Floats) -> WhitenedPartials:
        """Whiten the partials (n, q) by coordinates."""
        parts = tuple(whitening.whitened(lambda rows: basis[rows]))
        return cls(parts, from_free, tuple(gram(part, part) for part in parts))

    def combined(self, root: Floats) -> Iterator[Floats]:
        """Yield partials of combinations of the free parameters, the columns of `root` (q, r), part by part, (m, r)."""
        from_coordinates, start = self.from_free @ root, 0
        for part in self.parts:
            yield self.projected(matrix_product(part, from_coordinates), start)
            start += len(part)

    def projected(self, values: Floats, start: int) -> Floats:
        """Columns (m, c) of a part, changed in place, without what is rejected."""
        if self.project is not None:
            self.project(values, start)
        return values


class StatedWhitener(Protocol):
    """Whitener of all usable observations by their stated noise, with their whitened partials."""

    @property
    def noise(self) -> ObservationCovariance:
        """Stated noise."""

    def with_rejections(self, rejected: Mask) -> tuple[LinkedWhitener, WhitenedPartials] | None:
        """Return the whitener without the rejected observations (n,), and their partials; None for many."""


@dataclass(frozen=True, eq=False)
class Factor:
    """Whitened linear problem reduced to a triangle, columns scaled to length one by ``column_norms``.

    The inverse of the triangle solves a problem whose parameters are all determined; the singular value decomposition
    gives the determined directions of the others, and damped steps.
    """

    # (q,), length of each whitened column with its a-priori row; 1/scale for a column of zeros
    column_norms: Floats
    triangle: Floats  # (q, q)
    right_side: Floats  # (q,), whitened residuals in the rows of the triangle
    scales: Floats  # (q,), of the parameters
    whitened: WhitenedPartials | None = None  # where there is room for them

    @cached_property
    def _inverse(self) -> Floats | None:
        """Inverse of the triangle; None unless its Frobenius norm shows that all directions are determined."""
        from scipy.linalg.lapack import dtrtri

        if not len(self.triangle):  # of which LAPACK complains on standard output
            return None
        inverse, failure = dtrtri(self.triangle)
        if failure or not np.linalg.norm(inverse) * _RANK_TOLERANCE * math.sqrt(len(inverse)) < 1.0:
            return None
        sigmas = np.linalg.norm(inverse / (self.column_norms * self.scales)[:, None])
        return np.asarray(inverse) if sigmas < _MAX_SIGMA else None

    @cached_property
    def _decomposition(self) -> tuple[Floats, Floats, Floats, Mask]:
        """Left vectors (q, q), singular values (q,), right vectors (q, q) and which of them are determined."""
        left_vectors, s, right = np.linalg.svd(self.triangle)
        sizes = np.linalg.norm(right / self.column_norms / self.scales, axis=1)
        determined = (s > _RANK_TOLERANCE * s.max(initial=0.0)) & (s * _MAX_SIGMA > sizes)
        return left_vectors, s, right.T, determined

    @cached_property
    def singular_values(self) -> Floats:
        """Singular values of the matrix with columns of length one, descending, shape (q,)."""
        if self._inverse is None:
            return self._decomposition[1]
        return np.asarray(np.linalg.svd(self.triangle, compute_uv=False), dtype=np.float64)

    @property
    def determined(self) -> Mask:
        """Mask of the singular directions that the data and the a-priori rows determine, shape (q,)."""
        return self._decomposition[3] if self._inverse is None else np.ones(len(self.triangle), dtype=bool)

    @property
    def step_sigmas(self) -> float:
        """Length of the undamped step in formal standard deviations."""
        if self._inverse is not None:
            return float(np.linalg.norm(self.right_side))
        left_vectors, *_, determined = self._decomposition
        return float(np.linalg.norm(left_vectors[:, determined].T @ self.right_side))

    @property
    def least_damping(self) -> float:
        """Smallest damping, the smallest singular value of a determined direction."""
        return float(self.singular_values[self.determined].min(initial=1.0))

    def step(self, damping: float) -> Floats:
        """Damped change of the free parameters along determined directions, shape (q,)."""
        if damping == 0.0 and self._inverse is not None:
            return (self._inverse @ self.right_side) / self.column_norms
        left_vectors, s, vectors, determined = self._decomposition
        s = s[determined]
        components = s * (left_vectors[:, determined].T @ self.right_side) / (s**2 + damping**2)
        return (vectors[:, determined] @ components) / self.column_norms

    def root_covariance(self) -> Floats:
        """Square root of the covariance of the determined directions, shape (q, r)."""
        root = self._inverse
        if root is None:
            _, s, vectors, determined = self._decomposition
            root = vectors[:, determined] / s[determined]
        return root / self.column_norms[:, None]

    def inverse_root(self) -> Floats:
        """Inverse of the root of a covariance whose directions are all determined, shape (q, q)."""
        if self._inverse is not None:
            return self.triangle * self.column_norms
        _, s, vectors, _ = self._decomposition
        return s[:, None] * vectors.T * self.column_norms

    def undetermined_directions(self) -> Floats:
        """Undetermined directions in parameter units, one per row, shape (q - r, q)."""
        if self._inverse is not None:
            return np.zeros((0, len(self.triangle)))
        _, _, vectors, determined = self._decomposition
        return vectors[:, ~determined].T / self.column_norms

    def with_gradient(self, gradient: Floats) -> Factor:
        """Return the factor with the right side of a gradient A^T r with respect to the free parameters, (q,)."""
        root = self.root_covariance()
        return replace(self, right_side=self.triangle @ (self.column_norms * (root @ (root.T @ gradient))))


def factorize(
    linearization: Linearization, whitening: Whitener, parameters: ParameterSet, x: Floats
) -> Factor | None:
    """Reduce a linearized problem with its a-priori rows to a triangle; None if it is not finite."""
    free = np.flatnonzero(parameters.free)
    q = len(free)
    with_prior = np.flatnonzero(np.isfinite(parameters.prior_sigmas[free]))
    prior_sigmas = parameters.prior_sigmas[free][with_prior]
    triangle = np.zeros((len(with_prior), q + 1))
    triangle[np.arange(len(with_prior)), with_prior] = 1.0 / prior_sigmas
    triangle[:, q] = (parameters.prior_values - x)[free][with_prior] / prior_sigmas

    whitened_partials: WhitenedPartials | None
    if isinstance(linearization, OrthonormalLinearization):
        rows, whitened_partials = linearization.condensed(whitening)
        triangle = reduced(triangle, rows)
    else:
        # The triangle carries over from part to part, so no copy of all whitened rows need be made
        parts = list[Floats]()
        free_elements = _KEPT_ELEMENTS if smooth_partials(linearization) is None else -1
        for whitened in _whitened_rows(linearization, whitening, free) if q else ():
            free_elements -= len(whitened) * (q + 1)
            if free_elements < 0:
                parts.clear()
            else:
                parts.append(whitened[:, :q])
            triangle = reduced(triangle, whitened)
        whitened_partials = WhitenedPartials(tuple(parts), np.eye(q)) if free_elements >= 0 else None
    if not np.isfinite(triangle).all():
        return None

    # Fewer rows than columns leave a trapezoid; rows of zeros complete it and show up as zero singular
    # values
    matrix = np.zeros((q, q))
    right_side = np.zeros(q)
    height = min(q, len(triangle))
    matrix[:height], right_side[:height] = triangle[:height, :q], triangle[:height, q]

    scales = parameters.scales[free]
    norms = np.linalg.norm(matrix, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0 / scales)
    return Factor(norms, matrix / norms, right_side, scales, whitened_partials)


def _whitened_rows(linearization: Linearization, whitening: Whitener, free: Rows) -> Iterator[Floats]:
    """Yield whitened partials by the free parameters with the residuals as last column, part by part.

    Those of dense series are condensed to rows with the same normal matrix.
    """
    smooth, residual_m = smooth_partials(linearization), linearization.residual_m
    if smooth is not None and isinstance(whitening, LinkedWhitener):
        return _joined(smooth.condensed(whitening.structures, whitening.filter, residual_m, free))

    def rows_of(rows: Rows) -> Floats:
        return np.column_stack([linearization.partials(rows)[:, free], residual_m[rows]])

    return whitening.whitened(rows_of)


def _joined(parts: Iterable[Floats]) -> Iterator[Floats]:
    """Yield parts of a few rows together, as the overhead of a factorization is that of some hundred rows."""
    batch, elements = list[Floats](), 0
    for part in parts:
        batch.append(part)
        elements += part.size
        if elements >= _LEAF_ELEMENTS:
            yield np.concatenate(batch)
            batch, elements = [], 0
    if batch:
        yield np.concatenate(batch)


@dataclass(frozen=True, slots=True, eq=False)
class LinearProblem:
    """Linear problem for fits to many sets of residuals, as in Monte Carlo studies."""

    # In coordinates that are orthonormal for the stated weights, normal equations lose no digits, and a fit needs no
    # orthogonal factorization of all rows.
    partials: Floats  # (n, p)
    x: Floats  # (p,), parameters of the residuals
    basis: Floats  # (n, q), partials with respect to the orthonormal coordinates
    from_free: Floats  # (q, q), from changes of the free parameters to coordinates
    to_free: Floats  # (q, q), inverse of `from_free`
    start_rows: Indices  # (m,), observations of the robust start
    stated: StatedWhitener | None = None  # of noise and observations that most fits have

    def residual_function(self, residual_m: Floats) -> Callable[[Floats], OrthonormalLinearization]:
        """Residual function of residuals (n,) at the values `x`, m."""

        def linearized(x: Floats) -> OrthonormalLinearization:
            if np.array_equal(x, self.x):
                return OrthonormalLinearization(self, residual_m)
            step_m = matrix_product(self.partials, (x - self.x)[:, None])[:, 0]
            return OrthonormalLinearization(self, residual_m - step_m)

        return linearized


@dataclass(frozen=True, slots=True, eq=False)
class OrthonormalLinearization:
    """Linearization of a :class:`LinearProblem`."""

    problem: LinearProblem
    residual_m: Floats
    whitened: WhitenedPartials | None = None  # by the stated noise, which a filter whitens further

    def partials(self, rows: Rows) -> Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""
        return self.problem.partials[rows]

    def condensed(self, whitening: Whitener) -> tuple[Floats, WhitenedPartials]:
        """Rows (q, q + 1) equivalent to the normal equations, and whitened partials."""
        basis, from_free, whitened = self.problem.basis, self.problem.from_free, self.whitened
        if whitened is None or not isinstance(whitening, LinkedWhitener):
            residuals = list(whitening.whitened(column(self.residual_m)))
            whitened = WhitenedPartials.from_basis(whitening, basis, from_free)
        else:
            residuals = list(whitening.stated.whitened(column(self.residual_m)))
            if whitening.filter is not None:
                whitened, residuals = _filtered(whitened, residuals, whitening.filter)
        normal, side = sum(whitened.grams, np.zeros_like(from_free)), np.zeros(len(from_free))
        for part, residual in zip(whitened.parts, residuals, strict=True):
            side += gram(part, residual)[:, 0]
        values, axes = np.linalg.eigh(normal)
        root = np.sqrt(np.maximum(values, 0.0))
        right_side = np.divide(axes.T @ side, root, out=np.zeros(len(root)), where=values > _MIN_INFORMATION)
        return np.column_stack([root[:, None] * axes.T @ from_free, right_side]), whitened


def _filtered(
    stated: WhitenedPartials, residuals: list[Floats], kalman: KalmanFilter
) -> tuple[WhitenedPartials, list[Floats]]:
    """Whiten partials and residuals further by a filter, part by part."""
    parts, grams, begin, residuals = list(stated.parts), list(stated.grams), 0, list(residuals)
    states = [np.zeros((kalman.gain.shape[1], width)) for width in (len(stated.from_free), 1)]
    for k, part in enumerate(parts):
        rows = slice(begin, begin := begin + len(part))
        scale = kalman.scale[rows]
        if kalman.gain[rows].any() or np.ptp(scale) > 0.0:
            parts[k], residuals[k] = (
                kalman.innovations(columns, rows, state)
                for columns, state in zip((part, residuals[k]), states, strict=True)
            )
            stated.projected(parts[k], rows.start)
            grams[k] = gram(parts[k], parts[k])
        else:  # all errors are independent, with sigmas that are larger by one factor
            parts[k], residuals[k] = stated.projected(scale[0] * part, rows.start), scale[0] * residuals[k]
            grams[k] = scale[0] ** 2 * grams[k]
    return WhitenedPartials(tuple(parts), stated.from_free, tuple(grams)), residuals


def gram(a: Floats, b: Floats) -> Floats:
    """Product a^T b of tall matrices, in slabs too small for multithreading in linear algebra libraries."""
    if a.shape[1] * b.shape[1] > _MAX_SLAB_PRODUCT:
        return np.asarray(_thinned(a).T @ b)
    slab = _slab(a, b)
    count = len(a) // slab
    slab_rows = count * slab
    if not slab_rows:
        return np.asarray(a.T @ b)
    transposed = np.swapaxes(a[:slab_rows].reshape(count, slab, a.shape[1]), 1, 2)
    slabs = transposed @ b[:slab_rows].reshape(count, slab, b.shape[1])
    return np.asarray(slabs.sum(axis=0) + a[slab_rows:].T @ b[slab_rows:])


def matrix_product(a: Floats, b: Floats) -> Floats:
    """Product a b of a tall matrix and a small one, in slabs as of :func:`gram`."""
    if b.size > _MAX_SLAB_PRODUCT:
        return np.asarray(_thinned(a) @ b)
    slab = _slab(a, b)
    count = len(a) // slab
    slab_rows, out = count * slab, np.empty((len(a), b.shape[1]))
    np.matmul(
        a[:slab_rows].reshape(count, slab, a.shape[1]),
        b,
        out=out[:slab_rows].reshape(count, slab, b.shape[1]),
    )
    out[slab_rows:] = a[slab_rows:] @ b
    return out


def _thinned(a: Floats) -> Any:
    """Rows of many parameters as a sparse matrix if each parameter acts on few of them."""
    from scipy.sparse import csr_array

    return csr_array(a) if np.count_nonzero(a) < _MAX_SPARSE_FRACTION * a.size else a


def _slab(a: Floats, b: Floats) -> int:
    width = max(a.shape[1], b.shape[1], 1)
    return max(32, min(_LEAF_ELEMENTS // width, 20 * _LEAF_ELEMENTS // width**2))


def with_new_right_side(
    factor: Factor, linearization: Linearization, whitening: Whitener, parameters: ParameterSet, x: Floats
) -> Factor:
    """Return a factor with the triangle of a neighbouring point and the right side of the gradient at x.

    Corrected seminormal equations (Bjorck 1987): with the triangle R, R^-T A^T r is the right side but for rounding. It
    gives the length of the next step at a third of the cost of another factorization.
    """
    free = np.flatnonzero(parameters.free)
    gradient = np.append((parameters.prior_values - x)[free] / parameters.prior_sigmas[free] ** 2, 0.0)
    for rows in _whitened_rows(linearization, whitening, free):
        # Summed by numpy itself: the result does not depend on the number of threads
        gradient += np.einsum("nq,n->q", rows, rows[:, -1])
    return factor.with_gradient(gradient[:-1])


def reduced(triangle: Floats, rows: Floats) -> Floats:
    """Triangular factor of a triangle (k, c) with rows (m, c) beneath it, shape (min(k + m, c), c)."""
    columns = rows.shape[1]
    leaf = max(2 * columns, _LEAF_ELEMENTS // columns)
    while len(rows) > 2 * leaf:
        count = len(rows) // leaf
        tops = np.asarray(np.linalg.qr(rows[: count * leaf].reshape(count, leaf, columns), mode="r"))
        rows = np.concatenate([tops.reshape(-1, columns), rows[count * leaf :]])
    return np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))


def root_of_rows(root: Floats) -> Floats:
    """Square root (q, r) of the covariance of some parameters from their rows of a root (q, s)."""
    lengths, vectors, sizes, _ = _decomposed(root)
    return np.asarray(lengths * vectors * sizes)


def directions_of_rows(root: Floats) -> Floats:
    """Orthonormal directions (s, r) in which some parameters vary, by their rows of a root of the covariance (q, s)."""
    return _decomposed(root)[3].T


def _decomposed(root: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Lengths of rows (q, 1), and the singular value decomposition of the rows of length one without zeros."""
    lengths = np.linalg.norm(root, axis=1, keepdims=True)
    lengths[lengths == 0.0] = 1.0
    vectors, sizes, directions = np.linalg.svd(root / lengths, full_matrices=False)
    nonzero = sizes > _MIN_SINGULAR_VALUE
    return lengths, vectors[:, nonzero], sizes[nonzero], directions[nonzero]


def covariance_matrix(factor: Factor, parameters: ParameterSet, unit: Floats | None = None) -> Floats:
    """Covariance over all parameters, shape (p, p)."""
    root = factor.root_covariance()
    covariance_free = root @ root.T if unit is None else root @ unit @ root.T
    # A parameter takes part in an undetermined direction if its share, in units of its scale, is more than
    # rounding
    directions = factor.undetermined_directions() / parameters.scales[parameters.free]
    if len(directions):
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        is_undetermined = (np.abs(directions) > 1e-6).any(axis=0)
        covariance_free[is_undetermined, :] = 0.0
        covariance_free[:, is_undetermined] = 0.0
        covariance_free[is_undetermined, is_undetermined] = np.inf
    p = len(parameters)
    covariance = np.zeros((p, p))
    covariance[np.ix_(parameters.free, parameters.free)] = covariance_free
    return covariance
