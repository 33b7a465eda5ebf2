"""Weights that allow for time-correlated residuals: generalized least squares.

Least squares that weigh observations as independent have the right expectation whatever the errors, but not the least
variance: a dense series whose errors are correlated outweighs a-priori values and other series that know better. With
the covariance V of white noise and a Gauss-Markov process in each series the best linear estimate weighs by the inverse
of V (Aitken 1935). A Kalman filter whitens residuals and design matrix of each series
(:mod:`~radioloc.estimation.gauss_markov`); what it leaves are independent observations to the fit. The noise model is
found once, from the fit with independent weights: a restricted likelihood does not depend on the estimate.

Delays that share errors of stations are weighed as the independent observations that they are worth: their sigmas are
multiplied by the root of n / n_effective, the mean over the combinations of baselines whose errors are correlated. In
any case the covariance of the estimate is the sandwich of the weights and of the errors as they are
(:mod:`~radioloc.estimation.time_correlation`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import CommonErrors, Effects
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.factorization import covariance_of, gram
from radioloc.estimation.gauss_markov import (
    DENSE,
    SeriesCorrelation,
    SeriesNoise,
    SeriesWeight,
    TimeCorrelation,
)
from radioloc.estimation.least_squares import FitResult, fit_least_squares
from radioloc.estimation.linearization import ResidualFunction, Rows
from radioloc.estimation.observation_noise import Whitening
from radioloc.estimation.series import Batch, SeriesOrder, series_of
from radioloc.estimation.time_correlation import assess_time_correlation, in_parameters

_UNIT = SeriesNoise(1.0, np.ones(1), np.zeros(1))


@dataclass(frozen=True, slots=True, eq=False)
class _Whitening:
    """How used observations are brought to independent ones where series have noise of their own."""

    batches: Sequence[Batch]
    errors: Sequence[_Errors]

    @classmethod
    def of(cls, batches: Sequence[Batch], noise: Mapping[str, SeriesNoise]) -> _Whitening:
        return cls(batches, [_Errors.of(batch, noise) for batch in batches])

    def whitened(self, rows_of: Callable[[Rows], NDArray[np.float64]]) -> Iterator[NDArray[np.float64]]:
        """Independent combinations of unit variance, from indices of rows (m,) to numbers (m, c), part by part."""
        for batch, errors in zip(self.batches, self.errors, strict=True):
            yield errors.whitened(batch.whitened(rows_of))


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """White and Gauss-Markov noise of the series of a batch; white of unit variance by default."""

    begin: NDArray[np.intp]  # (s + 1,), first value of each, and n
    step_s: NDArray[np.float64]  # (n,), time since the value before
    white: NDArray[np.float64]  # (s,)
    tau_s: NDArray[np.float64]  # (s,)
    ratio: NDArray[np.float64]  # (s,)

    @classmethod
    def of(cls, batch: Batch, noise: Mapping[str, SeriesNoise]) -> _Errors:
        errors = [noise.get(one.key, _UNIT) for one in batch.series]
        numbers = np.array([(one.white, one.correlation_time_s, one.ratio) for one in errors])
        step_s = np.diff(batch.time_s, prepend=batch.time_s[0])
        step_s[batch.begin[:-1]] = 0.0
        return cls(batch.begin, step_s, *np.ascontiguousarray(numbers.T))

    def whitened(self, columns: NDArray[np.float64], *, adjoint: bool = False) -> NDArray[np.float64]:
        """Columns (n, m) by the root of the inverse covariance: innovations over their standard deviations.

        Those again by the transposed root, `adjoint`, are the columns times the inverse covariance.
        """
        from radioloc.estimation._kernels import whiten

        return whiten(self.begin, self.step_s, self.white, self.tau_s, self.ratio, columns, adjoint)


def fit_with_correlated_weights(
    residual_function: ResidualFunction,
    edited: EditedFit,
    order: SeriesOrder,
    common: Effects | None = None,
) -> EditedFit:
    """Fit again, each dense series with time-correlated residuals weighed by the inverse of their covariance.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    edited : EditedFit
        The fit with all observations weighed as independent; its selection stays, as outliers are judged by the stated
        sigmas.
    order : SeriesOrder
        Types, paths and times of the observations.
    common : callable, optional
        Effects of known errors of unit variance (:data:`~radioloc.estimation.consider.Effects`), for which the weights
        allow as well.

    Returns
    -------
    EditedFit
        With the weights of series. Noise, sum of squares and formal covariance are those of the stated sigmas; estimate
        and factor those of the weights.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.estimation import Labels, Parameter, ParameterSet, fit_with_correlated_weights, fit_with_editing
    >>> parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("drift", "m/h", "bias")])
    >>> hours = np.arange(400) / 10
    >>> design = np.column_stack([np.ones(400), hours])
    >>> from radioloc.estimation.series import SeriesOrder
    >>> lasting = np.convolve(np.random.default_rng(1).normal(size=420), np.exp(-np.arange(21) / 7), "valid")
    >>> observed = 3.0 + 0.5 * hours + 0.1 * lasting
    >>> order = SeriesOrder.of(Labels.of(["range"] * 400), Labels.of(["KASHI>lander>KASHI"] * 400), 3600.0 * hours)
    >>> edited = fit_with_editing(lambda x: (observed - design @ x, design), parameters, 0.2)
    >>> weighed = fit_with_correlated_weights(lambda x: (observed - design @ x, design), edited, order)
    >>> [weight.name for weight in weighed.series_weights]
    ['range KASHI>lander>KASHI']
    """
    stated = edited.fit
    # A fit that did not come to its end says itself what is wrong with it.
    if not edited.ended:
        return edited
    batches = series_of(order, stated.noise, stated.used)
    found = assess_time_correlation(stated, order, common, batches)
    edited = replace(edited, fit=replace(stated, time_correlation=found))
    if not found.series and common is None:
        return edited
    weights = _weights(batches, found)
    noise = _Whitening.of(batches, _weight_noise(batches, found, weights))
    whitening: Whitening = noise
    if common is not None:
        allowing = CommonErrors.of(noise, common)
        whitening = allowing if len(allowing.variance) else noise
    if whitening is noise and not weights:
        return edited
    fit = fit_least_squares(
        residual_function,
        stated.parameters,
        stated.noise,
        used=stated.used,
        start=stated.x,
        linearization=stated.linearization,
        whitening=whitening,
    )
    return replace(edited, fit=_with_covariances(fit, noise, found), series_weights=weights)


def _with_covariances(fit: FitResult, noise: _Whitening, found: TimeCorrelation) -> FitResult:
    """The fit with the covariance of its estimate were errors independent and as stated, and what they add to it.

    With the weights W, parameters of unit A^T W A + P have the covariance I + A^T W W A - A^T W A for errors of unit
    variance, and A^T W V W A - A^T W W A more for those of the covariance V.
    """
    root = fit.factor.root_covariance()
    unit, added = np.eye(root.shape[1]), np.zeros((root.shape[1],) * 2)
    parts = list(fit.whitening.whitened(fit.unit_partials()))
    for whitened in parts:
        unit -= gram(whitened, whitened)
    # Estimates of common errors come last
    for batch, weights, whitened in zip(noise.batches, noise.errors, parts, strict=False):
        weighted = weights.whitened(whitened, adjoint=True)
        unit += gram(weighted, weighted)
        for one, begin, end in zip(batch.series, batch.begin, batch.begin[1:], strict=False):
            if one.key in found.noise:
                step_s = weights.step_s[begin:end]
                points = (step_s, np.ones(len(step_s)), weighted[begin:end])
                added += found.noise[one.key].products(*points, less=1.0)
    fit = replace(fit, covariance=covariance_of(fit.factor, fit.parameters, unit))
    return replace(fit, time_correlation=replace(found, added_covariance=in_parameters(added, fit)))


def _weight_noise(
    batches: Sequence[Batch], found: TimeCorrelation, weights: Sequence[SeriesWeight]
) -> dict[str, SeriesNoise]:
    """Noise by whose inverse covariance series are weighed, by key.

    Errors of stations go on where a baseline drops out and the combinations become others, which a filter for each
    combination does not know. Observations that share errors have one factor on their sigmas instead.
    """
    factors = {weight.name: weight.sigma_factor for weight in weights}
    noise: dict[str, SeriesNoise] = {}
    for one in (one for batch in batches for one in batch.series):
        if one.shared in factors:
            noise[one.key] = SeriesNoise(factors[one.shared] ** 2, np.ones(1), np.zeros(1))
        elif one.name in factors:
            noise[one.key] = found.noise[one.key]
    return noise


def _weights(batches: Sequence[Batch], found: TimeCorrelation) -> tuple[SeriesWeight, ...]:
    """What the series weigh; combinations of observations that share errors together."""
    items = dict(zip(found.noise, found.series, strict=True))
    counts: dict[str, int] = {}
    mine: dict[str, list[SeriesCorrelation]] = {}
    for batch in batches:
        for one, first, end in zip(
            batch.series, batch.begin.tolist(), batch.begin[1:].tolist(), strict=False
        ):
            name = one.shared or one.name
            counts[name] = counts.get(name, 0) + end - first
            span_s = float(batch.time_s[end - 1] - batch.time_s[first])
            item = items.get(one.key)
            if item is not None and item.count * item.correlation_time_s >= DENSE * span_s:
                mine.setdefault(name, []).append(item)
    weights = []
    for name, found_in in mine.items():
        # Combinations in which the errors of stations cancel, around triangles, need not be correlated.
        enlarged = sum(item.count**2 / item.effective_count for item in found_in)
        factor = math.sqrt(max(1.0, enlarged / max(sum(item.count for item in found_in), 1)))
        if factor > 1.0:
            weights.append(SeriesWeight(name, counts[name], factor))
    return tuple(weights)
