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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.factorization import covariance_of, gram
from radioloc.estimation.gauss_markov import SeriesCorrelation, SeriesNoise, TimeCorrelation
from radioloc.estimation.least_squares import FitResult, fit_least_squares, sum_of_squares
from radioloc.estimation.linearization import ResidualFunction, Rows
from radioloc.estimation.series import Batch, SeriesOrder, series_of
from radioloc.estimation.time_correlation import assess_time_correlation, in_parameters, rows_of


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
class CorrelatedFit:
    """A fit weighed as its residuals ask for.

    Parameters
    ----------
    edited : EditedFit
        Its noise, sum of squares and formal covariance are those of the stated sigmas; its estimate and factor those of
        the weights.
    weights : tuple of SeriesWeight
        Series with time-correlated residuals.
    """

    edited: EditedFit
    weights: tuple[SeriesWeight, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Whitening:
    """How used observations are brought to independent ones where series have noise of their own."""

    batches: Sequence[Batch]  # of one stretch each
    steps_s: Sequence[NDArray[np.float64]]
    noise: dict[str, SeriesNoise]

    @classmethod
    def of(cls, batches: Sequence[Batch], noise: dict[str, SeriesNoise]) -> _Whitening:
        steps_s = [np.diff(batch.time_s, prepend=batch.time_s[0]) for batch in batches]
        return cls(batches, steps_s, noise)

    def whitened(self, rows_of: Callable[[Rows], NDArray[np.float64]]) -> Iterator[NDArray[np.float64]]:
        """Independent combinations of unit variance, from indices of rows (m,) to numbers (m, c), series by series."""
        for batch, step_s in zip(self.batches, self.steps_s, strict=True):
            values = batch.whitened(rows_of)
            for k, one in enumerate(batch.series):
                errors = self.noise.get(one.key)
                yield values[:, k] if errors is None else errors.whitened(step_s, values[:, k])


def fit_with_correlated_weights(
    residual_function: ResidualFunction, edited: EditedFit, order: SeriesOrder
) -> CorrelatedFit:
    """Fit again, each series with time-correlated residuals weighed by the inverse of their covariance.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    edited : EditedFit
        The fit with all observations weighed as independent; its selection stays, as outliers are judged by the stated
        sigmas.
    order : SeriesOrder
        Types, paths and times of the observations.
    """
    stated = edited.fit
    # A fit that did not come to its end says itself what is wrong with it.
    if not edited.ended:
        return CorrelatedFit(edited, ())
    found = assess_time_correlation(stated, order)
    if found is None:
        return CorrelatedFit(edited, ())
    batches = [one for batch in series_of(order, stated.noise, stated.used) for one in batch.stretches()]
    weights = _weights(batches, found)
    whitening = _Whitening.of(batches, _weight_noise(batches, found, weights))
    fit = fit_least_squares(
        residual_function,
        stated.parameters,
        stated.noise,
        used=stated.used,
        start=stated.x,
        linearization=stated.linearization,
        whitening=whitening,
    )
    fit = replace(
        fit, chi2=sum_of_squares(fit.residual_m, stated.noise.among(fit.used), fit.parameters, fit.x)
    )
    return CorrelatedFit(replace(edited, fit=_with_covariances(fit, whitening, found)), weights)


def _with_covariances(fit: FitResult, whitening: _Whitening, found: TimeCorrelation) -> FitResult:
    """The fit with the covariance of its estimate were errors independent and as stated, and what they add to it.

    With the weights W, parameters of unit A^T W A + P have the covariance I + A^T W W A - A^T W A for errors of unit
    variance, and A^T W V W A - A^T W W A more for those of the covariance V.
    """
    root = fit.factor.root_covariance()
    unit, added = np.eye(root.shape[1]), np.zeros((root.shape[1],) * 2)
    values_of = rows_of(fit)
    for batch, step_s in zip(whitening.batches, whitening.steps_s, strict=True):
        if not any(one.key in whitening.noise for one in batch.series):
            continue
        partials = batch.whitened(lambda rows: values_of(rows)[:, 1:] @ root)
        for k, one in enumerate(batch.series):
            weights, errors = whitening.noise.get(one.key), found.noise.get(one.key)
            if weights is None:
                continue
            whitened = weights.whitened(step_s, partials[:, k])
            weighted = weights.whitened(step_s, whitened, adjoint=True)
            squares = gram(weighted, weighted)
            unit += squares - gram(whitened, whitened)
            if errors is not None:
                added += errors.products(step_s, np.ones(len(step_s)), weighted) - squares
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
    for batch in batches:
        if batch.shared in factors:
            inflated = SeriesNoise(factors[batch.shared] ** 2, np.ones(1), np.zeros(1))
            noise |= {one.key: inflated for one in batch.series}
        elif not batch.shared and batch.series[0].key in found.noise:
            errors = found.noise[batch.series[0].key]
            tau_s, coloured = np.array([errors.correlation_time_s]), np.array([errors.coloured.sum()])
            noise[batch.series[0].key] = SeriesNoise(errors.white, tau_s, coloured)
    return noise


def _weights(batches: Sequence[Batch], found: TimeCorrelation) -> tuple[SeriesWeight, ...]:
    """What the series weigh; combinations of observations that share errors together."""
    items = dict(zip(found.noise, found.series, strict=True))
    counts: dict[str, int] = {}
    mine: dict[str, list[SeriesCorrelation]] = {}
    for batch in batches:
        name = batch.shared or batch.series[0].name
        counts[name] = counts.get(name, 0) + batch.rows.size
        mine.setdefault(name, []).extend(items[one.key] for one in batch.series if one.key in items)
    weights = []
    for name, found_in in mine.items():
        # Combinations in which the errors of stations cancel, around triangles, need not be correlated.
        enlarged = sum(item.count**2 / item.effective_count for item in found_in)
        factor = math.sqrt(max(1.0, enlarged / max(sum(item.count for item in found_in), 1)))
        if factor > 1.0:
            weights.append(SeriesWeight(name, counts[name], factor))
    return tuple(weights)
