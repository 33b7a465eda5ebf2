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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.gauss_markov import Points, Series, SeriesNoise, noise_of_series
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.estimation.series import MOST_POINTS, Batch, SeriesOrder, series_of
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
class Piece:
    """Points of one series; of `raw` columns each is the sum of its observations over the root of their count."""

    series: Series
    time_s: _Floats  # (m,)
    width_s: float  # duration of the bins; zero where points are single observations
    count: NDArray[np.intp]  # (m,), observations in each
    inside: float  # sum of squares of the residuals about the points
    raw: _Floats  # (m, 1 + c), residual and partials
    links: Mapping[int, _Floats]  # by series of single observations: constant and partials in it, (m, 1 + c)
    root: _Floats | None  # (m, m), triangle of the noise covariance; none where that is the identity
    residual: _Floats  # (m,), whitened
    partials: _Floats  # (m, c), whitened

    def whitened(self, columns: _Floats) -> _Floats:
        """Columns (m, k) by the root of the inverse covariance of the noise."""
        from scipy.linalg import solve_triangular

        if self.root is None:
            return columns
        return np.asarray(solve_triangular(self.root, columns, lower=True, check_finite=False))

    def with_noise(self, noise: SeriesNoise) -> Piece:
        """Whitened by a noise."""
        root = np.asarray(
            np.linalg.cholesky(_covariance(noise, self.time_s, np.sqrt(self.count), self.width_s))
        )
        made = replace(self, root=root)
        both = made.whitened(self.raw)
        return replace(made, residual=both[:, 0], partials=both[:, 1:])

    def white(self, estimate: _Floats) -> SeriesNoise:
        """Noise that is white, as large as what an estimate leaves, or as stated where observations are few."""
        n = int(self.count.sum())
        left = self.raw[:, 0] - self.raw[:, 1:] @ estimate
        variance = (self.inside + float(left @ left)) / n
        if n < _ENOUGH or not variance > 0.0:
            variance = max(variance, 1.0)
        return SeriesNoise(variance, np.ones(1), np.zeros(1))


@dataclass(frozen=True, slots=True, eq=False)
class Added:
    """Columns to be added: their products with each other, with the partials and with the residuals."""

    columns: Mapping[int, _Floats]  # whitened, (m, k), by piece
    squares: _Floats  # (k, k)
    with_partials: _Floats  # (k, c)
    with_residual: _Floats  # (k,)


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What a test says of added columns."""

    chi2: float
    dof: int
    estimate: _Floats  # (k,)
    shift: _Floats  # (c,), of the parameters
    root_of_shift: _Floats  # (c, dof), square root of the covariance of that shift where nothing is wrong


@dataclass(frozen=True, slots=True, eq=False)
class BinnedProblem:
    """A fit in bins; the last piece are the a-priori values."""

    pieces: tuple[Piece, ...]
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

        def rows_of(rows: Rows) -> _Floats:
            ahead = np.stack([fit.residual_m[rows], np.ones(len(rows))], axis=1)
            columns = [ahead, fit.linearization.partials(rows)[:, free]]
            return np.hstack(columns if considered is None else [*columns, considered.partials(rows)])

        pieces = [
            piece
            for batch in series_of(order, fit.noise, fit.used)
            for piece in _pieces(batch, rows_of, unit, order)
        ]
        known = np.isfinite(sigmas)
        off, partials = off[known] / sigmas[known], unit[known] / sigmas[known, None]
        prior = Piece(
            Series("", "", "", ""), np.zeros(len(off)), 0.0, np.ones(len(off), dtype=np.intp), 0.0,
            np.column_stack([off, partials]), {}, None, off, partials,
        )  # fmt: skip
        return cls.with_noise((*pieces, prior), noise, np.zeros(unit.shape[1]))

    @classmethod
    def with_noise(
        cls, pieces: Sequence[Piece], noise: Mapping[str, SeriesNoise], estimate: _Floats
    ) -> BinnedProblem:
        """The problem with each series' noise, white as of an estimate where there is none."""
        *data, prior = pieces
        data = [one.with_noise(noise.get(one.series.key) or one.white(estimate)) for one in data]
        first = cls.solved((*data, prior))
        return cls.solved((*(_inflated(piece, first.estimate) for piece in data), prior))

    @classmethod
    def solved(cls, pieces: Sequence[Piece]) -> BinnedProblem:
        """The problem of whitened pieces."""
        normal = sum(piece.partials.T @ piece.partials for piece in pieces)
        side = sum(piece.partials.T @ piece.residual for piece in pieces)
        inverse = np.linalg.pinv(np.asarray(normal), hermitian=True)
        return cls(tuple(pieces), inverse, inverse @ side)

    def inflation(self, signs: Mapping[int, float], added: Added, verdict: Verdict) -> float:
        """Factor on the variance of what series have in common once columns are added, 1 where they are independent.

        Errors of a station are in all its baselines, whatever the weights have made of that.
        """
        estimate = self.estimate + verdict.shift
        left = {
            k: self.pieces[k].residual - self.pieces[k].partials @ estimate - columns @ verdict.estimate
            for k, columns in added.columns.items()
        }
        mine = [
            (self.pieces[k].time_s, sign * left[k])
            for k in left
            for code, sign in signs.items()
            if code in self.pieces[k].links
        ]
        times_s, values = (np.concatenate(column) for column in zip(*mine, strict=True))
        which = np.unique(times_s, return_inverse=True)[1]
        return _spread(np.bincount(which, values) / np.sqrt(np.bincount(which)))

    def added(self, columns: Mapping[int, _Floats]) -> Added:
        """Columns to test, from those by piece (m, k), not whitened."""
        found = {k: self.pieces[k].whitened(raw) for k, raw in columns.items()}
        return Added(
            found,
            np.asarray(sum(z.T @ z for z in found.values())),
            np.asarray(sum(z.T @ self.pieces[k].partials for k, z in found.items())),
            np.asarray(sum(z.T @ self.pieces[k].residual for k, z in found.items())),
        )

    def test(self, added: Added) -> Verdict | None:
        """Whether added columns are zero; None where the parameters leave nothing of them."""
        gain = self.inverse @ added.with_partials.T
        information = added.squares - added.with_partials @ gain
        score = added.with_residual - added.with_partials @ self.estimate
        size = np.sqrt(np.diag(added.squares))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        values, axes = np.linalg.eigh(information * scale[:, None] * scale)
        told = values > _TOLD
        if not told.any():
            return None
        root = scale[:, None] * axes[:, told] / np.sqrt(values[told])
        along = root.T @ score
        return Verdict(float(along @ along), int(told.sum()), root @ along, -gain @ root @ along, gain @ root)

    def each(self, columns: Mapping[int, _Floats]) -> tuple[_Floats, _Floats]:
        """Chi-square of each of some columns alone, and its estimate, (k,)."""
        total: list[_Floats] = []
        for k, raw in columns.items():
            piece, z = self.pieces[k], self.pieces[k].whitened(raw)
            mine = np.column_stack([np.einsum("mk,mk->k", z, z), z.T @ piece.residual, z.T @ piece.partials])
            total = [mine] if not total else [total[0] + mine]
        squares, score, with_partials = total[0][:, 0], total[0][:, 1], total[0][:, 2:]
        score = score - with_partials @ self.estimate
        information = squares - np.einsum("kc,cd,kd->k", with_partials, self.inverse, with_partials)
        told = information > _TOLD * squares
        estimate = np.divide(score, information, out=np.zeros_like(score), where=told)
        return estimate * score, estimate

    def with_columns(self, columns: Mapping[int, _Floats]) -> BinnedProblem:
        """The problem with further parameters, of columns that are not whitened, and the noise that is then left."""
        width = next(iter(columns.values())).shape[1]
        pieces = []
        for k, piece in enumerate(self.pieces):
            more = columns.get(k, np.zeros((len(piece.time_s), width)))
            both = np.hstack([piece.raw, more])
            whitened = piece.whitened(both)
            pieces.append(replace(piece, raw=both, residual=whitened[:, 0], partials=whitened[:, 1:]))
        estimate = BinnedProblem.solved(pieces).estimate
        return BinnedProblem.with_noise(pieces, noise_of_series(_points(pieces[:-1]), ABSORBED), estimate)


def _points(pieces: Sequence[Piece]) -> Points:
    """The series as the search for their noise takes them."""
    lengths = [len(piece.time_s) for piece in pieces]
    raw = np.concatenate([piece.raw for piece in pieces])
    squares = [piece.inside + float(piece.raw[:, 0] @ piece.raw[:, 0]) for piece in pieces]
    return Points(
        series=tuple(piece.series for piece in pieces),
        begin=np.concatenate([[0], np.cumsum(lengths)]),
        count=np.array([piece.count.sum() for piece in pieces]),
        squares=np.array(squares),
        width_s=np.array([piece.width_s for piece in pieces]),
        step_s=np.concatenate([np.diff(piece.time_s, prepend=piece.time_s[0]) for piece in pieces]),
        gain=np.sqrt(np.concatenate([piece.count for piece in pieces])),
        residual=raw[:, 0].copy(),
        unit=raw[:, 1:].copy(),
    )


def _pieces(
    batch: Batch, rows_of: Callable[[Rows], _Floats], unit: _Floats, order: SeriesOrder
) -> Iterator[Piece]:
    """The series of a batch in bins, not whitened yet."""
    from radioloc.estimation._kernels import add_to_bins, bins

    k = batch.rows.shape[1]
    place, first, width_s = bins(batch.time_s, batch.begin, MOST_POINTS)
    in_bin = np.bincount(place)
    shape = (k, len(in_bin), 2 + len(unit))
    sums, squares, scratch = np.zeros(shape), np.zeros(shape[:2]), np.zeros(shape[:2])
    alone = [np.zeros(shape) for _ in range(k)] if k > 1 else []
    for part, values in batch.parts(rows_of):
        add_to_bins(place[part], batch.whitening[part], values, sums, squares)
        for j, into in enumerate(alone):
            of_one = np.zeros_like(batch.whitening[part])
            of_one[:, :, j] = batch.whitening[part][:, :, j]
            add_to_bins(place[part], of_one, values, into, scratch)
    gain = np.sqrt(in_bin)[:, None]
    residual, both = sums[..., :1] / gain, [one[..., 1:] / gain for one in (alone or [sums])]
    both = [np.concatenate([one[..., :1], one[..., 1:] @ unit], axis=-1) for one in both]
    time_s = np.bincount(place, batch.time_s) / in_bin
    nothing = np.zeros((0, 0))
    for s in range(len(first) - 1):
        mine = slice(int(first[s]), int(first[s + 1]))
        codes = order.code[batch.rows[batch.begin[s]]].tolist()
        for j in range(k):
            links = {code: one[j, mine] for code, one in zip(codes, both, strict=True)}
            of_all = sum(one[:, 1:] for one in links.values())
            yield Piece(
                batch.series[s * k + j], time_s[mine], float(width_s[s]), in_bin[mine],
                float(squares[j, mine].sum() - np.square(residual[j, mine]).sum()),
                np.hstack([residual[j, mine], of_all]), links, nothing, nothing, nothing,
            )  # fmt: skip


def _inflated(piece: Piece, estimate: _Floats) -> Piece:
    """A series with more noise where its residuals stay alike for longer than its noise has it."""
    factor = np.sqrt(_spread(piece.residual - piece.partials @ estimate))
    return replace(
        piece, root=factor * piece.root, partials=piece.partials / factor, residual=piece.residual / factor
    )


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


def _covariance(noise: SeriesNoise, time_s: _Floats, gain: _Floats, width_s: float) -> _Floats:
    """Covariance of the points of a series, shape (m, m)."""
    from radioloc.estimation._kernels import mean_correlation

    variance = noise.coloured * mean_correlation(width_s, noise.tau_s)
    covariance = noise.white * np.eye(len(gain))
    apart_s = np.abs(time_s[:, None] - time_s)
    for c, tau_s in zip(variance.tolist(), noise.tau_s.tolist(), strict=True):
        if c > 1e-4 * variance.sum():
            covariance += c * np.exp(-apart_s / tau_s) * gain[:, None] * gain
    return covariance


def log_probability(chi2: float, dof: int) -> float:
    """Logarithm of the probability that chi-square is larger by chance."""
    from scipy.special import gammaincc, gammaln

    found = float(gammaincc(0.5 * dof, 0.5 * chi2))
    if found > 1e-280:
        return math.log(found)
    half = 0.5 * chi2
    return -half + (0.5 * dof - 1.0) * math.log(half) - float(gammaln(0.5 * dof))
