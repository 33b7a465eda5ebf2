"""Residuals that stay alike for a while, and what that does to the covariance.

A fit that weighs observations as independent still has the right expectation when their errors last for hours, but its
formal sigmas are too small: a thousand observations of an hour say what a few do. The estimate is left as it is; its
covariance is taken with the errors as the residuals show them (the sandwich of Huber 1967 and White 1980),

    (A^T A + P)^-1 (A^T V A + P) (A^T A + P)^-1,

with the whitened partials A, the information P of the a-priori values, and V the covariance of the whitened errors.
In each series (the residuals of one link and type) V is that of white noise and a first-order Gauss-Markov process,

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau),

found from the residuals by restricted maximum likelihood (Patterson and Thompson 1971), which allows for what the
estimated parameters have taken out of them. All series of a type have one tau and one ratio c / w, which their few
hours tell better together, unless a series says otherwise. The covariance is averaged over the likelihood of these, so
it holds how badly they are known; a c far beyond the variance of the residuals, which then would all have been absorbed
by the parameters, counts for as much less (Gelman 2006). Errors of different series count as independent.

Where the estimate weighs a series with larger sigmas (:mod:`~radioloc.estimation.correlated_weights`), A and V are over
the stated ones as before, and its part of the middle is divided by the fourth power of the factor on them.

All is done with sums over some fifty stretches of time in each series, so the cost is linear in the observations.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.statistics import SCALING_PROBABILITY

_BINS = 56
"""Stretches of time that a series is divided into; gaps do not count. Larger matrices are shared out
between threads by linear algebra libraries, which takes longer than the work."""
_CELLS = 16384
"""Cells of the time line that stretches are made of."""
_CHANCE = 0.01
"""White residuals seem to be alike in one fit of a hundred: a correlation that is missed costs a factor on the sigmas,
one that is not there costs little."""
_FEWEST = 20
"""Stretches beyond the number of parameters that a verdict takes."""
_TAUS = 10
"""Correlation times tried, from half the shortest stretch to half the longest span, evenly by their logarithm."""
_RATIOS = np.logspace(-6.0, 3.0, 46)
"""Ratios c / w that are tried."""
_ABSORBED, _ABSORBED_WEIGHED = 30.0, 3.0
"""Sigmas that the estimate may be off by: what it then takes out of a series is left out of the likelihood. Sigmas by
weights that allow for correlation are nearly those that the estimate has."""
_SCREEN = 1.0
"""Types are looked at closely when a sum over stretches spreads by more than this many standard errors."""


@dataclass(frozen=True, slots=True)
class SeriesCorrelation:
    """A series whose residuals stay alike.

    Parameters
    ----------
    name : str
        The series.
    count : int
        Its used observations.
    effective_count : float
        How many independent ones would give their mean as well.
    correlation_time_s : float
        How long the errors stay alike, s: their correlation falls to 1/e.
    share : float
        Part of the residuals' variance that does so, 0 to 1.
    """

    name: str
    count: int
    effective_count: float
    correlation_time_s: float
    share: float

    def __str__(self) -> str:
        time_s = self.correlation_time_s
        if time_s < 3600.0:
            lasting = f"{time_s / 60.0:.2g} min"
        else:
            lasting = f"{time_s / 3600.0:.2g} h" if time_s < 3.0 * 86400.0 else f"{time_s / 86400.0:.2g} days"
        return (
            f"residuals of {self.name} stay alike for {lasting}: {self.count} observations count as "
            f"{max(self.effective_count, 1.0):.0f}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class TimeCorrelation:
    """What correlation in time adds to the uncertainty.

    Parameters
    ----------
    series : tuple of SeriesCorrelation
        Series with significant correlation.
    added_covariance : ndarray, shape (p, p)
        To add to the covariance of the parameters; no variance becomes smaller by it.
    """

    series: tuple[SeriesCorrelation, ...]
    added_covariance: NDArray[np.float64]


def assess_time_correlation(
    fit: FitResult,
    types: Labels,
    paths: Labels,
    time_s: NDArray[np.float64],
    like: RepeatedSeries | None = None,
) -> TimeCorrelation | None:
    """Find series whose residuals are significantly alike in time, and what that does to the covariance.

    Parameters
    ----------
    fit : FitResult
        Its noise should explain the size of the residuals.
    types, paths : Labels
        Kind and light path of the n observations; those of one kind and path are a series.
    time_s : ndarray, shape (n,)
        When each was made, s from any instant.
    like : RepeatedSeries, optional
        What is known from a fit of the same observations with other errors, which makes this one faster.

    Returns
    -------
    TimeCorrelation or None
        None where no type shows more correlation than chance does in one fit of a hundred.
    """
    if not fit.factor.determined.any() or not fit.used.any():
        return None
    if like is None:
        whitened = _Whitened(fit, types, paths)
        sums = _Sums.of(whitened, time_s)
    else:
        whitened = like.whitened.again(fit)
        sums = like.sums.again(whitened, time_s)
    suspects = {whitened.groups[k] for k in range(len(whitened.names)) if sums.suspicious(k)}
    tried = [k for k in range(len(whitened.names)) if whitened.groups[k] in suspects and sums.enough(k)]
    if not tried:
        return None
    root = fit.factor.root_covariance()
    sums.add_partials(whitened, time_s, root, tried)
    widths_s = [sums.width_s[k] for k in tried]
    longest_s = max(float(np.ptp(sums.time_s[sums.part(k)])) for k in tried)
    taus_s = np.geomspace(0.5 * min(widths_s), max(0.5 * longest_s, max(widths_s)), _TAUS)
    likelihoods = {}
    for k in tried:
        if like is None:
            likelihood = _Likelihood.of(sums, k, taus_s)
        else:
            modes = like.modes(k, taus_s)
            likelihood = None if modes is None else _Likelihood.repeated(sums, k, modes)
        if likelihood is not None:
            likelihoods[k] = likelihood

    found: list[SeriesCorrelation] = []
    added = np.zeros((root.shape[1], root.shape[1]))
    n_groups = len(set(whitened.groups))
    for group in dict.fromkeys(whitened.groups[k] for k in likelihoods):
        mine = [k for k in likelihoods if whitened.groups[k] == group]
        together = np.sum([likelihoods[k].log for k in mine], axis=0)
        # Two parameters more than white noise: chi-square of two degrees of freedom, 1 - exp(-x / 2).
        if together.max() < -math.log(_CHANCE / n_groups):
            continue
        best = np.unravel_index(int(together.argmax()), together.shape)
        for k in mine:
            own = likelihoods[k].log
            differs = own.max() - own[best] > -math.log((1.0 - SCALING_PROBABILITY) / len(likelihoods))
            correlation, more = _series_correlation(
                sums, k, whitened.names[k], likelihoods[k], own if differs else together, taus_s
            )
            found.append(correlation)
            # The partials are over the stated sigmas; those and the errors count by the weights, which are smaller.
            added += more / whitened.sigma_factor[k] ** 4
    if not found:
        return None
    return TimeCorrelation(tuple(found), _in_parameters(fit, root, added))


class RepeatedSeries:
    """What repeated fits of the same observations have in common: stretches of time, and how errors spread over them.

    All is taken from one fit. In another, other observations may be left out as outliers, and weights may be others; as
    long as those are few, the stretches' means and what the parameters absorb are the same but for a part in thousands.

    Parameters
    ----------
    fit : FitResult
        Of observations that share no errors.
    types, paths, time_s
        As for :func:`assess_time_correlation`.
    """

    def __init__(self, fit: FitResult, types: Labels, paths: Labels, time_s: NDArray[np.float64]) -> None:
        whitened = self.whitened = _Whitened(fit, types, paths)
        self.sums = _Sums.of(whitened, time_s)
        filled = [k for k in range(len(whitened.names)) if len(self.sums.count[self.sums.part(k)]) >= _FEWEST]
        self.sums.add_partials(whitened, time_s, fit.factor.root_covariance(), filled)
        self._modes: dict[tuple[int, bytes], _Modes | None] = {}

    def modes(self, code: int, taus_s: NDArray[np.float64]) -> _Modes | None:
        """Those of a series; None where the parameters leave too little of it."""
        key = (code, taus_s.tobytes())
        if key not in self._modes:
            self._modes[key] = _Modes.of(self.sums, code, taus_s)
        return self._modes[key]


def shared_series(kind: str) -> str:
    """What the names of all series begin with that combinations of a kind's observations make."""
    return f"{kind}, combination "


def _in_parameters(
    fit: FitResult, root: NDArray[np.float64], added: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What is added to a unit covariance, in the parameters, shape (p, p).

    A direction in which the errors happen to cancel keeps its white sigma.
    """
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    half = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    free = fit.parameters.free
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = half @ half.T
    lost = np.isinf(np.diag(fit.covariance))
    covariance[lost, :] = 0.0
    covariance[:, lost] = 0.0
    return covariance


class _Whitened:
    """Independent combinations of the used observations, each with the series it belongs to.

    An observation that shares no error belongs to its own series. Those of a block are brought by the symmetric root of
    their covariance and the principal axes of the first block of the same series to combinations that are comparable
    from block to block; each combination is a series of its own.
    """

    def __init__(self, fit: FitResult, types: Labels, paths: Labels) -> None:
        self.fit = fit
        both = types.codes.astype(np.intp) * len(paths.texts) + paths.codes
        kinds, first, codes = np.unique(both, return_index=True, return_inverse=True)
        self.codes = codes.astype(np.int32)
        of_series = [divmod(int(kind), len(paths.texts)) for kind in kinds]
        self.groups = [types.texts[k] for k, _ in of_series]
        self.names = [f"{types.texts[k]} {paths.texts[j]}" for k, j in of_series]
        factor = fit.sigma_factor
        self.sigma_factor = [1.0] * len(kinds) if factor is None else factor[first].tolist()
        self._combinations = fit.noise.among(fit.used)
        self._classes: dict[tuple[int, ...], tuple[int, NDArray[np.float64]]] = {}

    def again(self, fit: FitResult) -> _Whitened:
        """The same series in another fit, of observations that share no errors."""
        made = copy.copy(self)
        made.fit, made._combinations = fit, fit.noise.among(fit.used)
        return made

    def parts(
        self,
    ) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64] | None, NDArray[np.float64]]]:
        """Rows (m,), series (m,), rotations (b, k, k) or None, and sigmas (m,) or weights of the rotations."""
        for rows, block in self._combinations.rows():
            if block is None:
                yield rows, self.codes[rows].astype(np.intp), None, 1.0 / self.fit.noise.own_m[rows]
                continue
            order = np.argsort(self.codes[rows], axis=1, kind="stable")
            rows = np.take_along_axis(rows, order, axis=1)
            axes = np.take_along_axis(block.axes, order[:, :, None], axis=1)
            kinds, which = np.unique(self.codes[rows], axis=0, return_inverse=True)
            which = which.ravel()
            first = np.empty(len(kinds), dtype=np.intp)
            common = np.empty((len(kinds), *axes.shape[1:]))
            for k in np.argsort([int(np.argmax(which == k)) for k in range(len(kinds))], kind="stable"):
                key = tuple(kinds[k].tolist())
                if key not in self._classes:
                    at = int(np.argmax(which == k))
                    self._classes[key] = (len(self.names), axes[at])
                    self._name(key, block.combined_m[at])
                first[k], common[k] = self._classes[key]
            rotation = np.swapaxes(common[which], 1, 2) @ axes
            # Along the block's own axes over their sigmas, back to the observations, and along the common axes.
            whitening = (rotation / block.combined_m[:, None, :]) @ np.swapaxes(axes, 1, 2)
            codes = first[which][:, None] + np.arange(rows.shape[1])
            yield rows.ravel(), codes.ravel(), whitening, np.ones(0)

    def _name(self, key: tuple[int, ...], combined_m: NDArray[np.float64]) -> None:
        """Names and groups of the combinations of a kind of block: those of like sigma go together."""
        kind = self.groups[key[0]]
        for j, sigma_m in enumerate(combined_m.tolist()):
            self.names.append(f"{shared_series(kind)}{j + 1} of {len(key)} that share errors")
            self.sigma_factor.append(self.sigma_factor[key[0]])
            self.groups.append(f"{kind} {key} {round(2.0 * math.log(sigma_m))}")

    @staticmethod
    def apply(
        values: NDArray[np.float64], whitening: NDArray[np.float64] | None, weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Values (m, c) whitened."""
        if whitening is None:
            return values * weight[:, None]
        blocks = values.reshape(len(whitening), whitening.shape[1], -1)
        return np.asarray((whitening @ blocks).reshape(values.shape))


class _Sums:
    """Sums over stretches of time of all series, one after the other.

    Attributes
    ----------
    starts : ndarray, shape (series + 1,)
        Where the stretches of each series begin.
    count, time_s, residual : ndarray, shape (stretches,)
        Combinations in each, their mean time, the sum of their whitened residuals.
    width_s : ndarray, shape (series,)
        Longest duration of a stretch.
    squares : ndarray, shape (series,)
        Sum of squares of the whitened residuals.
    partials : ndarray, shape (stretches, q)
        Sum of whitened partials by parameters of unit formal covariance.
    products : dict of int to ndarray, shape (q, q)
        Sum of products of the same.
    absorbed : float
        Sigmas that the parameters may be off by.
    """

    def __init__(self, n_series: int, first_s: float, step_s: float) -> None:
        self.n_series, self._first_s, self._step_s = n_series, first_s, step_s
        self.starts = np.zeros(n_series + 1, dtype=np.intp)
        self.width_s = np.zeros(n_series)
        self.squares = np.zeros(n_series)
        self.count = self.time_s = self.residual = np.zeros(0)
        self.partials = np.zeros((0, 0))
        self.products: dict[int, NDArray[np.float64]] = {}
        self.absorbed = _ABSORBED
        self._bin_of_cell = np.zeros((0, 0), dtype=np.int32)

    @classmethod
    def of(cls, whitened: _Whitened, time_s: NDArray[np.float64]) -> _Sums:
        """Divide all series and sum their residuals."""
        used = whitened.fit.used
        first_s, last_s = float(time_s[used].min()), float(time_s[used].max())
        step_s = (last_s - first_s) * (1.0 + 1e-9) / _CELLS or 1.0
        counts: dict[int, NDArray[np.intp]] = {}
        for rows, codes, _, _ in whitened.parts():
            cells = ((time_s[rows] - first_s) / step_s).astype(np.intp)
            for code in np.flatnonzero(np.bincount(codes)).tolist():
                more = np.bincount(cells[codes == code], minlength=_CELLS)
                counts[code] = counts[code] + more if code in counts else more
        made = cls(len(whitened.names), first_s, step_s)
        made._bin_of_cell = np.zeros((made.n_series, _CELLS), dtype=np.int32)
        total = 0
        for code in range(made.n_series):
            filled = np.flatnonzero(counts.get(code, np.zeros(0, dtype=np.intp)))
            if len(filled):
                place, width = _stretches(filled)
                made._bin_of_cell[code, filled] = total + place
                made.width_s[code] = width * step_s
                total += int(place[-1]) + 1
            made.starts[code + 1] = total
        made.count, made.time_s, made.residual = np.zeros(total), np.zeros(total), np.zeros(total)
        for rows, codes, whitening, weight in whitened.parts():
            into = made._into(codes, time_s[rows])
            z = whitened.apply(whitened.fit.residual_m[rows, None], whitening, weight)[:, 0]
            made.count += np.bincount(into, minlength=total)
            made.time_s += np.bincount(into, time_s[rows], minlength=total)
            made.residual += np.bincount(into, z, minlength=total)
            made.squares += np.bincount(codes, z * z, minlength=made.n_series)
        made.time_s /= made.count
        return made

    def again(self, whitened: _Whitened, time_s: NDArray[np.float64]) -> _Sums:
        """The same stretches with the residuals of another fit."""
        made = copy.copy(self)
        made.residual, made.squares = np.zeros_like(self.residual), np.zeros(self.n_series)
        made.count = np.zeros_like(self.count)
        for rows, codes, whitening, weight in whitened.parts():
            z = whitened.apply(whitened.fit.residual_m[rows, None], whitening, weight)[:, 0]
            into = self._into(codes, time_s[rows])
            made.residual += np.bincount(into, z, minlength=len(self.count))
            made.count += np.bincount(into, minlength=len(self.count))
            made.squares += np.bincount(codes, z * z, minlength=self.n_series)
        made.count = np.maximum(made.count, 1e-3)  # a stretch of nothing but outliers says nothing
        return made

    def part(self, code: int) -> slice:
        """Stretches of a series."""
        return slice(int(self.starts[code]), int(self.starts[code + 1]))

    def enough(self, code: int) -> bool:
        """Whether a series has stretches enough for a verdict."""
        return int(self.starts[code + 1] - self.starts[code]) >= _FEWEST and self.variance(code) > 0.0

    def _into(self, codes: NDArray[np.intp], time_s: NDArray[np.float64]) -> NDArray[np.int32]:
        return self._bin_of_cell[codes, ((time_s - self._first_s) / self._step_s).astype(np.intp)]

    def variance(self, code: int) -> float:
        """Mean square of a series' whitened residuals."""
        return float(self.squares[code] / max(self.count[self.part(code)].sum(), 1.0))

    def suspicious(self, code: int) -> bool:
        """Whether sums over stretches, or over some stretches together, spread more than white ones would."""
        if not self.enough(code):
            return False
        part, variance = self.part(code), self.variance(code)
        count, total = self.count[part], self.residual[part]
        while len(count) >= 5:
            spread = float((total**2 / (variance * count)).mean())
            if spread > 1.0 + _SCREEN * math.sqrt(2.0 / len(count)):
                return True
            even = len(count) // 2 * 2
            count, total = (column[:even].reshape(-1, 2).sum(axis=1) for column in (count, total))
        return False

    def add_partials(
        self,
        whitened: _Whitened,
        time_s: NDArray[np.float64],
        root: NDArray[np.float64],
        tried: list[int],
    ) -> None:
        """Sum the partials of some series by parameters of unit covariance."""
        fit, wanted = whitened.fit, np.zeros(self.n_series, dtype=bool)
        wanted[tried] = True
        free = np.flatnonzero(fit.parameters.free)
        q, total = root.shape[1], len(self.count)
        self.partials = np.zeros((total, q))
        self.absorbed = _ABSORBED if fit.sigma_factor is None else _ABSORBED_WEIGHED
        self.products = {code: np.zeros((q, q)) for code in tried}
        for rows, codes, whitening, weight in whitened.parts():
            if not wanted[codes].any():
                continue
            unit = whitened.apply(fit.linearization.partials(rows)[:, free], whitening, weight) @ root
            into = self._into(codes, time_s[rows])
            for k in range(q):
                self.partials[:, k] += np.bincount(into, unit[:, k], minlength=total)
            for code in np.flatnonzero(np.bincount(codes, minlength=len(wanted)) * wanted).tolist():
                mine = unit[codes == code]
                self.products[code] += np.einsum("ni,nj->ij", mine, mine)


def _stretches(filled: NDArray[np.intp]) -> tuple[NDArray[np.intp], float]:
    """Divide filled cells to about :data:`_BINS` stretches: place of each cell, and a stretch's length in cells.

    A stretch is so long, and ends at any gap of its length, so gaps take no stretches.
    """
    apart = np.diff(filled).astype(np.float64)
    width = max(float(apart.sum()) / _BINS, 1.0)
    for _ in range(40):
        narrower = max(float(np.minimum(apart, width).sum()) / _BINS, 1.0)
        if narrower > 0.999 * width:
            break
        width = narrower
    clock = np.concatenate([[0.0], np.cumsum(np.minimum(apart, width))])
    _, place = np.unique(np.floor(clock / width * (1.0 + 1e-12)), return_inverse=True)
    return place, width


@dataclass(frozen=True, slots=True, eq=False)
class _Modes:
    """How errors that last spread over the stretches of a series, what the parameters can absorb projected out.

    Parameters
    ----------
    kept : ndarray, shape (b, d)
        Basis of what is left, in sums over those roots.
    axes : ndarray, shape (taus, d, d)
        Principal axes of the correlations, in columns.
    inverse_spread : ndarray, shape (taus, ratios, d)
        One over (variance along them over w).
    kernels : ndarray, shape (taus, b, b)
        Correlations between the stretches.
    log_spread : ndarray, shape (taus, ratios)
        Sum of the logarithms of variances over w.
    """

    kept: NDArray[np.float64]
    axes: NDArray[np.float64]
    inverse_spread: NDArray[np.float64]
    kernels: NDArray[np.float64]
    log_spread: NDArray[np.float64]

    @classmethod
    def of(cls, sums: _Sums, code: int, taus_s: NDArray[np.float64]) -> _Modes | None:
        """Those of a series; None where the parameters leave too little of it."""
        part = sums.part(code)
        time_s, width_s, root_count = sums.time_s[part], sums.width_s[code], np.sqrt(sums.count[part])
        kept = _not_absorbed(sums, code)
        if kept is None:
            return None
        kernels = np.array([_kernel(time_s, width_s, tau_s) for tau_s in taus_s])
        values, axes = np.linalg.eigh(kept.T @ (root_count[:, None] * kernels * root_count) @ kept)
        spread = 1.0 + _RATIOS[:, None] * np.maximum(values, 0.0)[:, None, :]
        return cls(kept, axes, 1.0 / spread, kernels, np.log(spread).sum(axis=2))


@dataclass(frozen=True, slots=True, eq=False)
class _Likelihood:
    """Restricted likelihood of a series for all correlation times and ratios that are tried.

    Parameters
    ----------
    log : ndarray, shape (taus, ratios)
        Logarithm of the likelihood over that of white noise.
    white : ndarray, shape (taus, ratios)
        Most likely w of each.
    kernels : ndarray, shape (taus, b, b)
        Correlations between the stretches.
    """

    log: NDArray[np.float64]
    white: NDArray[np.float64]
    kernels: NDArray[np.float64]

    @classmethod
    def of(cls, sums: _Sums, code: int, taus_s: NDArray[np.float64]) -> _Likelihood | None:
        """Likelihood of a series; None where the parameters leave too little of it.

        Sums over stretches have the variance n w + c sum(k), with what the parameters can absorb projected out;
        deviations from the means of the stretches have w + c (1 - k), k being the mean correlation within one.
        """
        part = sums.part(code)
        root_count = np.sqrt(sums.count[part])
        kept = _not_absorbed(sums, code)
        if kept is None:
            return None
        y = kept.T @ (sums.residual[part] / root_count)
        kernels = np.array([_kernel(sums.time_s[part], sums.width_s[code], tau_s) for tau_s in taus_s])
        coloured = kept.T @ (root_count[:, None] * kernels * root_count) @ kept
        size = np.trace(coloured, axis1=1, axis2=2) / max(float(y @ y), np.finfo(float).tiny)
        # y^T (1 + g K)^-1 y from eigenvalues alone: g s times it is the ratio of the determinants of
        # 1 + g (K + s y y^T) and of 1 + g K, less one.
        log_without = _log_determinants(coloured)
        log_with = _log_determinants(coloured + size[:, None, None] * np.outer(y, y))
        squares = np.expm1(log_with - log_without) / (_RATIOS * size[:, None])
        return cls._from(sums, code, y, squares, log_without, kernels)

    @classmethod
    def repeated(cls, sums: _Sums, code: int, modes: _Modes) -> _Likelihood:
        """The same, with what is known already of how errors spread."""
        part = sums.part(code)
        y = modes.kept.T @ (sums.residual[part] / np.sqrt(sums.count[part]))
        along = (np.swapaxes(modes.axes, 1, 2) @ y) ** 2
        squares = (modes.inverse_spread @ along[:, :, None])[..., 0]
        return cls._from(sums, code, y, squares, modes.log_spread, modes.kernels)

    @classmethod
    def _from(
        cls,
        sums: _Sums,
        code: int,
        y: NDArray[np.float64],
        squares: NDArray[np.float64],
        log_spread: NDArray[np.float64],
        kernels: NDArray[np.float64],
    ) -> _Likelihood:
        part = sums.part(code)
        count = sums.count[part]
        inside = max(float(sums.squares[code] - (sums.residual[part] ** 2 / count).sum()), 0.0)
        dof_inside = float(count.sum()) - len(count)
        spread_inside = 1.0 + _RATIOS * (1.0 - kernels[:, 0, 0])[:, None]
        every = len(y) + dof_inside
        white = (squares + inside / spread_inside) / every
        log = -0.5 * (every * np.log(white) + log_spread + dof_inside * np.log(spread_inside))
        null = -0.5 * every * math.log((float(y @ y) + inside) / every)
        return cls(log - null, white, kernels)


def _not_absorbed(sums: _Sums, code: int) -> NDArray[np.float64] | None:
    """Basis of what the parameters leave of sums over stretches, shape (b, d); None where that is too little."""
    part = sums.part(code)
    left, s, _ = np.linalg.svd(sums.partials[part] / np.sqrt(sums.count[part])[:, None])
    kept: NDArray[np.float64] = left[:, int((s * sums.absorbed > 1.0).sum()) :]
    return kept if kept.shape[1] >= _FEWEST else None


def _log_determinants(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithms of the determinants of 1 + g K for all ratios g, shape (matrices, ratios)."""
    values = np.maximum(np.linalg.eigvalsh(matrices), 0.0)
    return np.asarray(np.log1p(_RATIOS[:, None] * values[:, None, :]).sum(axis=2))


def _series_correlation(
    sums: _Sums,
    code: int,
    name: str,
    likelihood: _Likelihood,
    log: NDArray[np.float64],
    taus_s: NDArray[np.float64],
) -> tuple[SeriesCorrelation, NDArray[np.float64]]:
    """Correlation of a series and what it adds to a unit covariance, averaged over a likelihood."""
    count = sums.count[sums.part(code)]
    coloured = likelihood.white * _RATIOS
    weights = np.exp(log - log.max()) / (1.0 + coloured / sums.variance(code))
    weights /= weights.sum()
    white = float((weights * likelihood.white).sum())
    by_tau = (weights * coloured).sum(axis=1)
    kernel = np.einsum("k,kij->ij", by_tau, likelihood.kernels)
    unit = sums.partials[sums.part(code)]
    added = (white - 1.0) * sums.products[code] + unit.T @ kernel @ unit
    n, total = float(count.sum()), white + float(by_tau.sum())
    of_mean = white + float(count @ kernel @ count) / n
    tau_s = float(np.exp((by_tau * np.log(taus_s)).sum() / by_tau.sum()))
    return SeriesCorrelation(name, round(n), n * total / of_mean, tau_s, float(by_tau.sum()) / total), added


def _kernel(time_s: NDArray[np.float64], width_s: float, tau_s: float) -> NDArray[np.float64]:
    """Mean of exp(-|dt| / tau) over the observations of two stretches, evenly spread over their length."""
    x = width_s / tau_s
    apart = np.abs(time_s[:, None] - time_s[None, :])
    kernel = np.exp(-apart / tau_s) * (2.0 * math.sinh(0.5 * x) / x) ** 2
    # Stretches that end at a gap are shorter than others, so neighbours may be nearer than a whole one.
    same = 2.0 * (x - 1.0 + math.exp(-x)) / x**2
    kernel = np.minimum(kernel, same)
    np.fill_diagonal(kernel, same)
    return kernel
