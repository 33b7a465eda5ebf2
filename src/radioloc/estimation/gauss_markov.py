"""White noise plus a first-order Gauss-Markov process: its restricted likelihood and its inverse covariance.

The whitened errors of a series have the covariance

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau).

A scalar Kalman filter (Kalman 1960; Tapley, Schutz and Born 2004, section 4.9) turns residuals and design matrix to
independent innovations, so the likelihood is exact and its cost linear in the observations (Schweppe 1965). What the
estimated parameters can absorb is projected out (restricted maximum likelihood, Patterson and Thompson 1971):

    -2 log L = log det V + log det(A^T V^-1 A) + (n - d) log w,    w = r^T P r / (n - d),

for d columns A and V over w. Correlation times tau and ratios c / w are tried on a grid, coarse first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.factorization import gram
from radioloc.estimation.statistics import SCALING_PROBABILITY

_Floats = NDArray[np.float64]

RATIOS = np.logspace(-5.0, 3.0, 33)
"""Ratios c / w that are tried."""
_TAU_STEP = 0.25
"""Common logarithm of the factor from one correlation time that is tried to the next."""
_EACH_TAU, _EACH_RATIO = 2, 4
"""Of those every so many are tried first."""
_NEAR = 6.0
"""Logarithm of the likelihood below the largest at which nothing need be looked at."""
_TOLD = 3.0
"""Logarithm of the likelihood by which white noise must be likelier than another series' noise to rule that out."""
FEWEST = 20
"""Points beyond the number of parameters that a verdict takes."""
_CHANCE = 0.01
"""White residuals seem correlated in one fit of a hundred: a correlation that is missed costs a factor on the sigmas,
one that is not there costs little."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """A series whose noise is sought."""

    key: str  # no key occurs twice
    name: str
    group: str  # series of a group have one tau and one c / w, unless a series says otherwise
    kind: str  # of measurement
    count: int  # observations
    step_s: _Floats  # (n,), time since the point before, s
    gain: _Floats  # (n,), root of the number of observations that a point is the mean of
    residual: _Floats  # (n,), whitened by the stated noise
    unit: _Floats  # (n, q), partials, whitened likewise, by parameters of unit formal covariance
    squares: float  # sum of squares of the whitened residuals of all observations
    width_s: float = 0.0  # duration of the bins, s; zero where points are single observations


@dataclass(frozen=True, slots=True, eq=False)
class SeriesNoise:
    """Noise of a series in units of the stated one."""

    white: float  # w
    tau_s: _Floats  # (taus,), s
    coloured: _Floats  # (taus,), variances c of processes of these correlation times; their sum is the whole

    @property
    def share(self) -> float:
        """Part of the variance that is correlated in time."""
        return float(self.coloured.sum()) / (self.white + float(self.coloured.sum()))

    @property
    def ratio(self) -> float:
        """Variance of one Gauss-Markov process in their place over the white one."""
        return float(self.coloured.sum()) / self.white

    @property
    def correlation_time_s(self) -> float:
        """Its correlation time: the mean by logarithms."""
        weight = self.coloured if self.coloured.any() else np.ones(len(self.tau_s))
        return float(np.exp((weight * np.log(self.tau_s)).sum() / weight.sum()))

    def products(self, step_s: _Floats, gain: _Floats, columns: _Floats, width_s: float = 0.0) -> _Floats:
        """Columns (n, m) times the covariance of points, of some gain (n,), times columns, shape (m, m)."""
        from radioloc.estimation._kernels import products

        coloured = self.coloured * _mean_correlation(width_s, self.tau_s)
        matters = coloured > 1e-6 * coloured.sum()
        lasting = np.ascontiguousarray(gain[:, None] * columns)
        process = products(step_s, self.tau_s[matters], coloured[matters], lasting)
        return np.asarray(self.white * gram(columns, columns) + process)

    def whitened(self, step_s: _Floats, columns: _Floats) -> _Floats:
        """Columns (n, m) by the root of the inverse covariance: innovations over their standard deviations."""
        from radioloc.estimation._kernels import whiten

        columns = np.ascontiguousarray(columns)
        innovations = whiten(step_s, self.correlation_time_s, self.ratio, columns, False)
        return np.asarray(innovations / math.sqrt(self.white))

    def weighted(self, step_s: _Floats, columns: _Floats) -> _Floats:
        """Columns (n, m) times the inverse covariance."""
        from radioloc.estimation._kernels import whiten

        innovations = self.whitened(step_s, columns)
        adjoint = whiten(step_s, self.correlation_time_s, self.ratio, innovations, True)
        return np.asarray(adjoint / math.sqrt(self.white))


def noise_of_series(series: Sequence[Points], absorbed: float) -> dict[str, SeriesNoise]:
    """Noise of those series that are significantly correlated in time, by key.

    It is averaged over the likelihood, so it holds how badly it is known. A c far beyond the variance of the
    residuals, which then would all have been absorbed by the parameters, counts for as much less (Gelman 2006).
    """
    columns = _with_absorbed(series, absorbed)
    enough = [
        k for k, one in enumerate(columns) if len(one) - one.shape[1] + 1 >= FEWEST and one[:, -1].any()
    ]
    groups = list(dict.fromkeys(series[k].group for k in enough))
    found: dict[str, SeriesNoise] = {}
    for group in groups:
        mine = [k for k in enough if series[k].group == group]
        threshold = -math.log(_CHANCE / len(groups))
        fitted = _fitted([series[k] for k in mine], [columns[k] for k in mine], threshold, len(enough))
        found |= {series[k].key: noise for k, noise in zip(mine, fitted, strict=False)}
    return found | _taken_over(series, columns, found)


def _with_absorbed(series: Sequence[Points], absorbed: float) -> list[_Floats]:
    """Columns that the parameters can absorb, orthonormal, and the residuals of each series; shape (n, d + 1).

    Those are absorbed that the parameters move by more than one sigma where they are off by `absorbed` of theirs.
    """
    if not series:
        return []
    squares, axes = np.linalg.eigh(np.array([gram(one.unit, one.unit) for one in series]))
    out = []
    for one, square, axis in zip(series, squares, axes, strict=True):
        kept = square * absorbed**2 > 1.0
        both = np.empty((len(one.residual), int(kept.sum()) + 1))
        both[:, :-1] = one.unit @ (axis[:, kept] / np.sqrt(square[kept]))
        both[:, -1] = one.residual
        out.append(both)
    return out


def _taken_over(
    series: Sequence[Points], columns: Sequence[_Floats], found: dict[str, SeriesNoise]
) -> dict[str, SeriesNoise]:
    """Noise of those series that are too short to tell theirs: what others of their kind have on the average.

    As white noise they would outweigh the others.
    """
    more = {}
    for kind in {one.kind for one in series if one.key in found}:
        known = [found[one.key] for one in series if one.kind == kind and one.key in found]
        tau_s = np.exp(np.mean([[math.log(one.correlation_time_s)] for one in known], axis=0))
        coloured = np.mean([[one.coloured.sum()] for one in known], axis=0)
        mean = SeriesNoise(float(np.mean([one.white for one in known])), tau_s, coloured)
        for one, absorbing in zip(series, columns, strict=True):
            if one.kind != kind or one.key in found:
                continue
            short = len(absorbing) - absorbing.shape[1] + 1 < FEWEST or not one.residual.any()
            if short or restricted_likelihood([one], [absorbing], tau_s, np.array([mean.ratio]))[0] > -_TOLD:
                more[one.key] = mean
    return more


def _fitted(
    series: Sequence[Points], columns: Sequence[_Floats], threshold: float, n_series: int
) -> list[SeriesNoise]:
    """Noise of each series of a group; none where the group shows no correlation."""
    tau_s = _tried_taus_s(series)

    def likelihood(taus: slice, ratios: slice) -> tuple[_Floats, _Floats]:
        return restricted_likelihood(series, columns, tau_s[taus], RATIOS[ratios])

    coarse, _ = likelihood(slice(None, None, _EACH_TAU), slice(None, None, _EACH_RATIO))
    together = coarse.sum(axis=0)
    if together.max() < 0.5 * threshold - 1.0:
        return []
    differing = -math.log((1.0 - SCALING_PROBABILITY) / n_series)
    best = np.unravel_index(int(together.argmax()), together.shape)
    alone = [one for one in coarse if one.max() - one[best] > differing - 1.0]
    near = [one > one.max() - _NEAR for one in (together, *alone)]
    at_tau, at_ratio = np.nonzero(np.any(near, axis=0))
    taus, ratios = (
        slice(max(0, int(at.min() - 1) * each), int(at.max() + 1) * each + 1)
        for at, each in ((at_tau, _EACH_TAU), (at_ratio, _EACH_RATIO))
    )
    log, white = likelihood(taus, ratios)
    together = log.sum(axis=0)
    # Two parameters more than white noise: chi-square of two degrees of freedom, 1 - exp(-x / 2).
    if together.max() < threshold:
        return []
    best = np.unravel_index(int(together.argmax()), together.shape)
    found = []
    for k, one in enumerate(series):
        chosen = log[k] if log[k].max() - log[k][best] > differing else together
        coloured = white[k] * RATIOS[ratios]
        variance = one.squares / one.count
        weight = np.exp(chosen - chosen.max()) / (1.0 + coloured / variance)
        weight /= weight.sum()
        found.append(
            SeriesNoise(float((weight * white[k]).sum()), tau_s[taus], (weight * coloured).sum(axis=1))
        )
    return found


def restricted_likelihood(
    series: Sequence[Points], columns: Sequence[_Floats], tau_s: _Floats, ratio: _Floats
) -> tuple[_Floats, _Floats]:
    """Logarithm of the restricted likelihood over that of white noise, and the variance w; (series, taus, ratios).

    `columns` (n, d + 1) are what parameters absorb, orthonormal, and the residuals last. Exact where points are single
    observations. The mean of a bin has less of the process by the mean correlation within it, and the deviations from
    that mean, taken as white, have the rest.
    """
    from radioloc.estimation._kernels import filter_grid

    shape = (len(series), len(tau_s), len(ratio))
    log_determinant, squares = np.empty(shape), np.empty(shape)
    numbers = np.empty((4, len(series), 1, 1))
    mean = np.array([_mean_correlation(one.width_s, tau_s) for one in series])[:, :, None]
    of_points, deviation = mean * ratio, 1.0 + ratio * (1.0 - mean)
    for k, (one, both) in enumerate(zip(series, columns, strict=True)):
        log_determinant[k], squares[k] = filter_grid(one.step_s, one.gain, both, tau_s, of_points[k])
        products = both.T @ both[:, -1]
        inside, absorbed = one.squares - products[-1], products[:-1] @ products[:-1]
        points, parameters = both.shape[0], both.shape[1] - 1
        numbers[:, k, 0, 0] = (
            max(inside, 0.0),
            one.count - points,
            one.count - parameters,
            one.squares - absorbed,
        )
    inside, inside_dof, dof, null = numbers
    white = (squares + inside / deviation) / dof
    log = -0.5 * (dof * np.log(white * dof / null) + log_determinant + inside_dof * np.log(deviation))
    log[np.isnan(log)] = -np.inf
    return log, white


def _mean_correlation(width_s: float, tau_s: _Floats) -> _Floats:
    """Mean of exp(-|dt| / tau) over pairs of instants of a bin, shape (taus,)."""
    x = np.maximum(width_s / tau_s, 1e-4)  # below, rounding is larger than what is left out
    return np.asarray(2.0 * (x - 1.0 + np.exp(-x)) / x**2 if width_s > 0.0 else np.ones(len(tau_s)))


def _tried_taus_s(series: Sequence[Points]) -> _Floats:
    """Correlation times that are tried for a group, s, from a step to half the longest span."""
    least_s = min(
        one.width_s or float(np.median(one.step_s[one.step_s > 0.0])) for one in series if one.step_s.any()
    )
    most_s = max(0.5 * max(float(one.step_s.sum()) for one in series), 2.0 * least_s)
    return np.geomspace(least_s, most_s, 1 + math.ceil(math.log10(most_s / least_s) / _TAU_STEP))
