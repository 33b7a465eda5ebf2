"""White noise plus a first-order Gauss-Markov process or flicker noise: restricted likelihood, covariance.

The whitened errors of a series have the covariance

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau).

Flicker noise, whose spectral density falls as 1/f, is a sum of such processes of equal variance with correlation times
evenly spaced by logarithm (van der Ziel 1950), up to three times the span of the data. One process alone that is fitted
to it has too little at low frequencies: 95 % ellipses then hold the truth in 65 of 100 trials. A Kalman filter
(Kalman 1960; Tapley, Schutz and Born 2004, section 4.9) turns residuals and design matrix to independent innovations,
so the likelihood is exact and its cost linear in the observations (Schweppe 1965). What the estimated parameters can
absorb is projected out (restricted maximum likelihood, Patterson and Thompson 1971):

    -2 log L = log det V + log det(A^T V^-1 A) + (n - d) log w,    w = r^T P r / (n - d),

for d columns A and V over w. Correlation times tau and ratios c / w are tried on a grid, coarse first.

Short arcs determine w, c and tau poorly. The covariance is therefore the mean over them, with the likelihood times a
weak a-priori density (Bayesian model averaging, Hoeting et al. 1999). That of the sigma of a significant process is
half-Cauchy with the sigma of the residuals (Gelman 2006); otherwise that of the logarithm of c / w is uniform as far as
the residuals. In dense series that of the logarithm of tau is normal about one hour, the
time in which tropospheric and instrumental delays change; nine of ten correlation times are between a quarter of an
hour and four hours. One process and flicker noise are as likely. No test decides between white and correlated noise: at
the 1 % level it misses processes that double the covariance of a day of VLBI (`tests/statistics/test_calibration.py`).
Significant correlation alone changes weights and is reported.

Sigmas are thus right in the mean over noise of the a-priori density, not for each noise. An arc that cannot distinguish
two noises has one covariance for both. Calibrate over drawn noise (`docs/validation.md`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from radioloc.estimation.linearization import gram
from radioloc.vectors import Floats, Indices, Mask

RATIOS = np.logspace(-5.0, 3.0, 33)  # c / w that are tried
_TAU_STEP_DECADES = 0.25  # from one correlation time that is tried to the next
_COARSE_TAU_STEP, _COARSE_RATIO_STEP = 2, 4  # of those every so many are tried first
_FLICKER_RATIO_STEP = 2  # every so many of the ratios are tried for flicker noise
_AVERAGED_RATIO_STEP = 2  # the same step where no correlation is significant
_MIN_AVERAGED_RATIO = 1e-3  # smaller c / w have no effect on a covariance there
_FLICKER_STEP_DECADES = 1.0  # from one correlation time of flicker noise to the next, about
_MAX_FLICKER_SPANS = 3.0  # longest correlation time in spans of the data; longer is constant
_MIN_PARAMETER_CHI2 = 1.0  # by one sigma of a combination of parameters: below, it is not projected out
_MIN_SERIES_CHI2 = 1e-3  # in one series: a smaller value changes no likelihood by more than half of that
_MAX_STACK_ELEMENTS = 2**22  # of innovations of series that are filtered at once, 32 MB
_MAX_LOG_LIKELIHOOD_LOSS = 6.0  # below the largest at which nothing need be looked at
_MIN_VARIANCE_FRACTION = 1e-4  # below which a process is left out of a filter
_MIN_PRODUCT_VARIANCE_FRACTION = 1e-6  # below which a process is left out of products with the covariance
_LOG_BAYES_FACTOR_WHITE = 3.0  # for white noise over another series' noise, to rule that out
DENSE = 3.0
"""Observations in a correlation time, in the mean over a series, from which on its weights allow for the correlation.
Fewer observations, such as laser normal points, have little weight and determine a correlation poorly."""
_MIN_OBSERVATIONS_PER_TAU = 1.0  # for flicker noise, and for averages of noise that is not significant
_TYPICAL_TAU_S = 3600.0  # centre of the a-priori density of correlation times in dense series
_LOG_TAU_SIGMA = 0.8  # standard deviation of their natural logarithm, a factor of 2.2
MIN_POINTS_LEFT = 20  # beyond the number of parameters, for a verdict
_SIGNIFICANCE_LEVEL = 0.01  # from which on weights allow for a correlation and a card reports it


@dataclass(frozen=True, slots=True)
class Series:
    """Identity of a series."""

    key: str  # no key occurs twice
    name: str
    group: str  # series of a group have one tau and one c / w
    kind: str  # of measurement
    shared: str = ""  # common name of combinations of observations that share errors


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Series whose noise is sought, s of them with n points one after another."""

    series: tuple[Series, ...]
    begin: Indices  # (s + 1,), first point of each, and n
    count: Floats  # (s,), observations of each
    squares: Floats  # (s,), sum of squares of the whitened residuals of all observations
    width_s: Floats  # (s,), duration of the bins, s; zero where points are single observations
    step_s: Floats  # (n,), time since the point before of the same series, s
    gain: Floats  # (n,), root of the number of observations that a point is the mean of
    residual: Floats  # (n,), whitened by the stated noise
    unit: Floats  # (n, q), whitened partials with respect to parameters of unit formal covariance
    time_s: Floats = field(default_factory=lambda: np.zeros(0))  # (n,), where it is asked for
    compiled: bool = False  # whether compilation pays, as in one of many trials or in a long arc

    def series_slice(self, k: int) -> slice:
        """Points of a series."""
        return slice(self.begin[k], self.begin[k + 1])


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of a series in units of the stated one."""

    white: float  # w
    tau_s: Floats  # (taus,), s
    coloured: Floats  # (taus,), variances c of processes of these correlation times; their sum is the whole
    is_significant: bool = True  # whether white noise alone is excluded at the significance level
    log_variance: float = 0.0  # variance of the logarithm of the variance that the noise gives to parameters

    @property
    def variance(self) -> float:
        """Variance of a single observation."""
        return self.white + float(self.coloured.sum())

    @cached_property
    def excess(self) -> SeriesNoise:
        """Noise less the variance in the covariance of the estimate: the stated one, or all if not significant."""
        return replace(self, white=self.white - (1.0 if self.is_significant else self.variance))

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
        """Logarithmic mean of the correlation times, s."""
        weight = self.coloured if self.coloured.any() else np.ones(len(self.tau_s))
        return float(np.exp((weight * np.log(self.tau_s)).sum() / weight.sum()))

    def whitening_root(self, step_s: Floats, gain: Floats, width_s: float = 0.0) -> Floats:
        """Root L of the inverse covariance of points, V^-1 = L^T L, lower triangular, (n, n); () of white noise."""
        from scipy.linalg.lapack import dtrtri

        variance = self.coloured * mean_correlation(width_s, self.tau_s)
        lasting = variance > _MIN_VARIANCE_FRACTION * variance.sum()
        if not lasting.any():
            return np.asarray(1.0 / math.sqrt(self.white))
        time_s, covariance = np.cumsum(step_s), self.white * np.eye(len(gain))
        lag_s = np.abs(time_s[:, None] - time_s)
        for process_variance, tau_s in zip(variance[lasting], self.tau_s[lasting], strict=True):
            covariance += process_variance * gain[:, None] * np.exp(-lag_s / tau_s) * gain
        return np.asarray(dtrtri(np.linalg.cholesky(covariance), lower=1)[0])


NO_NOISE = SeriesNoise(0.0, np.zeros(0), np.zeros(0), is_significant=False)
"""In place of the noise of series whose errors are independent and as stated."""


def half_products(
    noise: Sequence[SeriesNoise],
    begin: Indices,
    step_s: Floats,
    gain: Floats,
    columns: Floats,
    width_s: ArrayLike = 0.0,
) -> Floats:
    """Lower triangle of the covariance of the points of series, half its diagonal, times columns (n, m).

    With L the result, the product of columns A with the covariance is A^T L + L^T A.
    """
    from radioloc.estimation._kernels import half_products as compiled

    processes = np.zeros((2, len(noise), max((len(item.tau_s) for item in noise), default=0)))
    variance, tau_s = processes
    for k, item in enumerate(noise):
        variance[k, : len(item.tau_s)], tau_s[k, : len(item.tau_s)] = item.coloured, item.tau_s
    tau_s[tau_s == 0.0] = 1.0  # of no process
    variance *= mean_correlation(np.broadcast_to(width_s, len(noise))[:, None], tau_s)
    variance[variance <= _MIN_PRODUCT_VARIANCE_FRACTION * variance.sum(axis=1, keepdims=True)] = 0.0
    white = np.array([item.white for item in noise])
    columns, decay = np.ascontiguousarray(columns), np.zeros(tau_s.shape[1])
    states, half = np.empty((len(decay), columns.shape[1])), np.empty(columns.shape)
    compiled(begin, step_s, gain, white, processes, columns, decay, states, half)
    return half


@dataclass(frozen=True, slots=True)
class SeriesCorrelation:
    """A series whose residuals are correlated in time."""

    name: str  #: the series
    count: int  #: its used observations
    effective_count: float  #: how many independent ones would give their mean as well
    correlation_time_s: float  #: time in which the correlation of the Gauss-Markov process falls to 1/e, s
    share: float  #: part of the residuals' variance that the process has, 0 to 1


@dataclass(frozen=True, slots=True)
class SeriesWeight:
    """Weight of a series with time-correlated residuals."""

    name: str  #: the series; observations of a type that share errors are one
    count: int  #: its used observations
    #: Factor on the stated sigmas, 1 or more, by which independent observations would determine the mean of the
    #: series equally well.
    sigma_factor: float

    @property
    def weighed_as(self) -> float:
        """Number of independent observations with the same weight."""
        return self.count / self.sigma_factor**2


@dataclass(frozen=True, slots=True, eq=False)
class TimeCorrelation:
    """Effect of correlation in time on the covariance."""

    series: tuple[SeriesCorrelation, ...]  #: series with significant correlation
    #: (p, p), to add to the covariance of the parameters; no variance becomes smaller by it.
    added_covariance: Floats
    #: Of all series that determine theirs by their keys, in their order, in units of the stated noise.
    noise: Mapping[str, SeriesNoise]


def noise_of_series(
    points: Points, sigmas: float | Floats, *, jointly: bool = True, significant: bool = True
) -> dict[str, SeriesNoise]:
    """Noise of series by key, of those that are significantly correlated in time or of all that determine theirs."""
    # Parameters have a-priori sigmas (q,) by which they are projected out: jointly, or of each series by itself where
    # one of them may be off. Noise is averaged over the likelihood, so it holds its own uncertainty.
    groups: dict[str, list[int]] = {}
    for k, series in enumerate(points.series):
        groups.setdefault(series.group, []).append(k)
    noise: dict[int, SeriesNoise] = {}
    length = np.diff(points.begin)
    likelihoods = [
        RestrictedLikelihood.from_points(points, np.array(indices), sigmas, jointly=jointly)
        for indices in groups.values()
        if length[indices].max() >= MIN_POINTS_LEFT
    ]
    likelihoods = [likelihood for likelihood in likelihoods if len(likelihood.indices)]
    for likelihood in likelihoods:
        threshold, tau_s = -math.log(_SIGNIFICANCE_LEVEL / len(likelihoods)), _trial_taus_s(likelihood)
        fitted = _fitted(likelihood, tau_s, threshold)
        noise |= _averaged(likelihood, tau_s) if not fitted and not significant else fitted
    noise |= _adopted_noise(
        points, likelihoods, {k: item for k, item in noise.items() if item.is_significant}
    )
    return {points.series[k].key: noise for k, noise in noise.items()}


@dataclass(frozen=True, slots=True, eq=False)
class RestrictedLikelihood:
    """Restricted likelihood of the noise of s series, of each and of all together, over that of white noise.

    A series of fewer than n points ends in points without effect.
    """

    points: Points
    jointly: bool
    indices: Indices  # (s,), which of the series
    step_s: Floats  # (s, n)
    gain: Floats  # (s, n)
    columns: Floats  # (s, n, r + 1), partials that are projected out, of unit variance, the residuals last
    turned: Floats  # (s, r + 1, m + 1), from the m coefficients that all series have in common to these
    absorbed: Floats  # (s,), points that the parameters take
    bin_squares: Floats  # (s,), squares of the deviations of observations from the means of their bins
    binned: Floats  # (s,), observations less points

    @classmethod
    def from_points(
        cls, points: Points, series_indices: Indices, sigmas: float | Floats, *, jointly: bool = True
    ) -> RestrictedLikelihood:
        """Likelihood of those of some series with enough points left, by the sigmas (q,) of parameters."""
        of_series = [points.series_slice(k) for k in series_indices.tolist()]
        scaled = [points.unit[part] * sigmas for part in of_series]
        grams = np.array([gram(series_effects, series_effects) for series_effects in scaled])
        total = grams.sum(axis=0)
        axes = np.zeros((len(total), 0))
        if np.trace(total) > _MIN_PARAMETER_CHI2:
            squares, axes = np.linalg.eigh(total)
            axes = axes[:, squares > _MIN_PARAMETER_CHI2]
        effects = axes.T @ grams @ axes
        series_squares, series_axes = np.linalg.eigh(effects)
        max_columns = int((series_squares > _MIN_SERIES_CHI2).sum(axis=1).max(initial=0))
        absorbed = (series_squares / (1.0 + series_squares)).sum(axis=1)  # trace of (I + E)^-1 E
        length = np.diff(points.begin)[series_indices]
        is_long = (length - absorbed >= MIN_POINTS_LEFT) & (points.squares[series_indices] > 0.0)
        long = np.flatnonzero(is_long).tolist()
        turned = np.zeros((len(long), max_columns + 1, axes.shape[1] + 1))
        turned[:, :-1, :-1] = np.swapaxes(series_axes[is_long, :, axes.shape[1] - max_columns :], 1, 2)
        turned[:, -1, -1] = 1.0  # residuals stay
        step_s, gain = np.zeros((2, len(long), length[is_long].max(initial=0)))
        columns = np.zeros((*gain.shape, max_columns + 1))
        for k, number in enumerate(long):
            part, n = of_series[number], length[number]
            step_s[k, :n], gain[k, :n] = points.step_s[part], points.gain[part]
            columns[k, :n, :-1] = scaled[number] @ (axes @ turned[k, :-1, :-1].T)
            columns[k, :n, -1] = points.residual[part]
        indices = series_indices[is_long]
        bin_squares = np.maximum(points.squares[indices] - np.square(columns[..., -1]).sum(axis=1), 0.0)
        binned = points.count[indices] - length[is_long]
        return cls(
            points, jointly, indices, step_s, gain, columns, turned, absorbed[is_long], bin_squares, binned
        )

    def select(self, some: Mask | slice) -> RestrictedLikelihood:
        """Likelihood of some of these series."""
        arrays = (getattr(self, item.name)[some] for item in fields(self)[2:])
        return RestrictedLikelihood(self.points, self.jointly, *arrays)

    @property
    def spans_s(self) -> Floats:
        """Durations of the series, s, gaps included, (s,)."""
        return self.step_s.sum(axis=1)

    def evaluate(
        self, tau_s: Floats, ratio: Floats, part: Floats | None = None
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Log likelihoods of each, variances w, log likelihoods of all together, and logarithms of variances.

        They have the shape (s, cells), that of all together (cells,). The last are those that the noise gives to the
        parameters of a series, in the mean, but for a constant.
        """
        # Cells are shapes by ratios: processes of one correlation time, or of several (k, p) with parts of the
        # variance. White noise is a last cell.
        if part is None:
            tau_s = tau_s[:, None]
            part = np.ones(tau_s.shape)
        count, absorbed = self.points.count[self.indices][:, None], self.absorbed[:, None]
        dof = count - absorbed
        if self.points.compiled:
            from radioloc.estimation._kernels import likelihood_grid

            mean = part * mean_correlation(self.points.width_s[self.indices][:, None, None], tau_s)
            turned = self.turned if self.jointly else self.turned[..., :0]
            of_series = np.array([dof[:, 0], self.binned, self.bin_squares])
            arrays = (self.step_s, tau_s, mean, ratio, self.gain, self.columns, turned, of_series)
            # Of one layout, as each other one is compiled for 2.5 s.
            log_determinant, series_log_determinant, white, loss = likelihood_grid(
                *map(np.ascontiguousarray, arrays)
            )
        else:
            log_determinant, series_log_determinant, white, loss = self._terms(tau_s, part, ratio, dof)
        log_white = np.log(white)
        log = -0.5 * (dof * log_white + log_determinant + series_log_determinant)
        log = log[:, :-1] - log[:, -1:]
        log_variance = (log_white - series_log_determinant / np.maximum(absorbed, 1.0))[:, :-1]
        if not self.jointly:
            return log, white[:, :-1], log.sum(axis=0), log_variance
        joint = -0.5 * ((count * log_white + log_determinant).sum(axis=0) + loss)
        return log, white[:, :-1], joint[:-1] - joint[-1], log_variance

    def _terms(self, tau_s: Floats, part: Floats, ratio: Floats, dof: Floats) -> tuple[Floats, ...]:
        """Log-determinants of V over w and of columns, variances w, (s, cells + 1); terms of all columns, (cells + 1,).

        Compiled they take a tenth of the time, but the compiler takes that of a small study to load and three times as
        long the first time.
        """
        elements = self.columns[0].size * (len(tau_s) * len(ratio) + 1)
        at_once = max(1, _MAX_STACK_ELEMENTS // elements)
        stacks = (self.select(slice(k, k + at_once)) for k in range(0, len(self.indices), at_once))
        products_of_stacks = [stack._products(tau_s, part, ratio) for stack in stacks]
        log_determinant, products = map(np.concatenate, zip(*products_of_stacks, strict=True))
        series_log_determinant, squares = _eliminated(products)
        white, in_common = squares / dof, np.zeros(1)
        if not self.jointly:
            return log_determinant, series_log_determinant, white, in_common
        for turned, series_products, variance in zip(self.turned, products, white, strict=True):
            in_common = in_common + turned.T @ (series_products / variance[:, None, None]) @ turned
        shared, squares = _eliminated(in_common)
        return log_determinant, series_log_determinant, white, shared + squares

    def _products(self, tau_s: Floats, part: Floats, ratio: Floats) -> tuple[Floats, Floats]:
        """Log-determinants of V over w (s, cells + 1), and products of columns by its inverse, (s, cells + 1, m, m)."""
        width_s = self.points.width_s[self.indices]
        mean = part * mean_correlation(width_s[:, None, None], tau_s)
        # Within a bin a process acts as white noise.
        white_variance = np.ones((len(width_s), part.shape[0] * len(ratio) + 1))
        white_variance[:, :-1] += ((1.0 - mean.sum(axis=2))[..., None] * ratio).reshape(len(width_s), -1)
        variance = np.zeros((part.shape[1], *white_variance.shape))
        variance[..., :-1] = (np.moveaxis(mean, 2, 0)[..., None] * ratio).reshape(*variance.shape[:2], -1)
        log_determinant, products = filtered(self.step_s, tau_s, variance, self.gain, self.columns)
        log_determinant += self.binned[:, None] * np.log(white_variance)
        products[..., -1, -1] += self.bin_squares[:, None] / white_variance
        return log_determinant, products


def filtered(
    step_s: Floats, tau_s: Floats, stationary: Floats, gain: Floats, columns: Floats
) -> tuple[Floats, Floats]:
    """Log-determinants of covariances (s, cells), and products of columns by their inverses, (s, cells, m, m).

    Kalman filter of s series (s, n) for many noise models at once: cells, the last axis. Observations are
    gain_i s_i + e_i, with e_i white of unit variance and s a sum of p first-order Gauss-Markov processes with the
    correlation times (shapes, p), each shape for equally many cells, and variances (p, s, cells).
    """
    (s, n, m), (p, _, cells), shapes = columns.shape, stationary.shape, len(tau_s)
    decay = np.zeros((n, p, s, cells))  # in the last cell, white noise, and before the first point
    factors = np.exp(-step_s.T[1:, None, :, None] / tau_s.T[:, None])
    decay[1:, ..., :-1] = np.repeat(factors, (cells - 1) // shapes, axis=-1)
    added = stationary * (1.0 - decay**2)
    gain, columns = gain.T[..., None], np.moveaxis(columns, 0, 2)[..., None]
    covariance, state = np.zeros((p, p, s, cells)), np.zeros((m, p, s, cells))
    own_variance = covariance.reshape(p * p, s, cells)[:: p + 1]
    variance, innovation = np.empty((n, s, cells)), np.empty((n, m, s, cells))
    for i in range(n):
        covariance *= decay[i] * decay[i, :, None]
        own_variance += added[i]
        kalman = gain[i] * covariance.sum(axis=1)
        variance[i] = 1.0 + gain[i] * kalman.sum(axis=0)
        weighted = kalman / variance[i]
        covariance -= kalman * weighted[:, None]
        state *= decay[i]
        innovation[i] = columns[i] - gain[i] * state.sum(axis=1)
        state += weighted * innovation[i, :, None]
    innovation /= np.sqrt(variance)[:, None]
    whitened = np.ascontiguousarray(np.moveaxis(innovation, (0, 1), (3, 2)))
    return np.log(variance).sum(axis=0), whitened @ np.swapaxes(whitened, 2, 3)


def _eliminated(products: Floats) -> tuple[Floats, Floats]:
    """Log det(1 + A^T A) and the squares left of r, from products (..., m, m) of columns A and, last, r."""
    augmented = products + np.eye(products.shape[-1])
    augmented[..., -1, -1] = 2.0 * products[..., -1, -1]  # positive definite, even if A explains all of r
    pivots = np.diagonal(np.linalg.cholesky(augmented), axis1=-2, axis2=-1)
    return 2.0 * np.log(pivots[..., :-1]).sum(axis=-1), pivots[..., -1] ** 2 - products[..., -1, -1]


def mean_correlation(width_s: float | Floats, tau_s: Floats) -> Floats:
    """Mean of exp(-|dt| / tau) over pairs of instants of a bin; one for single instants."""
    x = np.maximum(width_s / tau_s, 1e-4)  # below, rounding exceeds the omitted terms
    return np.where(width_s == 0.0, 1.0, 2.0 * (x - 1.0 + np.exp(-x)) / x**2)


def _adopted_noise(
    points: Points, likelihoods: Sequence[RestrictedLikelihood], estimates: dict[int, SeriesNoise]
) -> dict[int, SeriesNoise]:
    """Noise of series too short to show theirs, the mean of their kind.

    White, they would outweigh the others: 15 observations would count as 15, not 2, beside 1200 that count as 8
    (`tests/unit/estimation/test_time_correlation.py`).
    """
    noises_of_kind: dict[str, list[SeriesNoise]] = {}
    for k, noise in estimates.items():
        noises_of_kind.setdefault(points.series[k].kind, []).append(noise)
    means: dict[str, SeriesNoise] = {}
    for kind, noises in noises_of_kind.items():
        tau_s, place = np.unique(np.concatenate([noise.tau_s for noise in noises]), return_inverse=True)
        coloured = np.bincount(place, np.concatenate([noise.coloured for noise in noises])) / len(noises)
        white, variance = np.mean([(item.white, item.log_variance) for item in noises], axis=0).tolist()
        means[kind] = SeriesNoise(white, tau_s, coloured, log_variance=variance)
    kind_of = {
        k: noise.kind for k, noise in enumerate(points.series) if k not in estimates and noise.kind in means
    }
    white_indices = set[int]()
    for likelihood in likelihoods:
        is_short = np.array([k in kind_of for k in likelihood.indices.tolist()])
        if is_short.any():
            chosen = likelihood if is_short.all() else likelihood.select(is_short)
            short_series = replace(chosen, jointly=False)
            mean = means[kind_of[int(short_series.indices[0])]]
            log, *_ = short_series.evaluate(np.array([mean.correlation_time_s]), np.array([mean.ratio]))
            white_indices |= set(short_series.indices[log[:, 0] <= -_LOG_BAYES_FACTOR_WHITE].tolist())
    return {k: means[kind] for k, kind in kind_of.items() if k not in white_indices}


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Noise models that are tried, m of them: one process or flicker noise, and the ratio c / w."""

    ratio: Floats  # (m,)
    tau_s: Floats  # (taus,), correlation times of all models
    shares: Floats  # (m, taus), parts of c

    def mean_noise(
        self,
        likelihood: RestrictedLikelihood,
        joint: Floats,
        white: Floats,
        log_variance: Floats,
        *,
        is_significant: bool,
    ) -> dict[int, SeriesNoise]:
        """Noise of each series, the mean over the models by their logarithmic likelihoods (m,)."""
        # A process far beyond the variance of the residuals must have been absorbed by the parameters (Gelman 2006).
        points, indices = likelihood.points, likelihood.indices
        variance = (points.squares[indices] / points.count[indices])[:, None]
        coloured = white * self.ratio
        weight = np.exp(joint - joint.max()) / (1.0 + coloured / variance)
        if is_significant:
            weight *= np.sqrt(self.ratio)
        weight /= weight.sum(axis=1, keepdims=True)
        mean = (weight * log_variance).sum(axis=1, keepdims=True)
        variances = (weight * (log_variance - mean) ** 2).sum(axis=1).tolist()
        values = (weight * white).sum(axis=1).tolist(), (weight * coloured) @ self.shares, variances
        return {
            k: SeriesNoise(w, self.tau_s, c, is_significant, variance)
            for k, w, c, variance in zip(indices.tolist(), *values, strict=True)
        }


def _observations_per(tau_s: float, likelihood: RestrictedLikelihood) -> float:
    """Mean number of observations of some series in a time, gaps included."""
    return float(likelihood.points.count[likelihood.indices].sum() * tau_s / likelihood.spans_s.sum())


def _log_density_of_tau(likelihood: RestrictedLikelihood, tau_s: Floats) -> Floats:
    """Logarithm of the a-priori density of the logarithm of correlation times; zero for sparse series."""
    if _observations_per(_TYPICAL_TAU_S, likelihood) < _MIN_OBSERVATIONS_PER_TAU:
        return np.zeros(len(tau_s))
    return np.asarray(-0.5 * (np.log(tau_s / _TYPICAL_TAU_S) / _LOG_TAU_SIGMA) ** 2)


def _averaged(likelihood: RestrictedLikelihood, tau_s: Floats) -> dict[int, SeriesNoise]:
    """Mean noise of the series of a group without significant correlation; none of sparse series."""
    if _observations_per(_TYPICAL_TAU_S, likelihood) < _MIN_OBSERVATIONS_PER_TAU:
        return {}
    tau_s = tau_s[::_COARSE_TAU_STEP]
    ratios = RATIOS[RATIOS > _MIN_AVERAGED_RATIO][::_AVERAGED_RATIO_STEP]
    _, white, joint, log_variance = likelihood.evaluate(tau_s, ratios)
    log_density = np.repeat(_log_density_of_tau(likelihood, tau_s), len(ratios))
    joint = joint + log_density
    if np.exp(joint).sum() < np.exp(log_density).sum():  # Bayes factor below one
        return {}
    cells = _Cells(np.tile(ratios, len(tau_s)), tau_s, np.repeat(np.eye(len(tau_s)), len(ratios), axis=0))
    return cells.mean_noise(likelihood, joint, white, log_variance, is_significant=False)


def _fitted(likelihood: RestrictedLikelihood, tau_s: Floats, threshold: float) -> dict[int, SeriesNoise]:
    """Noise of each series of a group; none where the group shows no correlation."""
    from scipy.linalg import block_diag

    coarse_taus_s, coarse_ratios = tau_s[::_COARSE_TAU_STEP], RATIOS[::_COARSE_RATIO_STEP]
    _, _, joint, _ = likelihood.evaluate(coarse_taus_s, coarse_ratios)
    if joint.max() < 0.5 * threshold - 1.0:
        return {}
    best = int(joint.argmax())
    is_likely = joint > joint.max() - _MAX_LOG_LIKELIHOOD_LOSS
    at_tau, at_ratio = np.nonzero(is_likely.reshape(len(coarse_taus_s), -1))
    taus, ratios = (
        slice(max(0, int(at.min() - 1) * step), int(at.max() + 1) * step + 1)
        for at, step in ((at_tau, _COARSE_TAU_STEP), (at_ratio, _COARSE_RATIO_STEP))
    )
    taus_of_flicker_s, part = _flicker_shape(likelihood, tau_s[0])
    wider = slice(
        max(0, ratios.start - _COARSE_RATIO_STEP), ratios.stop + _COARSE_RATIO_STEP, _FLICKER_RATIO_STEP
    )
    density = _log_density_of_tau(likelihood, tau_s)
    # Either is as likely before: cells of both have the same weight together.
    odds = math.log(float(np.exp(density).sum()) * _FLICKER_RATIO_STEP)
    best_tau_s = float(coarse_taus_s[best // len(coarse_ratios)])
    if _observations_per(best_tau_s, likelihood) < _MIN_OBSERVATIONS_PER_TAU:
        wider = slice(0)
    tau_s, density, ratio, flicker_ratio = tau_s[taus], density[taus], RATIOS[ratios], RATIOS[wider]
    tried = [likelihood.evaluate(tau_s, ratio), likelihood.evaluate(taus_of_flicker_s, flicker_ratio, part)]
    _, white, joint, log_variance = (np.concatenate(arrays, axis=-1) for arrays in zip(*tried, strict=True))
    # Two parameters more than white noise: chi-square of two degrees of freedom, 1 - exp(-x / 2).
    if joint.max() < threshold:
        return {}
    joint += np.append(np.repeat(density, len(ratio)), np.full(len(flicker_ratio), odds))
    single = np.repeat(np.eye(len(tau_s)), len(ratio), axis=0)
    cells = _Cells(
        np.concatenate([np.tile(ratio, len(tau_s)), flicker_ratio]),
        np.concatenate([tau_s, taus_of_flicker_s[0]]),
        block_diag(single, np.repeat(part, len(flicker_ratio), axis=0)),
    )
    return cells.mean_noise(likelihood, joint, white, log_variance, is_significant=True)


def _flicker_shape(likelihood: RestrictedLikelihood, least_s: float) -> tuple[Floats, Floats]:
    """Correlation times, up to the longest span, and shares of processes that add up to flicker noise, both (1, p)."""
    span_s = _MAX_FLICKER_SPANS * float(likelihood.spans_s.max())
    p = math.ceil(math.log10(max(span_s / least_s, 10.0)) / _FLICKER_STEP_DECADES) + 1
    tau_s = np.logspace(math.log10(least_s), math.log10(max(span_s, 10.0 * least_s)), p)
    return tau_s[None], np.full((1, p), 1.0 / p)


def _trial_taus_s(likelihood: RestrictedLikelihood) -> Floats:
    """Correlation times that are tried for a group, s, from a step to half the longest span."""
    least_s = min(
        width_s or float(np.median(step_s[step_s > 0.0]))
        for width_s, step_s in zip(
            likelihood.points.width_s[likelihood.indices].tolist(), likelihood.step_s, strict=True
        )
        if step_s.any()
    )
    most_s = max(0.5 * float(likelihood.spans_s.max()), 2.0 * least_s)
    steps = math.ceil(math.log10(most_s / least_s) / _TAU_STEP_DECADES)
    return np.asarray(least_s * (most_s / least_s) ** (np.arange(steps + 1) / steps))
