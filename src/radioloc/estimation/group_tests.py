"""Tests of columns that are added to a fitted problem, from products of matrices and without another fit.

The used observations, averaged over bins of their series, have residuals y at the estimate, partials A by the estimated
and the considered parameters, and the covariance V of each series' noise. A-priori values are further rows. With the
total covariance, which has the errors of the considered parameters in it, columns Z (a step of a station's delays, the
displacement of a station) have the estimate d = F^-1 s and the test statistic s^T F^-1 s, where

    s = Z^T (y - A u),    F = Z^T Z - Z^T A N^-1 A^T Z,    u = N^-1 A^T y,    N = A^T A,

all whitened by V. It is chi-square of the rank of F where nothing is wrong (score test, Rao 1948; the data-snooping of
Baarda 1968 where Z has one column). The estimate moves by -N^-1 A^T Z d once Z is in the model. Columns of a group of
observations alone, its own set of all estimated parameters, take the group out of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from radioloc.estimation.consider import NO_ERRORS, UnestimatedErrors
from radioloc.estimation.gauss_markov import Points, SeriesNoise, noise_of_series
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import free_partials, gram, matrix_product
from radioloc.estimation.series import SeriesOrder, independent_series, link_contributions, points_of
from radioloc.estimation.time_correlation import ABSORBED_SIGMAS, mixed_units
from radioloc.noise.whitening import Rows, column
from radioloc.vectors import Floats, Indices

if TYPE_CHECKING:  # which takes time to import
    from scipy.sparse import csc_array

# Smallest fraction of a column outside the span of the design matrix; less is rounding.
_MIN_SQUARE_FRACTION = 1e-6
_MIN_PIVOT = 1e-5  # of a Cholesky factor of unit diagonal; with smaller ones the inverse loses digits
_BATCH_POINTS, _MIN_BATCHES = 10, 5  # batches whose sums show whether residuals are still correlated
_MEDIAN_CHI2_1 = 0.4549  # median of chi-square with one degree of freedom
_MIN_VARIANCE_OBSERVATIONS = 20  # observations that determine the variance of a series


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTest:
    """Chi-square test of added columns."""

    chi2: float
    dof: int
    estimate: Floats  # (k,), coefficients of the columns
    root: Floats  # (k, dof), square root of their covariance
    shift: Floats  # (q,), change of the estimated parameters
    shift_root_covariance: Floats  # (q, dof), that of the shift under the null hypothesis
    log_p_value: float  # logarithm of the p-value
    variance_factor: float = 1.0  # variance factor of the common errors of links


@dataclass(frozen=True, eq=False)
class BinnedProblem:
    """Least-squares problem of n points, means of bins of observations, and k a-priori values."""

    # Added columns (n + k, w) are not whitened. A point of combined observations has several links: the contributions
    # of links to points are m rows.
    points: Points
    prior: Floats  # (k, 1 + c), residual and partials of the a-priori values over their sigmas
    place: Indices  # (m,), index of the point
    code: Indices  # (m,), index of the series of single observations
    values: Floats  # (m, 1 + q), constant of the link, and partials with respect to the estimated parameters
    candidates: Floats  # (m, h), change by one sigma of parameters that the fit holds at zero
    roots: tuple[Floats, ...]  # L of each series of points, V^-1 = L^T L; a number for white noise
    white: tuple[float, ...] = ()  # white variance of each series

    @cached_property
    def _rows(self) -> Floats:
        """Whitened residuals and partials, (n + k, 1 + c)."""
        rows = np.vstack([np.column_stack([self.points.residual, self.points.unit]), self.prior])
        for k, root in enumerate(self.roots):
            part = self.points.series_slice(k)
            rows[part] = _times(root, rows[part])
        return rows

    @cached_property
    def _weighted_rows(self) -> Floats:
        """Residuals and partials of the points times their inverse covariance, (n, 1 + c)."""
        parts = [_times(root.T, self._rows[self.points.series_slice(k)]) for k, root in enumerate(self.roots)]
        return np.concatenate(parts)

    @property
    def whitened(self) -> Floats:
        """Whitened partials, (n + k, c)."""
        return self._rows[:, 1:]

    @property
    def estimated_count(self) -> int:
        """Number of estimated parameters, the first of all."""
        return self.values.shape[1] - 1

    @cached_property
    def inverse(self) -> Floats:
        """Inverse of the normal matrix, (c, c)."""
        return _scaled_inverse(gram(self.whitened, self.whitened))

    @cached_property
    def estimate(self) -> Floats:
        """Change of the parameters, (c,)."""
        return np.asarray(self.inverse @ (self.whitened.T @ self._rows[:, 0]))

    @cached_property
    def residual(self) -> Floats:
        """Whitened residuals after the estimate, (n + k,)."""
        return np.asarray(self._rows[:, 0] - self.whitened @ self.estimate)

    @classmethod
    def from_fit(
        cls,
        fit: FitResult,
        order: SeriesOrder,
        noise_of: Callable[[Points], Mapping[str, SeriesNoise]],
        considered: UnestimatedErrors = NO_ERRORS,
        candidates: UnestimatedErrors = NO_ERRORS,
    ) -> BinnedProblem:
        """Bin a fit, its parameters scaled to unit formal covariance and consider parameters to a-priori sigmas."""
        from scipy.linalg import block_diag

        free, considered_sigmas = fit.parameters.free, considered.parameters.prior_sigmas
        unit, width = mixed_units(fit)
        if considered.parameters:
            unit = block_diag(unit, np.diag(considered_sigmas))
        sigmas = np.append(fit.parameters.prior_sigmas[free], considered_sigmas)
        offset = np.append((fit.parameters.prior_values - fit.x)[free], np.zeros(len(considered_sigmas)))

        partials_of = free_partials(fit.linearization, free)

        def constant_and_partials(rows: Rows) -> Floats:
            columns = [np.ones((len(rows), 1)), partials_of(rows)]
            columns += [considered.partials(rows), candidates.partials(rows)]
            return np.hstack(columns)

        series = independent_series(order, fit.noise, fit.used)
        points = points_of(series, column(fit.residual_m))
        place, code, sums = link_contributions(series, order, constant_and_partials)
        sums, changes = np.split(sums, [1 + len(unit)], axis=1)
        changes = changes * candidates.parameters.prior_sigmas
        partials = np.zeros((len(points.gain), sums.shape[1] - 1))
        np.add.at(partials, place, sums[:, 1:])
        values = np.hstack([sums[:, :1], sums[:, 1:] @ unit[:, :width]])
        has_prior = np.isfinite(sigmas)
        prior = np.column_stack([offset, unit])[has_prior] / sigmas[has_prior, None]
        points = replace(points, unit=matrix_product(partials, unit))
        noise = noise_of(replace(points, unit=points.unit[:, :width]))
        problem = cls(points, prior, place, code, values, changes, roots=())
        return problem._with_noise(noise, np.zeros(unit.shape[1]))

    def _with_noise(self, noise: Mapping[str, SeriesNoise], estimate: Floats) -> BinnedProblem:
        """Return the problem with the noise of each series, white by default."""
        # The variance is larger if the whitened residuals of the series are still correlated.
        points, roots, white = self.points, list[Floats](), list[float]()
        prior = self.prior[:, 1:]
        inverse = _scaled_inverse(gram(points.unit, points.unit) + gram(prior, prior))
        leverage = np.einsum("nc,nc->n", points.unit, matrix_product(points.unit, inverse))
        absorbed = np.add.reduceat(leverage, points.begin[:-1]).tolist()
        for k, series in enumerate(points.series):
            part = points.series_slice(k)
            series_noise = noise.get(series.key) or _white_noise(points, k, estimate, absorbed[k])
            white.append(series_noise.white)
            width_s = float(points.width_s[k])
            roots.append(series_noise.whitening_root(points.step_s[part], points.gain[part], width_s))
        whitened_problem = replace(self, roots=tuple(roots), white=tuple(white))
        spreads = [_spread(whitened_problem.residual[points.series_slice(k)]) for k in range(len(roots))]
        if max(spreads) == 1.0:
            return whitened_problem
        return replace(
            self,
            roots=tuple(root / math.sqrt(spread) for root, spread in zip(roots, spreads, strict=True)),
            white=tuple(variance * spread for variance, spread in zip(white, spreads, strict=True)),
        )

    def columns(
        self, links: Mapping[int, float], span_s: tuple[float, float] = (-np.inf, np.inf)
    ) -> csc_array:
        """Column of constants times signs of links in an interval, (n + k, 1)."""
        indices, place, sign = self._rows_of(links, span_s)
        return self.sparse(place, sign[:, None] * self.values[indices, :1])

    def sparse(self, rows: Indices, values: Floats) -> csc_array:
        """Columns (n + k, w) with values (m, w) in some rows (m,); those of one row are added."""
        from scipy.sparse import csc_array

        count, width = values.shape
        parts = values.T.ravel(), np.tile(rows, width), count * np.arange(width + 1)
        columns = csc_array(parts, (len(self.points.time_s) + len(self.prior), width))
        columns.sum_duplicates()
        columns.eliminate_zeros()
        return columns

    def removal(
        self, links: Mapping[int, float], span_s: tuple[float, float] = (-np.inf, np.inf)
    ) -> csc_array:
        """Columns that remove links in an interval from the fit: partials with respect to a separate parameter set.

        Columns are divided by their whitened norms. Their number is at most that of the points in the interval.
        """
        indices, place, _ = self._rows_of(links, span_s)
        rows, index = np.unique(place, return_inverse=True)
        values = np.zeros((len(rows), self.estimated_count))
        np.add.at(values, index, self.values[indices, 1:])
        series = np.searchsorted(self.points.begin, rows, side="right") - 1
        squares = np.zeros(values.shape[1])
        for k in np.unique(series).tolist():
            of_series = series == k
            root = self.roots[k]
            root = root[:, rows[of_series] - self.points.begin[k]] if root.ndim else root
            squares += np.square(_times(root, values[of_series])).sum(axis=0)
        values = values / np.sqrt(np.where(squares > 0.0, squares, 1.0))
        if len(rows) < values.shape[1]:
            vectors, sizes, _ = np.linalg.svd(values, full_matrices=False)
            values = vectors * sizes
        return self.sparse(rows, values)

    def candidate_columns(self, indices: Sequence[int], codes: Iterable[int] | None = None) -> csc_array:
        """Columns of some parameters that the fit holds at zero, of all links or of some."""
        in_links = slice(None) if codes is None else np.isin(self.code, list(codes))
        return self.sparse(self.place[in_links], self.candidates[in_links][:, indices])

    def times_s(self, links: Iterable[int]) -> Floats:
        """Epochs of the points of some links, ascending, s."""
        return np.unique(self.points.time_s[self._rows_of(dict.fromkeys(links, 1.0))[1]])

    def width_s(self, links: Mapping[int, float]) -> float:
        """Largest bin width of some links, s."""
        return float(
            np.repeat(self.points.width_s, np.diff(self.points.begin))[self._rows_of(links)[1]].max()
        )

    def _rows_of(
        self, links: Mapping[int, float], span_s: tuple[float, float] = (-np.inf, np.inf)
    ) -> tuple[Indices, Indices, Floats]:
        signs = np.zeros(int(self.code.max()) + 1)
        signs[list(links)] = list(links.values())
        indices = np.concatenate([self._indices_of_code[code] for code in links])
        indices = np.sort(indices) if len(links) > 1 else indices
        time_s = self.points.time_s[self.place[indices]]
        indices = indices[(time_s >= span_s[0]) & (time_s <= span_s[1])]
        return indices, self.place[indices], signs[self.code[indices]]

    @cached_property
    def _indices_of_code(self) -> list[Indices]:
        """Contributions to points of each series of single observations."""
        order, ends = np.argsort(self.code, kind="stable"), np.cumsum(np.bincount(self.code))
        return np.split(order, ends[:-1])

    def _series_with(self, columns: Floats) -> Iterator[tuple[slice, Floats]]:
        """Points and roots of the series in which columns (n + k, w) have nonzero elements."""
        n, begin = len(self.points.time_s), self.points.begin
        is_nonzero = np.logical_or.reduceat(columns[:n].any(axis=1), begin[:-1])
        return ((self.points.series_slice(k), self.roots[k]) for k in np.flatnonzero(is_nonzero).tolist())

    def test(
        self, columns: csc_array, links: Mapping[int, float] | None = None, *, scaled: bool = False
    ) -> ScoreTest | None:
        """Test whether coefficients of columns (n + k, w) are zero; None if the parameters absorb the columns.

        Columns are `scaled` if their norms are those of :meth:`removal`.
        """
        return self.products(columns).test(slice(None), links, scaled=scaled)

    def products(self, columns: csc_array) -> ScoreProducts:
        """Products of columns (n + k, w) for tests of any of them."""
        from scipy.sparse import csr_array

        # Most columns are of a few points.
        z = columns.toarray(order="F")
        for part, root in self._series_with(z):
            nonzero = np.flatnonzero(z[part].any(axis=0))
            z[part, nonzero] = _times(root, z[part, nonzero])
        sparse_products = csr_array(csr_array(z.T) @ self._rows)  # few parameters act on most columns
        products = sparse_products.toarray()
        with_partials = products[:, 1:]
        score = products[:, 0] - with_partials @ self.estimate
        gain = np.asarray(sparse_products[:, 1:] @ self.inverse).T
        return ScoreProducts(self, z, score, with_partials, np.linalg.norm(z, axis=0), gain)

    @cached_property
    def _epoch(self) -> Indices:
        """Index of the epoch of each point, (n,)."""
        return np.unique(self.points.time_s, return_inverse=True)[1]

    def inflation(self, links: Mapping[int, float], shift: Floats, effect: Floats) -> float:
        """Variance factor of the common errors of links, 1 if they are independent.

        Residuals are those after a shift of the parameters (c,) and a further effect (n + k,).
        """
        _, place, sign = self._rows_of(links)
        points, of_points = np.unique(place, return_inverse=True)
        residual = (self.residual[points] - self.whitened[points] @ shift - effect[points])[of_points]
        count = np.bincount(self._epoch[place])
        sums = np.bincount(self._epoch[place], sign * residual)[count > 0]
        return _spread(sums / np.sqrt(count[count > 0]))

    def chi2_of_steps(self, links: Mapping[int, float], edges_s: Floats) -> Floats:
        """Chi-square of a step of some links at each of w epochs, (w,)."""
        # A step is a sum over all later points: cumulative sums from the end serve all epochs.
        constant = self.columns(links).toarray()[:, 0]
        squares, products = np.zeros(len(edges_s)), np.zeros((len(edges_s), self._rows.shape[1]))
        for part, root in self._series_with(constant[:, None]):
            index, of_points = np.searchsorted(self.points.time_s[part], edges_s), constant[part, None]
            if root.ndim:
                squares += np.square(_sums_from(root.T * of_points)).sum(axis=1)[index]
            else:
                squares += _sums_from(np.square(root * of_points))[index, 0]
            products += _sums_from(of_points * self._weighted_rows[part])[index]
        with_partials = products[:, 1:]
        score = products[:, 0] - with_partials @ self.estimate
        acting = np.flatnonzero(with_partials.any(axis=0))
        with_acting = with_partials[:, acting]
        inverse = self.inverse[np.ix_(acting, acting)]
        information = squares - np.einsum("wc,wc->w", with_acting @ inverse, with_acting)
        determined = information > _MIN_SQUARE_FRACTION * squares
        return np.divide(score**2, information, out=np.zeros_like(score), where=determined)

    def with_parameters(self, columns: csc_array) -> BinnedProblem:
        """Return the problem with columns as further parameters and the same noise."""
        of_points, of_prior = np.split(columns.toarray(), [len(self.points.time_s)])
        points = replace(self.points, unit=np.hstack([self.points.unit, of_points]))
        return replace(self, points=points, prior=np.hstack([self.prior, of_prior]))

    def with_columns(self, columns: csc_array) -> BinnedProblem:
        """Return the problem with columns as further parameters and the noise of the new residuals."""
        larger = self.with_parameters(columns)
        points = larger.points
        # A fault may exceed the bounds within which noise is free of the parameters, but not once it is estimated.
        change = points.unit @ larger.estimate
        squares = np.square(points.residual - change) - np.square(points.residual)
        after_change = replace(
            points,
            residual=points.residual - change,
            squares=points.squares + np.add.reduceat(squares, points.begin[:-1]),
        )
        return larger._with_noise(noise_of_each(after_change), larger.estimate)

    def with_noise_of(self, source: BinnedProblem) -> BinnedProblem:
        """Return the problem with the noise of another one of the same observations."""
        return replace(self, roots=source.roots, white=source.white)

    def noise_dof(self, residual_columns: Floats) -> float:
        """Degrees of freedom of the variance of the coefficient of a column (n + k,), whitened and projected.

        Satterthwaite (1946), with the information of white and correlated variance of each series.
        """
        total, inverse_dof = float(residual_columns @ residual_columns), 0.0
        for k, root in enumerate(self.roots):
            part, white = self.points.series_slice(k), self.white[k]
            of_series = residual_columns[part]
            root = root if root.ndim else root * np.eye(len(of_series))
            weights, precision = root.T @ of_series, root.T @ root
            of_white = white * float(weights @ weights)
            fractions = np.array([of_white, float(of_series @ of_series) - of_white]) / total
            n, trace, squares = len(root), white * np.trace(precision), white**2 * np.square(precision).sum()
            within_bins = float(self.points.count[k]) - n
            information = np.array(
                [[squares + within_bins, trace - squares], [trace - squares, n - 2.0 * trace + squares]]
            )
            inverse_dof += float(fractions @ np.linalg.pinv(information, hermitian=True) @ fractions)
        return 1.0 / max(inverse_dof, 1e-12)


@dataclass(frozen=True, slots=True, eq=False)
class ScoreProducts:
    """Products of w columns and the residuals, after projection off the c parameters."""

    problem: BinnedProblem
    whitened: Floats  # (n + k, w)
    score: Floats  # (w,)
    with_partials: Floats  # (w, c)
    size: Floats  # (w,), norms of the whitened columns
    gain: Floats  # (c, w)

    def information(self, columns: list[int] | slice, partners: list[int] | slice) -> Floats:
        """Information on coefficients of some columns with that on partners, (k, m)."""
        squares = self.whitened[:, columns].T @ self.whitened[:, partners]
        return np.asarray(squares - self.with_partials[columns] @ self.gain[:, partners])

    def variances(self, columns: Sequence[int]) -> Floats:
        """Information on the coefficient of each of some columns, (k,)."""
        absorbed = np.einsum("wc,cw->w", self.with_partials[columns], self.gain[:, columns])
        return np.asarray(self.size[columns] ** 2 - absorbed)

    def test(
        self,
        indices: list[int] | slice = slice(None),
        links: Mapping[int, float] | None = None,
        *,
        scaled: bool = False,
    ) -> ScoreTest | None:
        """Test some of the columns together; None if the parameters absorb them."""
        size, score, gain = self.size[indices], self.score[indices], self.gain[:, indices]
        scale = np.ones(len(size))
        if not scaled:
            scale = np.divide(1.0, size, out=np.zeros(len(size)), where=size > 0.0)
        matrix = self.information(indices, indices) * scale[:, None] * scale
        values, axes = (matrix[0], np.ones((1, 1))) if len(matrix) == 1 else np.linalg.eigh(matrix)
        determined = values > _MIN_SQUARE_FRACTION
        if not determined.any():
            return None
        root = scale[:, None] * axes[:, determined] / np.sqrt(values[determined])
        components = root.T @ score
        estimate, shift = root @ components, -gain @ root @ components
        width = self.problem.estimated_count
        chi2, dof, inflation = float(components @ components), int(determined.sum()), 1.0
        if links:  # errors of a station are common to its baselines
            inflation = self.problem.inflation(links, shift, self.whitened[:, indices] @ estimate)
        log_p_value = chi2_log_p_value(chi2 / inflation, dof)
        of_shift = gain[:width] @ root
        return ScoreTest(chi2, dof, estimate, root, shift[:width].copy(), of_shift, log_p_value, inflation)

    def noise_dof(self, estimate: Floats) -> float:
        """Degrees of freedom of the variance of the estimated coefficients of all columns."""
        effect = self.whitened @ estimate
        return self.problem.noise_dof(effect - self.problem.whitened @ (self.gain @ estimate))


def estimate_change(fitted: BinnedProblem, changed: BinnedProblem) -> tuple[Floats, Floats]:
    """Change of q estimated parameters from the fit to a problem with more, (q,), and the root of its covariance.

    The covariance is that of the difference of both linear estimates, with the noise of the second problem. The first
    has the weights of the fit.
    """
    count = fitted.estimated_count
    effects = fitted.inverse[:count] @ fitted.whitened.T
    for k, root in enumerate(changed.roots):
        part = changed.points.series_slice(k)
        of_fit = _times(fitted.roots[k].T, effects[:, part].T) if fitted.roots else effects[:, part].T
        effects[:, part] = (np.linalg.solve(root.T, of_fit) if root.ndim else of_fit / root).T
    root_of_change = changed.inverse[:count] @ changed.whitened.T - effects
    return changed.estimate[:count], root_of_change


def _times(root: Floats, values: Floats) -> Floats:
    """Product of a root (n, n), or a number, with values (n, w)."""
    return np.asarray(root @ values if root.ndim else root * values)


def _scaled_inverse(normal: Floats) -> Floats:
    """Inverse of a normal matrix scaled to unit diagonal, so that the size of a column does not make it dependent."""
    from scipy.linalg import pinvh
    from scipy.linalg.lapack import dpotrf, dpotri

    diagonal = np.sqrt(np.diag(normal))
    scale = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
    scaled = scale[:, None] * normal
    scaled *= scale
    factor, failure = dpotrf(scaled)
    if failure or np.diag(factor).min(initial=1.0) < _MIN_PIVOT:
        # The eigenvectors of numpy, by divide and conquer, fail for some well-conditioned matrices of this form.
        return scale[:, None] * np.asarray(pinvh(scaled, rtol=1e-15)) * scale
    upper = dpotri(factor, overwrite_c=True)[0]  # with zeros below
    inverse = upper + upper.T
    np.fill_diagonal(inverse, np.diag(upper))
    inverse *= scale[:, None]
    inverse *= scale
    return np.asarray(inverse)


def noise_of_each(points: Points) -> dict[str, SeriesNoise]:
    """Noise of each series, estimated separately so that an offset of one series is not noise."""
    return noise_of_series(points, ABSORBED_SIGMAS, jointly=False)


def _sums_from(values: Floats) -> Floats:
    """Cumulative sums of values (n, w) from the end, with a final row of zeros, shape (n + 1, w)."""
    sums = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values[::-1], axis=0, out=sums[-2::-1])
    return sums


def _white_noise(points: Points, k: int, estimate: Floats, absorbed: float) -> SeriesNoise:
    """White noise with the variance of the residuals; at least the stated one for little redundancy."""
    # Parameters of single nights absorb most of laser ranges, and would make their noise too small.
    part = points.series_slice(k)
    count = max(float(points.count[k]) - absorbed, 1.0)
    residual = points.residual[part] - points.unit[part] @ estimate
    within_bins = float(points.squares[k] - np.square(points.residual[part]).sum())
    variance = (within_bins + float(residual @ residual)) / count
    if count < _MIN_VARIANCE_OBSERVATIONS or not variance > 0.0:
        variance = max(variance, 1.0)
    return SeriesNoise(variance, np.ones(1), np.zeros(1))


def _spread(independent: Floats) -> float:
    """Variance, 1 or more, of residuals of nominally unit variance, from sums over batches."""
    # Medians keep a misfit from increasing its own variance.
    batches = len(independent) // _BATCH_POINTS
    if batches < _MIN_BATCHES:
        return 1.0
    begin = np.arange(batches) * _BATCH_POINTS
    sums = np.add.reduceat(independent, begin) / np.sqrt(np.diff(np.append(begin, len(independent))))
    squares = np.square(sums - np.median(sums))
    return max(1.0, float(np.median(squares)) / _MEDIAN_CHI2_1)


def f_log_p_value(chi2: float, dof: int, noise_dof: float) -> float:
    """Logarithm of the upper tail probability of chi-square by an estimated variance (Fisher's distribution)."""
    from scipy.special import betainc

    probability = float(betainc(0.5 * noise_dof, 0.5 * dof, noise_dof / (noise_dof + chi2)))
    return math.log(max(probability, 1e-300))


def chi2_log_p_value(chi2: float, dof: int) -> float:
    """Logarithm of the upper tail probability of chi-square."""
    from scipy.special import gammaincc, gammaln

    probability = float(gammaincc(0.5 * dof, 0.5 * chi2))
    if probability > 1e-280:
        return math.log(probability)
    half = 0.5 * chi2
    return -half + (0.5 * dof - 1.0) * math.log(half) - float(gammaln(0.5 * dof))
