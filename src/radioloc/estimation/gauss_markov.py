"""White noise plus a first-order Gauss-Markov process or flicker noise: restricted likelihood, covariance.

The whitened errors of a series have the covariance

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau).

Flicker noise, whose spectral density falls as 1/f, is a sum of such processes of equal variance with correlation times
evenly spaced by logarithm (van der Ziel 1950), up to three times the span of the data. One process alone that is fitted
to it has too little at low frequencies, which is what an estimate is uncertain by. A Kalman filter (Kalman 1960;
Tapley, Schutz and Born 2004, section 4.9) turns residuals and design matrix to independent innovations, so the
likelihood is exact and its cost linear in the observations (Schweppe 1965). What the estimated parameters can absorb is
projected out (restricted maximum likelihood, Patterson and Thompson 1971):

    -2 log L = log det V + log det(A^T V^-1 A) + (n - d) log w,    w = r^T P r / (n - d),

for d columns A and V over w. Correlation times tau and ratios c / w are tried on a grid, coarse first. One process and
flicker noise are as likely before the data are seen; the covariance is the mean over both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

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
_EACH_FLICKER = 2
"""Of the ratios every so many are tried for flicker noise."""
_FLICKER_STEP = 1.0
"""Common logarithm of the factor from one correlation time of flicker noise to the next, about."""
_FLICKER_SPANS = 3.0
"""Longest correlation time of flicker noise in spans of the data: what lasts longer is the same all the time."""
_NEAR = 6.0
"""Logarithm of the likelihood below the largest at which nothing need be looked at."""
_MATTERS = 1e-4
"""Part of the variance below which a process is left out of a filter."""
_TOLD = 3.0
"""Logarithm of the likelihood by which white noise must be likelier than another series' noise to rule that out."""
DENSE = 3.0
"""Observations in a correlation time, in the mean over a series, from which on its weights allow for the correlation
and flicker noise is considered. Fewer, such as laser normal points, hardly outweigh anything, and their few sessions
tell a correlation badly."""
FEWEST = 20
"""Points beyond the number of parameters that a verdict takes."""
_CHANCE = 0.01
"""White residuals seem correlated in one fit of a hundred: a correlation that is missed costs a factor on the sigmas,
one that is not there costs little."""


@dataclass(frozen=True, slots=True)
class Series:
    """What a series is and what it is called."""

    key: str  # no key occurs twice
    name: str
    group: str  # series of a group have one tau and one c / w, unless a series says otherwise
    kind: str  # of measurement


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Series whose noise is sought, s of them with n points one after another."""

    series: tuple[Series, ...]
    begin: NDArray[np.intp]  # (s + 1,), first point of each, and n
    count: NDArray[np.intp]  # (s,), observations of each
    squares: _Floats  # (s,), sum of squares of the whitened residuals of all observations
    width_s: _Floats  # (s,), duration of the bins, s; zero where points are single observations
    step_s: _Floats  # (n,), time since the point before of the same series, s
    gain: _Floats  # (n,), root of the number of observations that a point is the mean of
    residual: _Floats  # (n,), whitened by the stated noise
    unit: _Floats  # (n, q), partials, whitened likewise, by parameters of unit formal covariance
    time_s: _Floats = field(default_factory=lambda: np.zeros(0))  # (n,), where it is asked for

    def of(self, k: int) -> slice:
        """Points of a series."""
        return slice(self.begin[k], self.begin[k + 1])


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

        return products(step_s, gain, columns, width_s, self.white, self.tau_s, self.coloured)

    def whitened(self, step_s: _Floats, gain: _Floats, columns: _Floats, width_s: float = 0.0) -> _Floats:
        """Columns (n, m) of points by the root of the inverse covariance: innovations over their sigmas, (n, m)."""
        from radioloc.estimation._kernels import filter_processes, mean_correlation

        variance = self.coloured * mean_correlation(width_s, self.tau_s)
        matters = variance > _MATTERS * variance.sum()
        n, p = len(step_s), int(matters.sum())
        if not p:
            return columns / math.sqrt(self.white)
        process, sign = np.tile(np.arange(p), (n, 1)), np.repeat(gain[:, None], p, axis=1)
        of_processes = (variance[matters], self.tau_s[matters], np.zeros(p), np.diag(variance[matters]))
        state, last_s = np.zeros((p, columns.shape[1])), np.zeros(1)
        white = np.full(n, self.white)
        columns = np.ascontiguousarray(columns)
        return filter_processes(
            np.cumsum(step_s), process, sign, white, np.zeros(n), *of_processes, state, last_s, columns
        )

    def times(self, factor: float) -> SeriesNoise:
        """Noise of a variance that is larger by a factor."""
        return SeriesNoise(factor * self.white, self.tau_s, factor * self.coloured)


@dataclass(frozen=True, slots=True)
class SeriesCorrelation:
    """A series whose residuals are correlated in time.

    Parameters
    ----------
    name : str
        The series.
    count : int
        Its used observations.
    effective_count : float
        How many independent ones would give their mean as well.
    correlation_time_s : float
        Time in which the correlation of the Gauss-Markov process falls to 1/e, s.
    share : float
        Part of the residuals' variance that the process has, 0 to 1.
    """

    name: str
    count: int
    effective_count: float
    correlation_time_s: float
    share: float

    def __str__(self) -> str:
        time_s = self.correlation_time_s
        if time_s < 3600.0:
            text = f"{time_s / 60.0:.2g} min"
        else:
            text = f"{time_s / 3600.0:.2g} h" if time_s < 3.0 * 86400.0 else f"{time_s / 86400.0:.2g} days"
        return (
            f"residuals of {self.name} are correlated in time over {text}: {self.count} observations count as "
            f"{max(self.effective_count, 1.0):.0f}"
        )


@dataclass(frozen=True, slots=True)
class SeriesWeight:
    """What a series with time-correlated residuals weighs.

    Parameters
    ----------
    name : str
        The series; observations of a type that share errors are one.
    count : int
        Its used observations.
    sigma_factor : float
        Factor on the stated sigmas by which independent observations would tell the mean of the series as well, 1 or
        more.
    """

    name: str
    count: int
    sigma_factor: float

    @property
    def weighed_as(self) -> float:
        """How many independent observations would have the same weight together."""
        return self.count / self.sigma_factor**2


@dataclass(frozen=True, slots=True, eq=False)
class TimeCorrelation:
    """What correlation in time adds to the uncertainty.

    Parameters
    ----------
    series : tuple of SeriesCorrelation
        Series with significant correlation.
    added_covariance : ndarray, shape (p, p)
        To add to the covariance of the parameters; no variance becomes smaller by it.
    noise : mapping of str to SeriesNoise
        Of those series by their keys, in their order, in units of the stated noise.
    """

    series: tuple[SeriesCorrelation, ...]
    added_covariance: _Floats
    noise: Mapping[str, SeriesNoise]


def noise_of_series(points: Points, absorbed: float) -> dict[str, SeriesNoise]:
    """Noise of those series that are significantly correlated in time, by key.

    It is averaged over the likelihood, so it holds how badly it is known. A c far beyond the variance of the
    residuals, which then would all have been absorbed by the parameters, counts for as much less (Gelman 2006).
    """
    likelihood = RestrictedLikelihood.of(points, absorbed)
    long = np.flatnonzero(likelihood.points_left >= FEWEST)
    groups: dict[str, list[int]] = {}
    for k in long.tolist():
        groups.setdefault(points.series[k].group, []).append(k)
    found: dict[int, SeriesNoise] = {}
    for mine in groups.values():
        threshold = -math.log(_CHANCE / len(groups))
        found |= _fitted(likelihood, np.array(mine), threshold, len(long))
    found |= _taken_over(likelihood, found)
    return {points.series[k].key: noise for k, noise in found.items()}


@dataclass(frozen=True, slots=True, eq=False)
class RestrictedLikelihood:
    """Restricted likelihood of the noise of each of s series."""

    points: Points
    columns: _Floats  # (n, q + 1), orthonormal columns that the parameters can absorb, the residuals last
    absorbed: NDArray[np.intp]  # (s,), how many of these columns are taken, the last ones
    numbers: _Floats  # (s, 4), as _kernels.likelihoods takes them

    @classmethod
    def of(cls, points: Points, absorbed: float) -> RestrictedLikelihood:
        """Those columns are absorbed that the parameters move by more than one sigma if off by `absorbed` of theirs."""
        s, q = len(points.series), points.unit.shape[1]
        parts = [points.of(k) for k in range(s)]
        grams = np.array([gram(points.unit[part], points.unit[part]) for part in parts]).reshape(s, q, q)
        squares, axes = np.linalg.eigh(grams)
        kept = squares * absorbed**2 > 1.0
        axes = axes / np.sqrt(np.where(kept, squares, 1.0))[:, None, :]
        columns = np.empty((len(points.gain), q + 1))
        columns[:, q] = points.residual
        products = np.empty((s, q + 1))
        for k, part in enumerate(parts):
            columns[part, :q] = points.unit[part] @ axes[k]
            products[k] = points.residual[part] @ columns[part]
        inside = np.maximum(points.squares - products[:, q], 0.0)
        null = points.squares - (products[:, :q] ** 2 * kept).sum(axis=1)
        numbers = np.column_stack([points.count, points.width_s, inside, null])
        return cls(points, columns, kept.sum(axis=1), numbers)

    @property
    def points_left(self) -> NDArray[np.intp]:
        """Points of each series beyond what the parameters absorb, (s,); none where there are no residuals."""
        return np.where(self.points.squares > 0.0, np.diff(self.points.begin) - self.absorbed, 0)

    def of_series(
        self, mine: NDArray[np.intp], tau_s: _Floats, ratio: _Floats, part: _Floats | None = None
    ) -> tuple[_Floats, _Floats]:
        """Logarithm of the likelihood over that of white noise, and the variance w; (series, shapes, ratios).

        A shape is a process of one correlation time, or of several (k, p) that have each a part of its variance (k, p).
        """
        from radioloc.estimation._kernels import likelihoods

        if part is None:
            tau_s = tau_s[:, None]
            part = np.ones(tau_s.shape)

        begin, end = self.points.begin[mine], self.points.begin[mine + 1]
        chosen = (begin, end, self.absorbed[mine], self.numbers[mine])
        tried = (np.ascontiguousarray(tau_s), np.ascontiguousarray(part), np.ascontiguousarray(ratio))
        return likelihoods(*chosen, self.points.step_s, self.points.gain, self.columns, *tried)


def _taken_over(likelihood: RestrictedLikelihood, found: dict[int, SeriesNoise]) -> dict[int, SeriesNoise]:
    """Noise of those series that are too short to tell theirs: what others of their kind have on the average.

    As white noise they would outweigh the others.
    """
    series = likelihood.points.series
    known: dict[str, list[SeriesNoise]] = {}
    for k, noise in found.items():
        known.setdefault(series[k].kind, []).append(noise)
    more: dict[int, SeriesNoise] = {}
    for kind, noises in known.items():
        tau_s, coloured = (
            np.concatenate(c) for c in zip(*((n.tau_s, n.coloured) for n in noises), strict=True)
        )
        mean = SeriesNoise(float(np.mean([one.white for one in noises])), tau_s, coloured / len(noises))
        others = [k for k, one in enumerate(series) if one.kind == kind and k not in found]
        if others:
            shape = np.array([mean.correlation_time_s])
            log, _ = likelihood.of_series(np.array(others), shape, np.array([mean.ratio]))
            short = likelihood.points_left[others] < FEWEST
            more |= {
                k: mean for k, taken in zip(others, short | (log[:, 0, 0] > -_TOLD), strict=True) if taken
            }
    return more


def _fitted(
    likelihood: RestrictedLikelihood, mine: NDArray[np.intp], threshold: float, n_series: int
) -> dict[int, SeriesNoise]:
    """Noise of each series of a group; none where the group shows no correlation."""
    points = likelihood.points
    tau_s = _tried_taus_s(points, mine)
    coarse, _ = likelihood.of_series(mine, tau_s[::_EACH_TAU], RATIOS[::_EACH_RATIO])
    together = coarse.sum(axis=0)
    if together.max() < 0.5 * threshold - 1.0:
        return {}
    differing = -math.log((1.0 - SCALING_PROBABILITY) / n_series)
    best = np.unravel_index(int(together.argmax()), together.shape)
    alone = [one for one in coarse if one.max() - one[best] > differing - 1.0]
    near = [one > one.max() - _NEAR for one in (together, *alone)]
    at_tau, at_ratio = np.nonzero(np.any(near, axis=0))
    taus, ratios = (
        slice(max(0, int(at.min() - 1) * each), int(at.max() + 1) * each + 1)
        for at, each in ((at_tau, _EACH_TAU), (at_ratio, _EACH_RATIO))
    )
    taus_of_flicker_s, part = _flicker_shape(points, mine, tau_s[0])
    # Either is as likely before: cells of both have the same weight together.
    odds = math.log(len(tau_s) * _EACH_FLICKER)
    spans_s = [float(points.step_s[points.of(k)].sum()) for k in mine]
    in_tau = points.count[mine].sum() * tau_s[::_EACH_TAU][best[0]] / sum(spans_s)
    if in_tau < DENSE:
        odds = -math.inf
    wider = slice(max(0, ratios.start - _EACH_RATIO), ratios.stop + _EACH_RATIO, _EACH_FLICKER)
    tau_s, ratio, flicker_ratio = tau_s[taus], RATIOS[ratios], RATIOS[wider]
    shapes = ((tau_s, ratio, None), (taus_of_flicker_s, flicker_ratio, part))
    tried = [likelihood.of_series(mine, *shape) for shape in shapes]
    log, white = (np.concatenate([one[k].reshape(len(mine), -1) for one in tried], axis=1) for k in range(2))
    ratio = np.concatenate([np.tile(ratio, len(tau_s)), flicker_ratio])
    cells = tried[0][0][0].size
    if odds == -math.inf:
        log[:, cells:] = odds
    together = log.sum(axis=0)
    # Two parameters more than white noise: chi-square of two degrees of freedom, 1 - exp(-x / 2).
    if together.max() < threshold:
        return {}
    own = log.max(axis=1) - log[:, int(together.argmax())] > differing
    chosen = np.where(own[:, None], log, together)
    chosen[:, cells:] += odds
    coloured = white * ratio
    variance = (points.squares[mine] / points.count[mine])[:, None]
    weight = np.exp(chosen - chosen.max(axis=1, keepdims=True)) / (1.0 + coloured / variance)
    weight /= weight.sum(axis=1, keepdims=True)
    coloured *= weight
    of_taus = coloured[:, :cells].reshape(len(mine), len(tau_s), -1).sum(axis=2)
    mean_coloured = np.concatenate([of_taus, coloured[:, cells:].sum(axis=1)[:, None] * part], axis=1)
    tau_s = np.concatenate([tau_s, taus_of_flicker_s[0]])
    return {
        k: SeriesNoise(w, tau_s, c)
        for k, w, c in zip(mine.tolist(), (weight * white).sum(axis=1).tolist(), mean_coloured, strict=True)
    }


def _flicker_shape(points: Points, mine: NDArray[np.intp], least_s: float) -> tuple[_Floats, _Floats]:
    """Correlation times, up to the longest span, and shares of processes that add up to flicker noise, both (1, p)."""
    span_s = _FLICKER_SPANS * max(float(points.step_s[points.of(k)].sum()) for k in mine)
    p = math.ceil(math.log10(max(span_s / least_s, 10.0)) / _FLICKER_STEP) + 1
    tau_s = np.logspace(math.log10(least_s), math.log10(max(span_s, 10.0 * least_s)), p)
    return tau_s[None], np.full((1, p), 1.0 / p)


def _tried_taus_s(points: Points, mine: NDArray[np.intp]) -> _Floats:
    """Correlation times that are tried for a group, s, from a step to half the longest span."""
    steps_s = [points.step_s[points.of(k)] for k in mine]
    least_s = min(
        width_s or float(np.median(step_s[step_s > 0.0]))
        for width_s, step_s in zip(points.width_s[mine].tolist(), steps_s, strict=True)
        if step_s.any()
    )
    most_s = max(0.5 * max(float(step_s.sum()) for step_s in steps_s), 2.0 * least_s)
    steps = math.ceil(math.log10(most_s / least_s) / _TAU_STEP)
    return np.asarray(least_s * (most_s / least_s) ** (np.arange(steps + 1) / steps))
