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
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.gauss_markov import Points, SeriesNoise, noise_of_series
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import IndependentSeries, SeriesOrder, add_rows, independent_series, points_of
from radioloc.estimation.time_correlation import ABSORBED_SIGMAS, mixed_units
from radioloc.noise.whitening import Rows, RowsOf, column
from radioloc.vectors import Floats

_MIN_SQUARE_FRACTION = 1e-6  # of a column that the parameters must leave of it for a test
_BATCH_POINTS, _MIN_BATCHES = 10, 5  # summed to see whether residuals stay correlated
_MEDIAN_CHI2_1 = 0.4549  # of the square of a normal variable of unit variance
_MIN_VARIANCE_OBSERVATIONS = 20  # that determine the variance of a series


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What a test says of added columns."""

    chi2: float
    dof: int
    estimate: Floats  # (k,)
    shift: Floats  # (c,), of the parameters
    root_of_shift: Floats  # (c, dof), square root of the covariance of that shift where nothing is wrong
    log_chance: float  # logarithm of the probability that chance alone makes it as large


@dataclass(frozen=True, slots=True, eq=False)
class BinnedProblem:
    """Fit in n points, bins of observations over the root of their count, and k a-priori values."""

    # Columns to be added have a row for each point and a-priori value, n + k, and are not whitened. What single links
    # have in the points, of which one of combined observations has several, is m rows of its own.
    points: Points
    prior: Floats  # (k, 1 + c), residual and partials over the sigmas
    place: NDArray[np.intp]  # (m,), point that a link has part in
    code: NDArray[np.intp]  # (m,), series of single observations
    values: Floats  # (m, 1 + q), a constant of the link, and its partials by the estimated parameters
    roots: tuple[Floats, ...]  # of each series of the points, of the inverse covariance V^-1 = L^T L
    left: Floats = field(init=False)  # (n + k,), whitened residuals that the estimate leaves
    whitened: Floats = field(init=False)  # (n + k, c), partials
    weighted: Floats = field(init=False)  # (n + k, 1 + c), residuals and partials times V^-1
    inverse: Floats = field(init=False)  # (c, c), N^-1
    estimate: Floats = field(init=False)  # (c,), u

    def __post_init__(self) -> None:
        both = np.concatenate([np.column_stack([self.points.residual, self.points.unit]), self.prior])
        weighted = both.copy()
        for k, root in enumerate(self.roots):
            of = self.points.of(k)
            both[of] = root @ both[of]
            weighted[of] = root.T @ both[of]
        inverse = np.linalg.pinv(both[:, 1:].T @ both[:, 1:], hermitian=True)
        estimate = inverse @ (both[:, 1:].T @ both[:, 0])
        object.__setattr__(self, "left", both[:, 0] - both[:, 1:] @ estimate)
        object.__setattr__(self, "whitened", both[:, 1:])
        object.__setattr__(self, "weighted", weighted)
        object.__setattr__(self, "inverse", inverse)
        object.__setattr__(self, "estimate", estimate)

    @classmethod
    def of(
        cls,
        fit: FitResult,
        order: SeriesOrder,
        noise_of: Callable[[Points], Mapping[str, SeriesNoise]],
        considered: ConsideredErrors | None = None,
    ) -> BinnedProblem:
        """Bin a fit; parameters are in coordinates of unit formal covariance, then the considered ones in sigmas."""
        free, sigmas = fit.parameters.free, fit.parameters.prior_sigmas[fit.parameters.free]
        off = (fit.parameters.prior_values - fit.x)[free]
        unit, width = mixed_units(fit)
        if considered is not None:
            more = considered.parameters.prior_sigmas
            unit = np.block(
                [
                    [unit, np.zeros((len(unit), len(more)))],
                    [np.zeros((len(more), unit.shape[1])), np.diag(more)],
                ]
            )
            sigmas, off = np.concatenate([sigmas, more]), np.concatenate([off, np.zeros(len(more))])

        def constant_and_partials(rows: Rows) -> Floats:
            columns = [np.ones((len(rows), 1)), fit.linearization.partials(rows)[:, free]]
            return np.hstack(columns if considered is None else [*columns, considered.partials(rows)])

        series = independent_series(order, fit.noise, fit.used)
        points = points_of(series, column(fit.residual_m), np.zeros((0, 0)))
        place, code, sums = _of_each_link(series, order, constant_and_partials)
        partials = np.zeros((len(points.gain), sums.shape[1] - 1))
        np.add.at(partials, place, sums[:, 1:])
        values = np.hstack([sums[:, :1], sums[:, 1:] @ unit[:, :width]])
        known = np.isfinite(sigmas)
        prior = np.column_stack([off, unit])[known] / sigmas[known, None]
        points = replace(points, unit=partials @ unit)
        noise = noise_of(replace(points, unit=points.unit[:, :width]))
        problem = cls(points, prior, place, code, values, roots=())
        return problem._with_noise(noise, np.zeros(unit.shape[1]))

    def _with_noise(self, noise: Mapping[str, SeriesNoise], estimate: Floats) -> BinnedProblem:
        """Return the problem with the noise of each series, white where none is given."""
        # A series has more where its residuals stay correlated for longer than its noise has it.
        points, roots = self.points, []
        for k, one in enumerate(points.series):
            of, known = points.of(k), noise.get(one.key) or _white(points, k, estimate)
            each, width_s = np.eye(of.stop - of.start), float(points.width_s[k])
            roots.append(known.whitened(points.step_s[of], points.gain[of], each, width_s))
        first = replace(self, roots=tuple(roots))
        spreads = [_spread(first.left[points.of(k)]) for k in range(len(roots))]
        return replace(self, roots=tuple(r / math.sqrt(s) for r, s in zip(roots, spreads, strict=True)))

    def columns(
        self,
        links: Mapping[int, float],
        span_s: tuple[float, float] = (-np.inf, np.inf),
        parameters: int = 0,
    ) -> Floats:
        """Columns of some links in a span of time: their constants times signs, or their first partials."""
        mine, place, sign = self._of(links)
        time_s = self.points.time_s[place]
        inside = (time_s >= span_s[0]) & (time_s <= span_s[1])
        mine, place, sign = mine[inside], place[inside], sign[inside]
        values = (
            self.values[mine, 1 : 1 + parameters] if parameters else sign[:, None] * self.values[mine, :1]
        )
        found = np.zeros((len(self.whitened), values.shape[1]))
        np.add.at(found, place, values)
        return found

    def times_s(self, links: Iterable[int]) -> Floats:
        """Instants of the points of some links, in order."""
        return np.unique(self.points.time_s[self._of(dict.fromkeys(links, 1.0))[1]])

    def width_s(self, links: Mapping[int, float]) -> float:
        """Longest duration of the bins of some links."""
        return float(np.repeat(self.points.width_s, np.diff(self.points.begin))[self._of(links)[1]].max())

    def _of(self, links: Mapping[int, float]) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
        """Rows of some links, the points that they have part in, and the sign of each."""
        signs = np.full(int(self.code.max()) + 1, np.nan)
        signs[list(links)] = list(links.values())
        mine = np.flatnonzero(~np.isnan(signs[self.code]))
        return mine, self.place[mine], signs[self.code[mine]]

    def _there(self, columns: Floats) -> Iterator[tuple[slice, Floats]]:
        """Points of those series that columns (n + k, w) have part in, and the root of each."""
        n, begin = len(self.points.time_s), self.points.begin
        there = np.logical_or.reduceat(columns[:n].any(axis=1), begin[:-1])
        return ((self.points.of(k), self.roots[k]) for k in np.flatnonzero(there).tolist())

    def test(self, columns: Floats, links: Mapping[int, float] | None = None) -> Verdict | None:
        """Test whether added columns (n + k, w) are zero; None where the parameters leave nothing of them."""
        z = columns.copy()
        for of, root in self._there(columns):
            z[of] = root @ columns[of]
        products = columns.T @ self.weighted
        score, with_partials = products[:, 0] - products[:, 1:] @ self.estimate, products[:, 1:]
        gain = self.inverse @ with_partials.T
        squares = z.T @ z
        size = np.sqrt(np.diag(squares))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        values, axes = np.linalg.eigh((squares - with_partials @ gain) * scale[:, None] * scale)
        told = values > _MIN_SQUARE_FRACTION
        if not told.any():
            return None
        root = scale[:, None] * axes[:, told] / np.sqrt(values[told])
        along = root.T @ score
        estimate, shift = root @ along, -gain @ root @ along
        chi2, dof, inflation = float(along @ along), int(told.sum()), 1.0
        if links:  # errors of a station are in all its baselines, whatever the weights have made of that
            inflation = self._inflation(self.left - self.whitened @ shift - z @ estimate, links)
        return Verdict(chi2, dof, estimate, shift, gain @ root, log_probability(chi2 / inflation, dof))

    def _inflation(self, left: Floats, links: Mapping[int, float]) -> float:
        """Factor on the variance of what links have in common, 1 where they are independent."""
        _, place, sign = self._of(links)
        which = np.unique(self.points.time_s[place], return_inverse=True)[1]
        return _spread(np.bincount(which, sign * left[place]) / np.sqrt(np.bincount(which)))

    def chi2_of_steps(self, links: Mapping[int, float], edges_s: Floats) -> Floats:
        """Chi-square of a step of some links, each by itself, at each of some instants (w,)."""
        # A step is a sum over the points from its instant on: sums from the last point back serve all of them.
        lasting = self.columns(links)[:, 0]
        squares, products = np.zeros(len(edges_s)), np.zeros((len(edges_s), self.weighted.shape[1]))
        for of, root in self._there(lasting[:, None]):
            at = np.searchsorted(self.points.time_s[of], edges_s)
            squares += np.square(_sums_from(root.T * lasting[of, None])).sum(axis=1)[at]
            products += _sums_from(self.weighted[of] * lasting[of, None])[at]
        with_partials = products[:, 1:]
        score = products[:, 0] - with_partials @ self.estimate
        information = squares - np.einsum("wc,wc->w", with_partials @ self.inverse, with_partials)
        told = information > _MIN_SQUARE_FRACTION * squares
        return np.divide(score**2, information, out=np.zeros_like(score), where=told)

    def with_columns(self, columns: Floats) -> BinnedProblem:
        """The problem with further parameters, and the noise that is then left."""
        n = len(self.points.time_s)
        points = replace(self.points, unit=np.hstack([self.points.unit, columns[:n]]))
        larger = replace(self, points=points, prior=np.hstack([self.prior, columns[n:]]))
        return larger._with_noise(noise_of_each(points), larger.estimate)


def noise_of_each(points: Points) -> dict[str, SeriesNoise]:
    """Noise that each series shows by itself: an offset of one of them is none."""
    return noise_of_series(points, ABSORBED_SIGMAS, jointly=False)


def _of_each_link(
    series: IndependentSeries, order: SeriesOrder, rows_of: RowsOf
) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Shares of links in points: the point and the link of each, (m,), and the sums of columns, (m, c)."""
    place, begin, _ = series.bins
    widths, start = np.ones(begin[-1], dtype=np.intp), 0
    for one in series.whitener.structures:
        widths[place[start : start + one.rows.size]] = one.rows.size // len(one.rows)
        start += one.rows.size
    first = np.cumsum(widths) - widths
    code, sums, start = np.empty(widths.sum(), dtype=np.intp), np.zeros((0, 0)), 0
    for one in series.whitener.structures:
        width = one.rows.size // len(one.rows)
        for part in one.parts():
            rows = one.rows[part].ravel()
            values, at = rows_of(rows), first[place[start : start + len(rows)]]
            sums = sums if start else np.zeros((len(code), values.shape[1]))
            start += len(rows)
            for j in range(width):
                mine = np.arange(len(rows)) % width == j
                code[at + j] = np.repeat(order.code[rows[mine]], width)
                add_rows(sums, at + j, one.whiten(part, values * mine[:, None]))
    of_each = np.repeat(np.arange(begin[-1]), widths)
    return of_each, code, sums / np.sqrt(np.bincount(place))[of_each, None]


def _sums_from(values: Floats) -> Floats:
    """Sums of values (n, w) from each row on, and of none, shape (n + 1, w)."""
    return np.vstack([np.cumsum(values[::-1], axis=0)[::-1], np.zeros(values.shape[1])])


def _white(points: Points, k: int, estimate: Floats) -> SeriesNoise:
    """Noise of a series that is white, as large as what an estimate leaves, or as stated where observations are few."""
    part, count = points.of(k), int(points.count[k])
    left = points.residual[part] - points.unit[part] @ estimate
    inside = float(points.squares[k] - np.square(points.residual[part]).sum())
    variance = (inside + float(left @ left)) / count
    if count < _MIN_VARIANCE_OBSERVATIONS or not variance > 0.0:
        variance = max(variance, 1.0)
    return SeriesNoise(variance, np.ones(1), np.zeros(1))


def _spread(independent: Floats) -> float:
    """Variance of what should be independent and of unit variance, from sums over some time: 1 or more."""
    # About their median and by the median of the squares, so that what does not fit hardly hides itself.
    batches = len(independent) // _BATCH_POINTS
    if batches < _MIN_BATCHES:
        return 1.0
    begin = np.arange(batches) * _BATCH_POINTS
    sums = np.add.reduceat(independent, begin) / np.sqrt(np.diff(np.append(begin, len(independent))))
    squares = np.square(sums - np.median(sums))
    return max(1.0, float(np.median(squares)) / _MEDIAN_CHI2_1)


def log_probability(chi2: float, dof: int) -> float:
    """Logarithm of the probability that chi-square is larger by chance."""
    from scipy.special import gammaincc, gammaln

    found = float(gammaincc(0.5 * dof, 0.5 * chi2))
    if found > 1e-280:
        return math.log(found)
    half = 0.5 * chi2
    return -half + (0.5 * dof - 1.0) * math.log(half) - float(gammaln(0.5 * dof))
