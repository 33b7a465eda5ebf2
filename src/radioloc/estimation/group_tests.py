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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.gauss_markov import Points, SeriesNoise, noise_of_series
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.estimation.series import Batch, SeriesOrder, points_of, series_of
from radioloc.estimation.time_correlation import ABSORBED

_Floats = NDArray[np.float64]

_TOLD = 1e-6
"""Least part of the square of a column that the parameters must leave of it for it to be tested."""
_BATCH, _FEWEST_BATCHES = 10, 5
"""Points that are summed to see whether residuals stay alike, and fewest sums that tell."""
_MEDIAN_OF_SQUARE = 0.4549
"""Of a normal variable of unit variance."""
_ENOUGH = 20
"""Observations from which the variance of a series is told."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What a test says of added columns."""

    chi2: float
    dof: int
    estimate: _Floats  # (k,)
    shift: _Floats  # (c,), of the parameters
    root_of_shift: _Floats  # (c, dof), square root of the covariance of that shift where nothing is wrong
    inflation: float = 1.0  # of the variance, by what the residuals of several series have in common

    @property
    def log_chance(self) -> float:
        """Logarithm of the probability that chance alone makes it as large."""
        return log_probability(self.chi2 / self.inflation, self.dof)


@dataclass(frozen=True, slots=True, eq=False)
class LinkPart:
    """What single links have in some of the points."""

    rows: slice
    code: NDArray[np.intp]  # (m,), series of single observations
    values: _Floats  # (m, 1 + c), a constant of the link, and its partials


@dataclass(frozen=True, slots=True, eq=False)
class BinnedProblem:
    """A fit in n points, bins of observations over the root of their count, and k a-priori values.

    Columns to be added have a row for each of these, n + k, and are not whitened.
    """

    points: Points
    prior: _Floats  # (k, 1 + c), residual and partials over the sigmas
    parts: tuple[LinkPart, ...]
    noise: tuple[SeriesNoise, ...]  # of each series of the points
    whitened: _Floats  # (n + k, 1 + c), residual and partials
    inverse: _Floats  # (c, c), N^-1
    estimate: _Floats  # (c,), u

    @classmethod
    def of(
        cls,
        fit: FitResult,
        order: SeriesOrder,
        noise: Mapping[str, SeriesNoise],
        considered: ConsideredErrors | None = None,
    ) -> BinnedProblem:
        """Bin a fit. Parameters are in coordinates of unit formal covariance, then the considered ones in sigmas."""
        from scipy.linalg import block_diag

        free, sigmas = fit.parameters.free, fit.parameters.prior_sigmas[fit.parameters.free]
        off = (fit.parameters.prior_values - fit.x)[free]
        unit = fit.factor.root_covariance()
        if considered is not None:
            more = considered.parameters.prior_sigmas
            unit = block_diag(unit, np.diag(more))
            sigmas, off = np.concatenate([sigmas, more]), np.concatenate([off, np.zeros(len(more))])

        def constant_and_partials(rows: Rows) -> _Floats:
            columns = [np.ones((len(rows), 1)), fit.linearization.partials(rows)[:, free]]
            return np.hstack(columns if considered is None else [*columns, considered.partials(rows)])

        batches = series_of(order, fit.noise, fit.used)
        parts: list[LinkPart] = []
        partials: list[_Floats] = []
        for batch in batches:
            codes = order.code[batch.rows[batch.begin[:-1]]]
            begin, alone = sum(len(one) for one in partials), list(_links_alone(batch))
            for j, of_link in enumerate(alone):
                one = points_of([of_link], constant_and_partials, unit)
                code = np.repeat(np.resize(codes[:, j], len(one.series)), np.diff(one.begin))
                rows = slice(begin, begin + len(code))
                parts.append(LinkPart(rows, code, np.column_stack([one.residual, one.unit])))
            partials.append(np.sum([part.values[:, 1:] for part in parts[-len(alone) :]], axis=0))
        points = points_of(batches, lambda rows: fit.residual_m[rows, None], np.zeros((0, 0)))
        known = np.isfinite(sigmas)
        prior = np.column_stack([off, unit])[known] / sigmas[known, None]
        points = replace(points, unit=np.concatenate(partials))
        return cls.with_noise(points, prior, tuple(parts), noise, np.zeros(unit.shape[1]))

    @classmethod
    def with_noise(
        cls,
        points: Points,
        prior: _Floats,
        parts: tuple[LinkPart, ...],
        noise: Mapping[str, SeriesNoise],
        estimate: _Floats,
    ) -> BinnedProblem:
        """The problem with each series' noise, white as of an estimate where there is none.

        A series has more where its residuals stay alike for longer than its noise has it.
        """
        of_series = [noise.get(one.key) or _white(points, k, estimate) for k, one in enumerate(points.series)]
        first = cls.solved(points, prior, parts, of_series)
        factors = [_spread(first.left[points.of(k)]) for k in range(len(of_series))]
        larger = [one.times(factor) for one, factor in zip(of_series, factors, strict=True)]
        return cls.solved(points, prior, parts, larger)

    @classmethod
    def solved(
        cls, points: Points, prior: _Floats, parts: tuple[LinkPart, ...], noise: Sequence[SeriesNoise]
    ) -> BinnedProblem:
        """The problem with a noise of each series."""
        raw = np.column_stack([points.residual, points.unit])
        whitened = [_whitened(points, noise, k, raw[points.of(k)]) for k in range(len(noise))]
        both = np.concatenate([*whitened, prior])
        inverse = np.linalg.pinv(both[:, 1:].T @ both[:, 1:], hermitian=True)
        return cls(points, prior, parts, tuple(noise), both, inverse, inverse @ (both[:, 1:].T @ both[:, 0]))

    @property
    def left(self) -> _Floats:
        """Whitened residuals that the estimate leaves, (n + k,)."""
        return np.asarray(self.whitened[:, 0] - self.whitened[:, 1:] @ self.estimate)

    def columns(
        self,
        links: Mapping[int, float],
        span_s: tuple[float | _Floats, float] = (-np.inf, np.inf),
        parameters: int = 0,
    ) -> _Floats:
        """Columns of some links in a span of time: their constants times signs, or their first partials.

        Of several beginnings there is one column for each.
        """
        out = np.zeros((len(self.whitened), parameters or np.size(span_s[0])))
        for part, there, sign in self._of(links):
            time_s = self.points.time_s[part.rows][there, None]
            values = part.values[there, 1 : 1 + parameters] if parameters else sign * part.values[there, :1]
            out[part.rows][there] += values * ((time_s >= span_s[0]) & (time_s <= span_s[1]))
        return out

    def times_s(self, links: Iterable[int]) -> _Floats:
        """Instants of the points of some links, in order."""
        found = [
            self.points.time_s[part.rows][there] for part, there, _ in self._of(dict.fromkeys(links, 1.0))
        ]
        return np.unique(np.concatenate(found))

    def width_s(self, links: Mapping[int, float]) -> float:
        """Longest duration of the bins of some links."""
        of_points = np.repeat(self.points.width_s, np.diff(self.points.begin))
        return max(float(of_points[part.rows][there].max()) for part, there, _ in self._of(links))

    def _of(self, links: Mapping[int, float]) -> Iterator[tuple[LinkPart, NDArray[np.bool_], _Floats]]:
        """Parts that have some links, which of their points these are, and the sign of each (m, 1)."""
        codes, signs = np.array(sorted(links)), np.array([links[code] for code in sorted(links)])
        for part in self.parts:
            there = np.isin(part.code, codes)
            if there.any():
                yield part, there, signs[np.searchsorted(codes, part.code[there]), None]

    def _products(self, columns: _Floats) -> tuple[NDArray[np.intp], _Floats]:
        """Rows that columns have part in, and the columns there, whitened."""
        n = len(self.points.time_s)
        mine = [k for k in range(len(self.noise)) if columns[self.points.of(k)].any()]
        rows = [np.arange(self.points.begin[k], self.points.begin[k + 1]) for k in mine]
        found = [_whitened(self.points, self.noise, k, columns[self.points.of(k)]) for k in mine]
        if columns[n:].any():
            rows, found = [*rows, np.arange(n, len(columns))], [*found, columns[n:]]
        return np.concatenate(rows), np.concatenate(found)

    def test(self, columns: _Floats, links: Mapping[int, float] | None = None) -> Verdict | None:
        """Whether added columns (n + k, w) are zero; None where the parameters leave nothing of them.

        Errors of a station are in all its baselines, whatever the weights have made of that: residuals of links, with
        their signs, are looked through for what they have in common.
        """
        if not columns.any():
            return None
        rows, z = self._products(columns)
        with_partials = z.T @ self.whitened[rows, 1:]
        gain = self.inverse @ with_partials.T
        squares = z.T @ z
        score = z.T @ self.whitened[rows, 0] - with_partials @ self.estimate
        size = np.sqrt(np.diag(squares))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        values, axes = np.linalg.eigh((squares - with_partials @ gain) * scale[:, None] * scale)
        told = values > _TOLD
        if not told.any():
            return None
        root = scale[:, None] * axes[:, told] / np.sqrt(values[told])
        along = root.T @ score
        estimate, shift = root @ along, -gain @ root @ along
        inflation = 1.0
        if links is not None:
            left = self.left - self.whitened[:, 1:] @ shift
            left[rows] -= z @ estimate
            inflation = self._inflation(left, links)
        return Verdict(float(along @ along), int(told.sum()), estimate, shift, gain @ root, inflation)

    def _inflation(self, left: _Floats, links: Mapping[int, float]) -> float:
        """Factor on the variance of what links have in common, 1 where they are independent."""
        found = [
            (self.points.time_s[part.rows][there], sign[:, 0] * left[part.rows][there])
            for part, there, sign in self._of(links)
        ]
        times_s, values = (np.concatenate(column) for column in zip(*found, strict=True))
        which = np.unique(times_s, return_inverse=True)[1]
        return _spread(np.bincount(which, values) / np.sqrt(np.bincount(which)))

    def each(self, columns: _Floats) -> tuple[_Floats, _Floats]:
        """Chi-square of each of some columns alone, and its estimate, (w,)."""
        rows, z = self._products(columns)
        with_partials, squares = z.T @ self.whitened[rows, 1:], np.einsum("nw,nw->w", z, z)
        score = z.T @ self.whitened[rows, 0] - with_partials @ self.estimate
        information = squares - np.einsum("wc,cd,wd->w", with_partials, self.inverse, with_partials)
        told = information > _TOLD * squares
        estimate = np.divide(score, information, out=np.zeros_like(score), where=told)
        return estimate * score, estimate

    def with_columns(self, columns: _Floats) -> BinnedProblem:
        """The problem with further parameters, and the noise that is then left."""
        n = len(self.points.time_s)
        points = replace(self.points, unit=np.hstack([self.points.unit, columns[:n]]))
        prior = np.hstack([self.prior, columns[n:]])
        estimate = self.solved(points, prior, self.parts, self.noise).estimate
        noise = noise_of_series(points, ABSORBED, jointly=False)
        return self.with_noise(points, prior, self.parts, noise, estimate)


def _links_alone(batch: Batch) -> Iterator[Batch]:
    """The batch with one link of those that are combined, the others left out."""
    for j in range(batch.rows.shape[1]):
        of_one = np.zeros_like(batch.whitening)
        of_one[:, :, j] = batch.whitening[:, :, j]
        yield replace(batch, whitening=of_one)


def _whitened(points: Points, noise: Sequence[SeriesNoise], k: int, columns: _Floats) -> _Floats:
    """Columns of the points of a series by the root of the inverse covariance of its noise."""
    part = points.of(k)
    return noise[k].whitened(points.step_s[part], points.gain[part], columns, float(points.width_s[k]))


def _white(points: Points, k: int, estimate: _Floats) -> SeriesNoise:
    """Noise of a series that is white, as large as what an estimate leaves, or as stated where observations are few."""
    part, count = points.of(k), int(points.count[k])
    left = points.residual[part] - points.unit[part] @ estimate
    inside = float(points.squares[k] - np.square(points.residual[part]).sum())
    variance = (inside + float(left @ left)) / count
    if count < _ENOUGH or not variance > 0.0:
        variance = max(variance, 1.0)
    return SeriesNoise(variance, np.ones(1), np.zeros(1))


def _spread(independent: _Floats) -> float:
    """Variance of what should be independent and of unit variance, from sums over some time: 1 or more.

    About their median and by the median of the squares, so that what does not fit hardly hides itself.
    """
    batches = len(independent) // _BATCH
    if batches < _FEWEST_BATCHES:
        return 1.0
    begin = np.arange(batches) * _BATCH
    sums = np.add.reduceat(independent, begin) / np.sqrt(np.diff(np.append(begin, len(independent))))
    squares = np.square(sums - np.median(sums))
    return max(1.0, float(np.median(squares)) / _MEDIAN_OF_SQUARE)


def log_probability(chi2: float, dof: int) -> float:
    """Logarithm of the probability that chi-square is larger by chance."""
    from scipy.special import gammaincc, gammaln

    found = float(gammaincc(0.5 * dof, 0.5 * chi2))
    if found > 1e-280:
        return math.log(found)
    half = 0.5 * chi2
    return -half + (0.5 * dof - 1.0) * math.log(half) - float(gammaln(0.5 * dof))
