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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.gauss_markov import Points, SeriesNoise, noise_of_series
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.observation_noise import Rows, column
from radioloc.estimation.series import SeriesOrder, points_of, series_of
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
    log_chance: float  # logarithm of the probability that chance alone makes it as large


@dataclass(frozen=True, slots=True, eq=False)
class BinnedProblem:
    """A fit in n points, bins of observations over the root of their count, and k a-priori values.

    What single links have in the points, of which one of combined observations has several, is m rows of its own.
    Columns to be added have a row for each point and a-priori value, n + k, and are not whitened.
    """

    points: Points
    prior: _Floats  # (k, 1 + c), residual and partials over the sigmas
    place: NDArray[np.intp]  # (m,), point that a link has part in
    code: NDArray[np.intp]  # (m,), series of single observations
    values: _Floats  # (m, 1 + c), a constant of the link, and its partials
    noise: tuple[SeriesNoise, ...]  # of each series of the points
    whitened: _Floats = field(init=False)  # (n + k, 1 + c), residual and partials
    inverse: _Floats = field(init=False)  # (c, c), N^-1
    estimate: _Floats = field(init=False)  # (c,), u

    def __post_init__(self) -> None:
        raw = np.concatenate([np.column_stack([self.points.residual, self.points.unit]), self.prior])
        both = np.zeros_like(raw)
        rows, there = self._whitened(raw)
        both[rows] = there
        inverse = np.linalg.pinv(both[:, 1:].T @ both[:, 1:], hermitian=True)
        object.__setattr__(self, "whitened", both)
        object.__setattr__(self, "inverse", inverse)
        object.__setattr__(self, "estimate", inverse @ (both[:, 1:].T @ both[:, 0]))

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

        bundles = series_of(order, fit.noise, fit.used)
        points = points_of(bundles, column(fit.residual_m), np.zeros((0, 0)))
        found, begin = [], 0
        for bundle in bundles:
            for j, link in enumerate(order.code[bundle.rows[0]].tolist()):
                one = points_of([bundle.of_observation(j)], constant_and_partials, unit)
                there = np.arange(begin, begin + len(one.residual))
                found.append((there, np.full_like(there, link), np.column_stack([one.residual, one.unit])))
            begin = int(there[-1]) + 1
        place, code, values = (np.concatenate(parts) for parts in zip(*found, strict=True))
        partials = np.zeros((begin, unit.shape[1]))
        np.add.at(partials, place, values[:, 1:])
        known = np.isfinite(sigmas)
        prior = np.column_stack([off, unit])[known] / sigmas[known, None]
        problem = cls(replace(points, unit=partials), prior, place, code, values, ())
        return problem._with_noise(noise, np.zeros(unit.shape[1]))

    def _with_noise(self, noise: Mapping[str, SeriesNoise], estimate: _Floats) -> BinnedProblem:
        """The problem with each series' noise, white as of an estimate where there is none.

        A series has more where its residuals stay alike for longer than its noise has it.
        """
        points = self.points
        known = [noise.get(one.key) or _white(points, k, estimate) for k, one in enumerate(points.series)]
        first = replace(self, noise=tuple(known))
        factors = [_spread(first.left[points.of(k)]) for k in range(len(known))]
        return replace(self, noise=tuple(one.times(f) for one, f in zip(known, factors, strict=True)))

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
        from scipy.sparse import csr_array

        mine, place, sign = self._of(links)
        time_s = self.points.time_s[place, None]
        values = (
            self.values[mine, 1 : 1 + parameters] if parameters else sign[:, None] * self.values[mine, :1]
        )
        inside = values * ((time_s >= span_s[0]) & (time_s <= span_s[1]))
        entries = np.ones(len(place)), (place, np.arange(len(place)))
        return np.asarray(csr_array(entries, shape=(len(self.whitened), len(place))) @ inside)

    def times_s(self, links: Iterable[int]) -> _Floats:
        """Instants of the points of some links, in order."""
        return np.unique(self.points.time_s[self._of(dict.fromkeys(links, 1.0))[1]])

    def width_s(self, links: Mapping[int, float]) -> float:
        """Longest duration of the bins of some links."""
        return float(np.repeat(self.points.width_s, np.diff(self.points.begin))[self._of(links)[1]].max())

    def _of(self, links: Mapping[int, float]) -> tuple[NDArray[np.intp], NDArray[np.intp], _Floats]:
        """Rows of some links, the points that they have part in, and the sign of each."""
        mine = np.flatnonzero(np.isin(self.code, list(links)))
        return mine, self.place[mine], np.array([links[code] for code in self.code[mine].tolist()])

    def _whitened(self, columns: _Floats) -> tuple[NDArray[np.intp], _Floats]:
        """Rows that columns (n + k, w) have part in, and the columns there by the root of the inverse covariance."""
        points, n = self.points, len(self.points.time_s)
        rows, found = [np.arange(n, len(columns))], [columns[n:]]
        for k, noise in enumerate(self.noise):
            of = points.of(k)
            if columns[of].any():
                rows.append(np.arange(of.start, of.stop))
                width_s = float(points.width_s[k])
                found.append(noise.whitened(points.step_s[of], points.gain[of], columns[of], width_s))
        return np.concatenate(rows), np.concatenate(found)

    def _scored(self, columns: _Floats) -> tuple[NDArray[np.intp], _Floats, _Floats, _Floats]:
        """As :meth:`_whitened`, then Z^T A and the score s."""
        rows, z = self._whitened(columns)
        with_partials = z.T @ self.whitened[rows, 1:]
        return rows, z, with_partials, z.T @ self.whitened[rows, 0] - with_partials @ self.estimate

    def test(self, columns: _Floats, links: Mapping[int, float] | None = None) -> Verdict | None:
        """Whether added columns (n + k, w) are zero; None where the parameters leave nothing of them.

        Errors of a station are in all its baselines, whatever the weights have made of that: residuals of links, with
        their signs, are looked through for what they have in common.
        """
        rows, z, with_partials, score = self._scored(columns)
        gain = self.inverse @ with_partials.T
        squares = z.T @ z
        size = np.sqrt(np.diag(squares))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        values, axes = np.linalg.eigh((squares - with_partials @ gain) * scale[:, None] * scale)
        told = values > _TOLD
        if not told.any():
            return None
        root = scale[:, None] * axes[:, told] / np.sqrt(values[told])
        along = root.T @ score
        estimate, shift = root @ along, -gain @ root @ along
        chi2, dof, inflation = float(along @ along), int(told.sum()), 1.0
        if links:
            left = self.left - self.whitened[:, 1:] @ shift
            left[rows] -= z @ estimate
            inflation = self._inflation(left, links)
        return Verdict(chi2, dof, estimate, shift, gain @ root, log_probability(chi2 / inflation, dof))

    def _inflation(self, left: _Floats, links: Mapping[int, float]) -> float:
        """Factor on the variance of what links have in common, 1 where they are independent."""
        _, place, sign = self._of(links)
        which = np.unique(self.points.time_s[place], return_inverse=True)[1]
        return _spread(np.bincount(which, sign * left[place]) / np.sqrt(np.bincount(which)))

    def chi2_of_each(self, columns: _Floats) -> _Floats:
        """Chi-square of each of some columns alone, (w,)."""
        _, z, with_partials, score = self._scored(columns)
        squares = np.einsum("nw,nw->w", z, z)
        information = squares - np.einsum("wc,cd,wd->w", with_partials, self.inverse, with_partials)
        told = information > _TOLD * squares
        return np.divide(score**2, information, out=np.zeros_like(score), where=told)

    def with_columns(self, columns: _Floats) -> BinnedProblem:
        """The problem with further parameters, and the noise that is then left."""
        n = len(self.points.time_s)
        points = replace(self.points, unit=np.hstack([self.points.unit, columns[:n]]))
        larger = replace(self, points=points, prior=np.hstack([self.prior, columns[n:]]))
        return larger._with_noise(noise_of_series(points, ABSORBED, jointly=False), larger.estimate)


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
