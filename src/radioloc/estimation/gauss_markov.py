"""White noise plus a first-order Gauss-Markov process or flicker noise: restricted likelihood, covariance.

The whitened errors of a series have the covariance

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau).

Flicker noise, whose spectral density falls as 1/f, is a sum of such processes of equal variance with correlation times
evenly spaced by logarithm (van der Ziel 1950), up to three times the span of the data. One process alone that is fitted
to it has too little at low frequencies: 95 % ellipses then hold the truth in 65 of 100 trials
(`tests/statistics/test_correlated_weights.py`). A Kalman filter (Kalman 1960;
Tapley, Schutz and Born 2004, section 4.9) turns residuals and design matrix to independent innovations, so the
likelihood is exact and its cost linear in the observations (Schweppe 1965). What the estimated parameters can absorb is
projected out (restricted maximum likelihood, Patterson and Thompson 1971):

    -2 log L = log det V + log det(A^T V^-1 A) + (n - d) log w,    w = r^T P r / (n - d),

for d columns A and V over w. Correlation times tau and ratios c / w are tried on a grid, coarse first. One process and
flicker noise are as likely before the data are seen; the covariance is the mean over both.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.linearization import gram
from radioloc.vectors import Floats

RATIOS = np.logspace(-5.0, 3.0, 33)  # c / w that are tried
_TAU_STEP_DECADES = 0.25  # from one correlation time that is tried to the next
_COARSE_TAU_STEP, _COARSE_RATIO_STEP = 2, 4  # of those every so many are tried first
_FLICKER_RATIO_STEP = 2  # every so many of the ratios are tried for flicker noise
_FLICKER_STEP_DECADES = 1.0  # from one correlation time of flicker noise to the next, about
_MAX_FLICKER_SPANS = 3.0  # longest correlation time in spans of the data; longer is constant
_MIN_PARAMETER_CHI2 = 1.0  # by one sigma of a combination of parameters: below, it is not projected out
_MIN_SERIES_CHI2 = 1e-3  # likewise in one series: less changes no likelihood by more than half of that
_MAX_LOG_LIKELIHOOD_LOSS = 6.0  # below the largest at which nothing need be looked at
_MIN_VARIANCE_FRACTION = 1e-4  # below which a process is left out of a filter
_LOG_BAYES_FACTOR_WHITE = 3.0  # for white noise over another series' noise, to rule that out
DENSE = 3.0
"""Observations in a correlation time, in the mean over a series, from which on its weights allow for the correlation.
Fewer, such as laser normal points, hardly outweigh anything, and their few sessions tell a correlation badly."""
_MIN_FLICKER_OBSERVATIONS_PER_TAU = 1.0  # fewer than DENSE: the single process most like it may be short
MIN_POINTS_LEFT = 20  # beyond the number of parameters, for a verdict
_SIGNIFICANCE_LEVEL = 0.01  # a correlation missed costs a factor on the sigmas, one that is not there little


@dataclass(frozen=True, slots=True)
class Series:
    """What a series is and what it is called."""

    key: str  # no key occurs twice
    name: str
    group: str  # series of a group have one tau and one c / w
    kind: str  # of measurement
    shared: str = ""  # what combinations of observations that share errors are called together


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Series whose noise is sought, s of them with n points one after another."""

    series: tuple[Series, ...]
    begin: NDArray[np.intp]  # (s + 1,), first point of each, and n
    count: NDArray[np.intp]  # (s,), observations of each
    squares: Floats  # (s,), sum of squares of the whitened residuals of all observations
    width_s: Floats  # (s,), duration of the bins, s; zero where points are single observations
    step_s: Floats  # (n,), time since the point before of the same series, s
    gain: Floats  # (n,), root of the number of observations that a point is the mean of
    residual: Floats  # (n,), whitened by the stated noise
    unit: Floats  # (n, q), partials, whitened likewise, by parameters of unit formal covariance
    time_s: Floats = field(default_factory=lambda: np.zeros(0))  # (n,), where it is asked for

    def of(self, k: int) -> slice:
        """Points of a series."""
        return slice(self.begin[k], self.begin[k + 1])


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of a series in units of the stated one."""

    white: float  # w
    tau_s: Floats  # (taus,), s
    coloured: Floats  # (taus,), variances c of processes of these correlation times; their sum is the whole

    @property
    def share(self) -> float:
        """Part of the variance that is correlated in time."""
        ratio = self.ratio
        return ratio / (1.0 + ratio)

    @cached_property
    def ratio(self) -> float:
        """Variance of one Gauss-Markov process in their place over the white one."""
        return float(self.coloured.sum()) / self.white

    @cached_property
    def correlation_time_s(self) -> float:
        """Its correlation time: the mean by logarithms."""
        weight = self.coloured if self.coloured.any() else np.ones(len(self.tau_s))
        return float(np.exp((weight * np.log(self.tau_s)).sum() / weight.sum()))

    def products(self, step_s: Floats, gain: Floats, columns: Floats, width_s: float = 0.0) -> Floats:
        """Columns (n, m) times the covariance of points, of some gain (n,), times columns, shape (m, m)."""
        from radioloc.estimation._kernels import products

        return products(step_s, gain, columns, width_s, self.white, self.tau_s, self.coloured)

    def whitened(self, step_s: Floats, gain: Floats, columns: Floats, width_s: float = 0.0) -> Floats:
        """Columns (n, m) of points by the root of the inverse covariance: innovations over their sigmas, (n, m)."""
        from radioloc.estimation._kernels import filter_processes, mean_correlation

        variance = self.coloured * mean_correlation(width_s, self.tau_s)
        matters = variance > _MIN_VARIANCE_FRACTION * variance.sum()
        n, p = len(step_s), int(matters.sum())
        if not p:
            return columns / math.sqrt(self.white)
        process, sign = np.tile(np.arange(p), (n, 1)), np.repeat(gain[:, None], p, axis=1)
        none = np.zeros(p)
        of_processes = (variance[matters], self.tau_s[matters], none, none, np.diag(variance[matters]))
        ongoing = np.zeros((p, columns.shape[1])), np.zeros(1), none
        white = np.full(n, self.white)
        columns = np.ascontiguousarray(columns)
        return filter_processes(
            np.cumsum(step_s), process, sign, white, np.zeros(n), *of_processes, *ongoing, columns
        )

    def times(self, factor: float) -> SeriesNoise:
        """Noise of a variance that is larger by a factor."""
        return replace(self, white=factor * self.white, coloured=factor * self.coloured)


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
    added_covariance: Floats
    noise: Mapping[str, SeriesNoise]


def noise_of_series(
    points: Points, sigmas: float | Floats, *, jointly: bool = True
) -> dict[str, SeriesNoise]:
    """Noise of those series that are significantly correlated in time, by key."""
    # Parameters have a-priori sigmas (q,) by which they are projected out: jointly, or of each series by itself where
    # one of them may be off. Noise is averaged over the likelihood, so it holds its own uncertainty; a c far beyond the
    # variance of the residuals, which the parameters would all have absorbed, counts for as much less (Gelman 2006).
    groups: dict[str, list[int]] = {}
    for k, one in enumerate(points.series):
        groups.setdefault(one.group, []).append(k)
    found: dict[int, SeriesNoise] = {}
    length = np.diff(points.begin)
    likelihoods = [
        RestrictedLikelihood.of(points, np.array(mine), sigmas, jointly=jointly)
        for mine in groups.values()
        if length[mine].max() >= MIN_POINTS_LEFT
    ]
    long = [one.among(one.points_left >= MIN_POINTS_LEFT) for one in likelihoods]
    long = [one for one in long if len(one.mine)]
    for likelihood in long:
        threshold = -math.log(_SIGNIFICANCE_LEVEL / len(long))
        found |= _fitted(likelihood, threshold)
    found |= _taken_over(points, long, found)
    return {points.series[k].key: noise for k, noise in found.items()}


@dataclass(frozen=True, slots=True, eq=False)
class RestrictedLikelihood:
    """Restricted likelihood of the noise of s series, of each and of all together, over that of white noise."""

    points: Points
    mine: NDArray[np.intp]  # (s,), which of the series
    begin: NDArray[np.intp]  # (s + 1,), first of their n points each, and n
    step_s: Floats  # (n,)
    gain: Floats  # (n,)
    columns: Floats  # (n, r + 1), of each series' own coefficients of unit variance, the residuals last
    turned: Floats  # (s, r, m), from those m that all series have in common
    numbers: Floats  # (s, 4), as _kernels.likelihoods takes them
    jointly: bool

    @classmethod
    def of(
        cls, points: Points, mine: NDArray[np.intp], sigmas: float | Floats, *, jointly: bool = True
    ) -> RestrictedLikelihood:
        """Parameters have sigmas (q,); combinations that no series feels are left out."""
        rows = np.concatenate([np.arange(points.begin[k], points.begin[k + 1]) for k in mine])
        scaled, residual = points.unit[rows] * sigmas, points.residual[rows]
        begin = np.append(0, np.cumsum(np.diff(points.begin)[mine]))
        of_series = [slice(*ends) for ends in itertools.pairwise(begin.tolist())]
        grams = np.array([gram(scaled[part], scaled[part]) for part in of_series])
        squares, axes = np.linalg.eigh(grams.sum(axis=0))
        axes = axes[:, squares > _MIN_PARAMETER_CHI2]
        felt = axes.T @ grams @ axes
        own, own_axes = np.linalg.eigh(felt)
        most = int((own > _MIN_SERIES_CHI2).sum(axis=1).max(initial=0))
        turned = np.swapaxes(own_axes[:, :, len(axes.T) - most :], 1, 2)
        parts = [scaled[part] @ (axes @ one.T) for part, one in zip(of_series, turned, strict=True)]
        columns = np.column_stack([np.concatenate(parts), residual])
        absorbed = np.trace(np.linalg.solve(np.eye(felt.shape[1]) + felt, felt), axis1=1, axis2=2)
        inside = points.squares[mine] - np.add.reduceat(np.square(residual), begin[:-1])
        numbers = (points.count[mine], absorbed, points.width_s[mine], np.maximum(inside, 0.0))
        of_points = begin, points.step_s[rows], points.gain[rows], columns
        return cls(points, mine, *of_points, np.ascontiguousarray(turned), np.column_stack(numbers), jointly)

    def among(self, some: NDArray[np.bool_]) -> RestrictedLikelihood:
        """Of some of these series."""
        if some.all():
            return self
        length = np.diff(self.begin)
        rows = np.repeat(some, length)
        return replace(
            self,
            mine=self.mine[some],
            begin=np.append(0, np.cumsum(length[some])),
            step_s=self.step_s[rows],
            gain=self.gain[rows],
            columns=self.columns[rows],
            turned=self.turned[some],
            numbers=self.numbers[some],
        )

    @property
    def points_left(self) -> Floats:
        """Points of each series beyond what the parameters absorb, (s,); none where there are no residuals."""
        left = np.diff(self.begin) - self.numbers[:, 1]
        return np.where(self.points.squares[self.mine] > 0.0, left, 0.0)

    def at(self, tau_s: Floats, ratio: Floats, part: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Log likelihoods of each and variances w, (s, cells), and log likelihoods of all together, (cells,)."""
        from radioloc.estimation._kernels import likelihoods

        # Cells are shapes by ratios: processes of one correlation time, or of several (k, p) with parts of the
        # variance.
        if part is None:
            tau_s = tau_s[:, None]
            part = np.ones(tau_s.shape)
        data = (self.begin, self.numbers, self.step_s, self.gain, self.columns)
        cells = (np.ascontiguousarray(one) for one in (tau_s, part, ratio))
        log, white, together = likelihoods(*data, *cells, self.turned)
        return log, white, together if self.jointly else log.sum(axis=0)


def _taken_over(
    points: Points, told: Sequence[RestrictedLikelihood], found: dict[int, SeriesNoise]
) -> dict[int, SeriesNoise]:
    """Noise of series too short to show theirs, the mean of their kind.

    White, they would outweigh the others: 15 observations would count as 15, not 2, beside 1200 that count as 8
    (`tests/unit/estimation/test_time_correlation.py`).
    """
    known: dict[str, list[SeriesNoise]] = {}
    for k, noise in found.items():
        known.setdefault(points.series[k].kind, []).append(noise)
    means: dict[str, SeriesNoise] = {}
    for kind, noises in known.items():
        tau_s, place = np.unique(np.concatenate([one.tau_s for one in noises]), return_inverse=True)
        coloured = np.bincount(place, np.concatenate([one.coloured for one in noises])) / len(noises)
        means[kind] = SeriesNoise(float(np.mean([one.white for one in noises])), tau_s, coloured)
    others = {k: one.kind for k, one in enumerate(points.series) if k not in found and one.kind in means}
    white = set[int]()
    for likelihood in told:
        left = np.array([k in others for k in likelihood.mine.tolist()])
        if left.any():
            some = likelihood.among(left)
            mean = means[others[int(some.mine[0])]]
            log, _, _ = some.at(np.array([mean.correlation_time_s]), np.array([mean.ratio]))
            white |= set(some.mine[log[:, 0] <= -_LOG_BAYES_FACTOR_WHITE].tolist())
    return {k: means[kind] for k, kind in others.items() if k not in white}


def _fitted(likelihood: RestrictedLikelihood, threshold: float) -> dict[int, SeriesNoise]:
    """Noise of each series of a group; none where the group shows no correlation."""
    from scipy.linalg import block_diag

    points, mine = likelihood.points, likelihood.mine
    tau_s = _tried_taus_s(points, mine)
    coarse_taus_s, coarse_ratios = tau_s[::_COARSE_TAU_STEP], RATIOS[::_COARSE_RATIO_STEP]
    _, _, together = likelihood.at(coarse_taus_s, coarse_ratios)
    if together.max() < 0.5 * threshold - 1.0:
        return {}
    best = int(together.argmax())
    near = together > together.max() - _MAX_LOG_LIKELIHOOD_LOSS
    at_tau, at_ratio = np.nonzero(near.reshape(len(coarse_taus_s), -1))
    taus, ratios = (
        slice(max(0, int(at.min() - 1) * each), int(at.max() + 1) * each + 1)
        for at, each in ((at_tau, _COARSE_TAU_STEP), (at_ratio, _COARSE_RATIO_STEP))
    )
    taus_of_flicker_s, part = _flicker_shape(points, mine, tau_s[0])
    # Either is as likely before: cells of both have the same weight together.
    odds = math.log(len(tau_s) * _FLICKER_RATIO_STEP)
    spans_s = [float(points.step_s[points.of(k)].sum()) for k in mine]
    in_tau = points.count[mine].sum() * coarse_taus_s[best // len(coarse_ratios)] / sum(spans_s)
    if in_tau < _MIN_FLICKER_OBSERVATIONS_PER_TAU:
        odds = -math.inf
    wider = slice(
        max(0, ratios.start - _COARSE_RATIO_STEP), ratios.stop + _COARSE_RATIO_STEP, _FLICKER_RATIO_STEP
    )
    tau_s, ratio, flicker_ratio = tau_s[taus], RATIOS[ratios], RATIOS[wider]
    tried = [likelihood.at(tau_s, ratio), likelihood.at(taus_of_flicker_s, flicker_ratio, part)]
    _, white, together = (np.concatenate(both, axis=-1) for both in zip(*tried, strict=True))
    cells = len(tau_s) * len(ratio)
    ratio = np.concatenate([np.tile(ratio, len(tau_s)), flicker_ratio])
    if odds == -math.inf:
        together[cells:] = odds
    # Two parameters more than white noise: chi-square of two degrees of freedom, 1 - exp(-x / 2).
    if together.max() < threshold:
        return {}
    together[cells:] += odds
    variance = (points.squares[mine] / points.count[mine])[:, None]
    coloured = white * ratio
    weight = np.exp(together - together.max()) / (1.0 + coloured / variance)
    weight /= weight.sum(axis=1, keepdims=True)
    single = np.repeat(np.eye(len(tau_s)), cells // len(tau_s), axis=0)
    shares = block_diag(single, np.repeat(part, len(flicker_ratio), axis=0))
    tau_s = np.concatenate([tau_s, taus_of_flicker_s[0]])
    values = (weight * white).sum(axis=1).tolist(), (weight * coloured) @ shares
    return {k: SeriesNoise(w, tau_s, c) for k, w, c in zip(mine.tolist(), *values, strict=True)}


def _flicker_shape(points: Points, mine: NDArray[np.intp], least_s: float) -> tuple[Floats, Floats]:
    """Correlation times, up to the longest span, and shares of processes that add up to flicker noise, both (1, p)."""
    span_s = _MAX_FLICKER_SPANS * max(float(points.step_s[points.of(k)].sum()) for k in mine)
    p = math.ceil(math.log10(max(span_s / least_s, 10.0)) / _FLICKER_STEP_DECADES) + 1
    tau_s = np.logspace(math.log10(least_s), math.log10(max(span_s, 10.0 * least_s)), p)
    return tau_s[None], np.full((1, p), 1.0 / p)


def _tried_taus_s(points: Points, mine: NDArray[np.intp]) -> Floats:
    """Correlation times that are tried for a group, s, from a step to half the longest span."""
    steps_s = [points.step_s[points.of(k)] for k in mine]
    least_s = min(
        width_s or float(np.median(step_s[step_s > 0.0]))
        for width_s, step_s in zip(points.width_s[mine].tolist(), steps_s, strict=True)
        if step_s.any()
    )
    most_s = max(0.5 * max(float(step_s.sum()) for step_s in steps_s), 2.0 * least_s)
    steps = math.ceil(math.log10(most_s / least_s) / _TAU_STEP_DECADES)
    return np.asarray(least_s * (most_s / least_s) ** (np.arange(steps + 1) / steps))
